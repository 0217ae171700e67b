"""Robots with computers of their own: real namespaces, certificates, links and firmware's twins."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml

from robofleet.comms.keys import STATUS
from robofleet.recording.reading import read
from robofleet.safety.gate import Latch
from tests.hosts.network import Host, Network, unavailable
from tests.processes.realrun import PLATOON, wait

PORT = 7447
ALONE = "desk", "phone"
OPERATOR, VIEWER = "alice", "bob"


@pytest.fixture
def network(alone: None, tmp_path: Path) -> Iterator[Callable[..., Network]]:
    if why := unavailable():
        pytest.skip(why)
    with ExitStack() as stack:

        def made(*robots: str) -> Network:
            network = Network(tmp_path, ["lab", *ALONE, *robots], ALONE)
            stack.callback(network.close)
            join(network, robots)
            return network

        yield made


def join(network: Network, robots: tuple[str, ...]) -> None:
    """Do what a laboratory does once: an authority, certificates, and a bundle for each host."""
    lab = network["lab"]
    said(lab, "keys", "init", "platoon")
    said(lab, "keys", "add", "platoon", "router", "--address", lab.address)
    who = {**{robot: (robot, "unit") for robot in robots}, "desk": (OPERATOR, "operator"), "phone": (VIEWER, "viewer")}
    for host, (name, kind) in who.items():
        said(lab, "keys", "add", "platoon", name, "--kind", kind)
        file = lab.folder / f"{name}.bundle"
        router = f"quic/{lab.address}:{PORT}"
        said(lab, "keys", "bundle", "platoon", name, "--router", router, "--out", str(file))
        assert "the keys of" in said(network[host], "join", str(file))


def said(host: Host, *words: str) -> str:
    """Return what a command says that must succeed."""
    done = host.robofleet(*words)
    assert done.returncode == 0, done.stderr
    return done.stdout


def configuration(network: Network, *robots: str, **run: Any) -> Path:
    """Write the configuration of a laboratory whose robots are at these hosts."""
    tree = yaml.safe_load(PLATOON.read_text())
    tree["robots"] = [robot | {"driver": "gternal", "twin": "gternal", "unit": robot["id"]} for robot in tree["robots"]]
    tree["robots"] = [robot for robot in tree["robots"] if robot["id"] in robots]
    tree["groups"][0]["robots"] = list(robots)
    tree["drivers"] = {"started_by": "daemon"}
    tree["bus"] = {"listen": [f"quic/{network['lab'].address}:{PORT}"]}
    tree["run"] = {**tree["run"], **run}
    file = network["lab"].folder / "lab.yaml"
    file.write_text(yaml.safe_dump(tree))
    return file


class Fleet:
    """Daemons that wait on their hosts, and one run after the other."""

    def __init__(self, network: Network, robots: tuple[str, ...], stack: ExitStack) -> None:
        self.network, self._stack = network, stack
        self.logs = {robot: network[robot].folder / "driver.log" for robot in robots}
        self.daemons = {robot: self._begin(robot) for robot in robots}

    def _begin(self, robot: str) -> "subprocess.Popen[bytes]":
        daemon = self.network[robot].begin("driver", "--unit", robot, log=self.logs[robot])
        self._stack.callback(_end, daemon)
        return daemon

    def run(self, file: Path, name: str, *words: str) -> "subprocess.Popen[bytes]":
        """Start a run in the laboratory; its folder has this name."""
        lab = self.network["lab"]
        run = lab.begin("run", str(file), "--out", str(lab.folder / name), *words, log=lab.folder / f"{name}.log")
        self._stack.callback(_end, run)
        return run

    def phase(self) -> str:
        """Return where the run is, as the laboratory sees it."""
        found = self.network["lab"].robofleet("status", "--json")
        return str(yaml.safe_load(found.stdout)["phase"]) if found.returncode == 0 else ""

    def log(self, name: str) -> str:
        """Return what a run said."""
        return (self.network["lab"].folder / f"{name}.log").read_text()


def _end(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        process.terminate()
        process.wait(20)


def test_two_runs_on_robots_that_wait_and_an_operator_a_viewer_and_a_cut_link(
    network: Callable[..., Network],
) -> None:
    robots = "r1", "r2"
    net = network(*robots)
    file = configuration(net, *robots, duration_s=300.0)
    with ExitStack() as stack:
        fleet = Fleet(net, robots, stack)
        run = fleet.run(file, "first", "--set", "tracker.source=truth")
        assert wait(lambda: fleet.phase() == "running" or run.poll() is not None, 150), fleet.log("first")
        assert run.poll() is None, fleet.log("first")

        hosts = yaml.safe_load(said(net["lab"], "hosts", "--json"))["units"]
        assert [one["unit"] for one in hosts] == list(robots)
        assert all(one["certificate_ends"] and one["round_trip_ms"] and one["loss"] < 0.5 for one in hosts)

        assert net["phone"].robofleet("hold").stdout.startswith("ok")
        assert wait(lambda: fleet.phase() == "hold", 20)
        refused = net["phone"].robofleet("resume")
        assert refused.returncode == 1
        assert fleet.phase() == "hold"
        assert net["desk"].robofleet("resume").stdout.startswith("ok")
        assert wait(lambda: fleet.phase() == "running", 20)

        with net.cut("r2"):
            assert wait(lambda: fleet.phase() != "running", 20), "a robot that nobody reaches does not stop the run"
        assert wait(lambda: net["desk"].robofleet("resume").stdout.startswith("ok"), 30)
        assert wait(lambda: fleet.phase() == "running", 20), "a robot whose link is back drives again"

        stopped = net["desk"].robofleet("stop")
        assert stopped.stdout.startswith("emergency stop of platoon: every robot acknowledged"), stopped.stderr
        assert wait(lambda: run.poll() is not None, 60)
        recording = read(net["lab"].folder / "first")
        assert all(recording.of_robot(STATUS, robot)["latch"].max() >= Latch.EMERGENCY_STOP for robot in robots)

        again = fleet.run(file, "second", "--set", "tracker.source=truth", "--reset", "--duration", "1")
        assert again.wait(100) == 0, fleet.log("second")
        assert all(daemon.poll() is None for daemon in fleet.daemons.values())


def test_a_robot_refuses_what_its_own_file_does_not_allow_and_the_run_says_so(network: Callable[..., Network]) -> None:
    net = network("r1")
    own = net["r1"].folder / "config" / "robofleet" / "robot.yaml"
    own.write_text(own.read_text().replace("allows: {}", "allows: {max_wheel_speed_rad_s: 5.0}"))
    file = configuration(net, "r1", duration_s=1.0)
    with ExitStack() as stack:
        fleet = Fleet(net, ("r1",), stack)
        run = fleet.run(file, "run", "--set", "tracker.source=truth")
        assert run.wait(150) == 1
        assert "robot.yaml on this robot does not allow wheels of 12.5 rad/s (allowed: 5)" in fleet.log("run")
