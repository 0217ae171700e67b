"""A robot whose driver's process is killed or stopped: its dead man stops it; nothing old moves it later."""

import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robofleet.core.clock import S, WallClock
from tests.twins import TwinStand, config_of

STOPS_WITHIN_S = {"create2": 0.3, "arduino_bridge": 1.2}  # a Create 2 never stops by itself, that sketch after 2 s
VEHICLES = {"create2": "create2", "arduino_bridge": "arduino"}
PATIENCE_S = 30.0
RESTS_RAD_S = 0.3
DRIVER = """
import select, sys
from robofleet.core.clock import WallClock
from robofleet.core.plugins import load
from robofleet.vehicles.interface import DriverContext, WheelSpeeds
from tests.robots import CREATE2
kind, port = load("robofleet.drivers", sys.argv[1]), sys.argv[2]
own = {"counts_per_turn": 2000} if sys.argv[1] == "arduino_bridge" else {}
clock, settings = WallClock(), kind.Settings(port=port, **own)
robot = kind(DriverContext(robot="r1", drive=CREATE2, simulation=None, now_ns=clock.now_ns, settings=settings))
last_ns = clock.now_ns()
while True:
    now_ns = clock.now_ns()
    fresh = now_ns - last_ns < 120_000_000  # as a gate would
    last_ns = now_ns if fresh else last_ns
    robot.read()
    robot.write(WheelSpeeds(5.0, 5.0) if fresh else WheelSpeeds(0.0, 0.0))
    select.select([], [], [], 0.01)
"""


class Bench:
    """A twin in a thread of ours, and a process that drives it."""

    def __init__(self, driver: str, folder: Path) -> None:
        self.stand = TwinStand(config_of(twin=driver, vehicle=VEHICLES[driver]), folder, WallClock())
        self.kind = driver
        self.start()

    def start(self) -> None:
        self.driver = subprocess.Popen([sys.executable, "-c", DRIVER, self.kind, str(self.stand.port)])

    @property
    def moves(self) -> bool:
        return max(map(abs, self.stand.twin._target)) > RESTS_RAD_S

    def wait(self, condition: Callable[[], bool]) -> float:
        """Wait until it holds; returns how long that took [s]."""
        began_ns = self.stand.clock.now_ns()
        while not condition():
            assert self.stand.clock.now_ns() - began_ns < PATIENCE_S * S
            select.select([], [], [], 0.002)
        return (self.stand.clock.now_ns() - began_ns) / S


@pytest.fixture(params=STOPS_WITHIN_S)
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(request.param, tmp_path)
    with bench.stand.running():
        bench.wait(lambda: bench.moves)
        yield bench
        bench.driver.kill()
        bench.driver.wait()
    bench.stand.twin.close()


@pytest.mark.slow
def test_a_killed_driver_leaves_it_at_rest_and_its_successor_may_have_the_port(bench: Bench) -> None:
    bench.driver.kill()
    assert bench.wait(lambda: not bench.moves) < STOPS_WITHIN_S[bench.kind]
    bench.driver.wait()
    bench.wait(lambda: not bench.stand.twin._line.open)  # its dead man has ended too
    bench.start()
    bench.wait(lambda: bench.moves)


@pytest.mark.parametrize("bench", ["create2"], indirect=True)
def test_a_stopped_driver_leaves_it_at_rest_and_what_it_writes_when_it_goes_on_moves_nothing_old(bench: Bench) -> None:
    bench.driver.send_signal(signal.SIGSTOP)
    assert bench.wait(lambda: not bench.moves) < STOPS_WITHIN_S[bench.kind]
    moved = []
    bench.driver.send_signal(signal.SIGCONT)
    began_ns = bench.stand.clock.now_ns()
    bench.wait(lambda: moved.append(bench.moves) or bench.stand.clock.now_ns() - began_ns > S // 2)
    assert not any(moved)
    assert bench.driver.poll() is None
