"""A run on a real ROS 2 graph: nodes of a user, in processes of their own, see it, drive it, hold it, and die."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from robofleet.behaviours.interface import WishKind
from robofleet.bus.keys import WISH, key
from robofleet.bus.messages import SCRIPT_WISH
from robofleet.core.clock import S
from robofleet.gateways.asking import SERVICES
from robofleet.gateways.ros2 import topics
from robofleet.recording.reading import read
from robofleet.recording.run import Run
from tests.runs.realrun import CLOCK, RealRun, wait, was_busy

pytestmark = pytest.mark.skipif(
    find_spec("rclpy") is None, reason="NO ROS 2: pip install -e '.[ros2]' on Python 3.11, or source your own"
)
CONFIG = Path(__file__).parents[3] / "configs" / "ros2.yaml"
WITHIN_S = 90.0
SILENT_S, TICK_S = 0.15, 0.033  # groups[].settings.silent_s: an older command drives nobody; the controller's
LATE_S = 0.05  # of a node's command on its way, and of a tick
STANDS_WITHIN_S = 1.0  # after a node was killed, however busy the machine is that brings its last command


class Stand:
    """A run, with a gateway beside it; where users' nodes are started."""

    def __init__(self, run: RealRun, environment: dict[str, str], output: Path) -> None:
        self.run, self.environment, self._log = run, environment, output
        self.gateway: subprocess.Popen[bytes]
        self.serve()

    def serve(self) -> None:
        """Start a gateway."""
        command = [sys.executable, "-m", "robofleet", "ros2", "ros2"]  # its packages warn
        with self._log.open("w") as output:
            self.gateway = subprocess.Popen(command, env=self.environment, stderr=output)
        assert wait(lambda: "ROS 2 hears" in self.gateway_said, WITHIN_S), self.gateway_said

    @property
    def gateway_said(self) -> str:
        return self._log.read_text()

    def node(self, *what: str) -> "subprocess.Popen[str]":
        """Start a user's node."""
        command = [sys.executable, "-m", "tests.gateways.ros2.user", *what]
        return subprocess.Popen(
            command, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def said(self, *what: str) -> dict[str, Any]:
        """Return what a user's node found."""
        with self.node(*what) as node:
            try:
                out, err = node.communicate(timeout=WITHIN_S)
            finally:
                node.kill()
        assert node.returncode == 0, err
        return dict(json.loads(out))


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory, alone_for_a_module: None) -> Iterator[Stand]:
    """Yield a run with a gateway beside it. The graph is this module's own."""
    folder = tmp_path_factory.mktemp("ros2")
    two = yaml.safe_load(CONFIG.read_text())["robots"][:2]
    fewer = "--set", f"robots={json.dumps(two)}", "--set", f"groups.0.robots={json.dumps([row['id'] for row in two])}"
    run = RealRun(folder, *fewer, "--set", "robots.0.sensors=true", config=CONFIG)
    environment = run.environment | {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder / "log"),
    }  # fmt: skip
    made = None
    try:
        run.wait_until_running()
        made = Stand(run, environment, folder / "gateway")
        yield made
        run.launcher.kill()  # at once and without a report; all others end by themselves
        assert wait(lambda: made.gateway.poll() is not None, WITHIN_S), "the run has ended"
        assert made.gateway.returncode == 0, made.gateway_said
    finally:
        if made is not None:
            made.gateway.kill()
        run.clean_up()


def rows_of(name: str) -> list[topics.Topic]:
    """Return the table's rows of a topic."""
    about = [(frame, number) for frame in ("r1", "r2", "r3", "r4", "overhead") for number in range(7)]
    return [
        row for row in topics.TOPICS if name.lstrip("/") in {row.name.format(*frame).lstrip("/") for frame in about}
    ]


@pytest.mark.slow
def test_the_graph_is_the_table(stand: Stand) -> None:
    found = stand.said("listen", "2")
    for name, seen in found["topics"].items():
        (row,) = rows_of(name)
        assert seen["type"] in row.type.split(" or ") and seen["flow"] == row.flow, name
        assert seen["quality"] == str(row.quality).split(", ")[:2], name
        if seen["flow"] == "out":
            robot = name.split("/")[1]
            assert seen["messages"] > 0, name
            frames = {"", *row.frame.format(*[robot] * row.frame.count("{}")).replace(",", " ").split()}
            frames |= {f"r{k}/base_link" for k in (1, 2, 3, 4)} if row is topics.MARKERS else set()
            frames |= {name[1:]} if row is topics.RANGE else set()
            assert set(seen["frames"]) - {""} <= frames, name
    own = [row.name.format("r1") for row in topics.OF_ROBOTS]
    assert {f"/{name}" for name in own} <= set(found["topics"]), "each robot has all of its own"
    shown = {row for name in found["topics"] for row in rows_of(name)}
    silent = {topics.CLOCK, *([] if find_spec("tf2_msgs") else [topics.TRANSFORMS, topics.FIXED])}
    assert shown | silent == set(topics.TOPICS) | shown & silent
    for service in SERVICES:
        assert found["services"][f"/{service}"] == topics.SERVICE


@pytest.mark.slow
def test_a_node_drives_a_robot_round_a_square_and_holds_it(stand: Stand) -> None:
    answer = stand.said("square")
    corners = np.array(answer["corners"])
    sides = np.linalg.norm(np.diff(corners[:, :2], axis=0), axis=1)
    assert sides == pytest.approx(0.1, abs=0.02)
    assert corners[-1, :2] == pytest.approx(corners[0, :2], abs=0.03)
    assert answer["pose"][:2] == pytest.approx(answer["first_pose"][:2], abs=0.05), "where the camera sees it, too"
    assert answer["told"] == {"hold": [True, "ok"], "resume": [True, "ok"]}
    assert answer["stood_m"] < 0.002, "held robots stand whatever is commanded"
    assert answer["old_m"] < 0.002 and answer["nothing_m"] < 0.002, "an old stamp, and what is no number"
    assert answer["states"][:1] == answer["states"][-1:] == ["running"] and "hold" in answer["states"]
    assert answer["states"] == ["running", "hold", "running"] or was_busy(stand.run.said)
    assert answer["odom_frames"] == ["r1/odom", "r1/base_link"]
    assert answer["stamps_rise"] and answer["odom"] > 100 and answer["map"] > 50


class Killed(NamedTuple):
    """A node that drove and was killed: instants of its commands [ns]."""

    first: int
    middle: int
    last: int


@pytest.fixture(scope="module")
def killed(stand: Stand) -> tuple[dict[str, Killed], Run]:
    """Return when nodes drove and were killed, and the recording until some time after that."""
    found = {}
    for kind in ("TwistStamped", "Twist"):
        with stand.node("drive", kind) as node:
            assert node.stdout is not None
            lines = [node.stdout.readline() for _ in range(40)]
            node.kill()
            lines += node.stdout.read().splitlines()
        found[kind] = Killed(int(lines[0]), int(lines[20]), int(lines[-1]))
    over_ns = CLOCK.now_ns() + round(STANDS_WITHIN_S * S)
    assert wait(lambda: Run(read(stand.run.folder)).ticks["stamp_ns"][-1] > over_ns, WITHIN_S), "the run goes on"
    return found, Run(read(stand.run.folder))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["TwistStamped", "Twist"])
def test_a_node_that_is_killed_lets_its_robot_stand(
    kind: str, killed: tuple[dict[str, Killed], Run], stand: Stand
) -> None:
    """What its wheels were told is in the recording. Instants are its own: when it published; the run is not held."""
    nodes, run = killed
    node, stamps, wheels = nodes[kind], run.ticks["stamp_ns"], np.abs(run.items["right_rad_s"][:, 0])
    assert wheels[(stamps > node.middle) & (stamps < node.last)].max() > 1.0, "it drove"
    ends = [
        node.last + STANDS_WITHIN_S * S,
        *(node_log.first for node_log in nodes.values() if node_log.first > node.last),
    ]
    after = (stamps > node.middle) & (stamps < min(ends))
    drove_s = (stamps[after & (wheels > 0.0)].max() - node.last) / S
    assert drove_s <= SILENT_S + TICK_S + LATE_S or was_busy(stand.run.said)
    assert wheels[after][-1] == 0.0
    held = [line for line in stand.run.said.splitlines() if line.startswith("held: ")]
    assert all("hold requested" in line or "goes on by itself" in line for line in held), held


@pytest.mark.slow
def test_ctrl_c_lets_the_robots_stand_and_says_nothing_else(stand: Stand) -> None:
    """What comes while it ends is no traceback."""
    with stand.node("drive", "TwistStamped") as node:
        assert node.stdout is not None
        for _ in range(40):
            node.stdout.readline()
        stand.gateway.send_signal(signal.SIGINT)
        assert stand.gateway.wait(WITHIN_S) == 0
        ended_ns = CLOCK.now_ns()
        lines = stand.gateway_said.strip().splitlines()
        stand.serve()
        assert wait(lambda: Run(read(stand.run.folder)).ticks["stamp_ns"][-1] > ended_ns, WITHIN_S), "it is recorded"
        node.kill()
    assert [line for line in lines if "[WARN]" not in line] == [
        "ROS 2 hears the run of ros2: Ctrl-C ends this, and not the run"
    ]
    setpoints = read(stand.run.folder).messages[key("ros2", WISH, "ros2")]
    kinds = [head.kind for payload in setpoints if (head := SCRIPT_WISH.decode_head(payload)) is not None]
    assert WishKind.STAND in kinds and kinds[kinds.index(WishKind.STAND) - 1] == WishKind.BODY
