"""A robot's own computer refuses a run that it cannot take, and waits for the next one."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from robofleet.bus.keys import CONFIG
from robofleet.bus.messages import HANDED
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.config.files.robot_file import Allowed, RobotFile
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.core.patterns import driver_role
from robofleet.nodes.handing import packed
from robofleet.runs.daemon import Daemon
from tests.endpoints import own_endpoint
from tests.shipped import PLATOON

CLOCK = WallClock()
ROBOT = RobotFile(arena="platoon", unit="r1", router=("quic/127.0.0.1:7447",))


class Bench:
    """A daemon, and a supervisor that hands it runs."""

    def __init__(self, daemon: Daemon, supervisor: ZenohBus) -> None:
        self.daemon, self._supervisor = daemon, supervisor

    def handed(self, config: Config) -> str:
        """Return what the daemon says to a run; the router may not know it yet, so it is asked again."""
        message = HANDED.encode(packed(config))
        again_ns, end_ns = 0, CLOCK.now_ns() + 10 * S
        while (now_ns := CLOCK.now_ns()) < end_ns:
            if now_ns >= again_ns:
                answer, again_ns = self._supervisor.ask(CONFIG, "r1", message), now_ns + S
            self.daemon.step(now_ns)
            if (reply := answer.take()) is not None:
                return reply.decode()
            CLOCK.sleep_until(CLOCK.now_ns() + 5 * MS)
        raise TimeoutError("the daemon says nothing")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which the robot's computer keeps what it keeps."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def bench(folder: Path) -> Iterator[Bench]:
    with benched(folder, ROBOT) as bench:
        yield bench


@contextmanager
def benched(folder: Path, robot: RobotFile) -> Iterator[Bench]:
    endpoint = own_endpoint()
    with (
        closing(open_router(endpoint)),
        closing(ZenohBus("platoon", endpoint, "supervisor", CLOCK)) as supervisor,
        closing(ZenohBus("platoon", endpoint, "r1", CLOCK, roles=(driver_role("r1"),))) as bus,
        closing(Daemon(robot, folder / "robot.yaml", bus, CLOCK, lambda _: None, {}, lambda _: None)) as daemon,
    ):
        yield Bench(daemon, supervisor)


def config(driver: str) -> Config:
    """Return a run of one robot, whose driver is of this kind."""
    tree = load_config(PLATOON, ["tracker.source=truth"])
    robots = [robot.model_copy(update={"unit": robot.id}) for robot in tree.robots]
    robots[0] = robots[0].model_copy(update={"driver": driver})
    return tree.model_copy(update={"robots": tuple(robots)})


@pytest.mark.parametrize("driver", ["nowhere:Robot", "no_such_kind", "pathlib:Path"])
def test_a_run_with_a_driver_that_is_not_here_is_refused_and_the_next_one_taken(bench: Bench, driver: str) -> None:
    assert bench.handed(config(driver)).startswith("refused: ")
    assert bench.handed(config("simulated")) == "ok"


@pytest.mark.parametrize(
    ("allows", "refusal"),
    [
        (Allowed(max_wheel_speed_rad_s=5.0), "wheels of 12.5 rad/s (allowed: 5)"),
        (Allowed(drivers=("gternal",)), "the driver simulated (allowed: gternal)"),
        (Allowed(ports=("/dev/ttyUSB3",)), "the port None (allowed: /dev/ttyUSB3)"),
    ],
)
def test_what_the_robots_own_file_does_not_allow_is_refused(folder: Path, allows: Allowed, refusal: str) -> None:
    with benched(folder, ROBOT.model_copy(update={"allows": allows})) as bench:
        answer = bench.handed(config("simulated"))
    assert answer == f"refused: r1: {folder / 'robot.yaml'} on this robot does not allow {refusal}"


def test_what_it_allows_is_taken(folder: Path) -> None:
    allows = Allowed(max_wheel_speed_rad_s=12.5, drivers=("gternal", "simulated"))
    with benched(folder, ROBOT.model_copy(update={"allows": allows})) as bench:
        assert bench.handed(config("simulated")) == "ok"
