"""A Create 2 whose driver's process is killed or stopped: its dead man stops it; nothing old moves it later."""

import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robofleet.core.clock import S, WallClock
from robofleet.vehicles.interface import STOP
from tests.twins import TwinStand, config_of

ASKED_S, PATIENCE_S = 0.3, 10.0
DRIVER = """
import select, sys
from robofleet.drivers.create2 import Create2
from robofleet.core.clock import WallClock
from robofleet.vehicles.interface import DriverContext, WheelSpeeds
from tests.robots import CREATE2
clock = WallClock()
settings = Create2.Settings(port=sys.argv[1])
robot = Create2(DriverContext(robot="r1", drive=CREATE2, simulation=None, now_ns=clock.now_ns, settings=settings))
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

    def __init__(self, folder: Path) -> None:
        self.stand = TwinStand(config_of(twin="create2", vehicle="create2"), folder, WallClock())
        self.start()

    def start(self) -> None:
        self.driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(self.stand.port)])

    @property
    def moves(self) -> bool:
        return self.stand.twin._target != STOP

    def wait(self, condition: Callable[[], bool]) -> float:
        """Wait until it holds; returns how long that took [s]."""
        began_ns = self.stand.clock.now_ns()
        while not condition():
            took_s = (self.stand.clock.now_ns() - began_ns) / S
            assert took_s < PATIENCE_S
            select.select([], [], [], 0.002)
        return (self.stand.clock.now_ns() - began_ns) / S


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    with bench.stand.running():
        bench.wait(lambda: bench.moves)
        yield bench
        bench.driver.kill()
        bench.driver.wait()
    bench.stand.twin.close()


def test_a_killed_driver_leaves_it_at_rest_and_its_successor_may_have_the_port(bench: Bench) -> None:
    bench.driver.kill()
    assert bench.wait(lambda: not bench.moves) < ASKED_S
    bench.driver.wait()
    bench.wait(lambda: not bench.stand.twin._line.open)  # its dead man has ended too
    bench.start()
    bench.wait(lambda: bench.moves)


def test_a_stopped_driver_leaves_it_at_rest_and_what_it_writes_when_it_goes_on_moves_nothing_old(bench: Bench) -> None:
    bench.driver.send_signal(signal.SIGSTOP)
    assert bench.wait(lambda: not bench.moves) < ASKED_S
    moved = []
    bench.driver.send_signal(signal.SIGCONT)
    began_ns = bench.stand.clock.now_ns()
    bench.wait(lambda: moved.append(bench.moves) or bench.stand.clock.now_ns() - began_ns > S // 2)
    assert not any(moved)
    assert bench.driver.poll() is None
