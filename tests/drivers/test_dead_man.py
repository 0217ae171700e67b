"""The dead man's process: it stops a robot whose driver hangs or dies, and never one that is driven."""

import os
import select
import signal
import subprocess
import sys
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from robofleet.core.clock import MS, S, WallClock
from robofleet.drivers.dead_man import DeadMan
from robofleet.vehicles.interface import DriverError, WheelSpeeds

STOP = b"stop"
ASKED_S = 0.3  # from the last sign of life to the first stop
PATIENCE_S = 10.0
DRIVER = f"""
import sys, threading
from robofleet.drivers.dead_man import DeadMan
from robofleet.drivers.serial_port import SerialPort
port = SerialPort(sys.argv[1], 115200)
dead_man = DeadMan(port.descriptor, {STOP!r})
print(dead_man._process.pid, flush=True)
beat, goes_on = threading.Event(), sys.argv[2] == "for ever"
for _ in range(10):
    port.write(b".")
    dead_man.sign()
    beat.wait(0.01)
while goes_on:
    port.write(b".")
    dead_man.sign()
    beat.wait(0.01)
dead_man.close()
port.close()
print("closed", flush=True)
sys.stdin.read()
"""


def now_s() -> float:
    return WallClock().now_ns() / S


class Bench:
    """A driver's process on a pseudo-terminal, and the robot's end of it."""

    def __init__(self, how_long: str) -> None:
        self.robot, terminal = os.openpty()
        tty.setraw(terminal)
        self.driver = subprocess.Popen(
            [sys.executable, "-c", DRIVER, os.ttyname(terminal), how_long],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.driver.stdout is not None
        self.dead_man = psutil.Process(int(self.driver.stdout.readline()))
        self._terminal = terminal  # held: the robot's end must not be hung up by the driver's death

    def hear(self, what: bytes) -> float:
        """Wait until the robot has been told ``what``; returns when [s]."""
        data, until = b"", now_s() + PATIENCE_S
        while what not in data:
            assert select.select([self.robot], [], [], until - now_s())[0], f"only {data!r} came"
            data = data[-len(what) :] + os.read(self.robot, 4096)
        return now_s()

    def silence(self, seconds: float) -> bytes:
        """Return what the robot is told until nothing has come for so long."""
        data = b""
        while select.select([self.robot], [], [], seconds)[0]:
            data += os.read(self.robot, 4096)
        return data

    def close(self) -> None:
        self.driver.kill()
        self.driver.communicate()
        os.close(self.robot)
        os.close(self._terminal)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench("for ever")
    yield bench
    bench.close()


def gone(process: psutil.Process) -> bool:
    """Wait for its end; whoever adopted it may reap it later."""
    until = now_s() + PATIENCE_S
    while now_s() < until:
        if not process.is_running() or process.status() == psutil.STATUS_ZOMBIE:
            return True
        select.select([], [], [], 0.01)
    return False


def test_a_killed_driver_is_followed_by_stops_and_by_the_end_of_its_dead_man(bench: Bench) -> None:
    bench.hear(b"......")
    killed_s = now_s()
    bench.driver.kill()
    assert bench.hear(STOP) - killed_s < ASKED_S
    assert gone(bench.dead_man)
    assert bench.silence(0.0).count(STOP) >= 1, "the line may lose one: it is said more than once"


def test_a_stopped_driver_is_stopped_again_and_again_until_it_goes_on(bench: Bench) -> None:
    bench.hear(b"......")
    stopped_s = now_s()
    bench.driver.send_signal(signal.SIGSTOP)
    assert bench.hear(STOP) - stopped_s < ASKED_S
    bench.hear(STOP + STOP)
    bench.driver.send_signal(signal.SIGCONT)
    bench.hear(b"." * 30)  # more than its dead man's patience of 20, and no stop between
    assert bench.dead_man.is_running()


def test_what_ends_a_group_of_processes_does_not_end_the_dead_man_before_its_driver(bench: Bench) -> None:
    bench.hear(b"......")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        bench.dead_man.send_signal(number)
    bench.driver.kill()
    bench.hear(STOP)


def test_a_driver_that_says_goodbye_is_not_stopped_and_leaves_no_process() -> None:
    bench = Bench("a while")
    try:
        assert bench.driver.stdout is not None
        assert bench.driver.stdout.readline() == "closed\n"
        assert not bench.dead_man.is_running(), "nor a zombie: its driver is still there"
        assert bench.silence(0.3) == b"." * 10
    finally:
        bench.close()


@pytest.mark.slow
def test_it_costs_nearly_nothing(bench: Bench) -> None:
    bench.hear(b"......")
    before = sum(bench.dead_man.cpu_times()[:2])
    for _ in range(3):
        bench.hear(b"." * 30)  # 0.3 s of driving
    assert sum(bench.dead_man.cpu_times()[:2]) - before < 0.05
    assert bench.dead_man.memory_info().rss < 16e6


@pytest.fixture
def line() -> Iterator[tuple[int, int]]:
    """Return both ends of a line: the robot's, and the driver's."""
    ends = os.openpty()
    yield ends
    for end in ends:
        os.close(end)


def test_what_a_driver_still_wanted_when_it_hung_is_not_allowed_afterwards(line: tuple[int, int]) -> None:
    robot, terminal = line
    wheels = WheelSpeeds(3.0, 2.0)
    with closing(DeadMan(terminal, STOP)) as dead_man:
        assert dead_man.allow(wheels, 0) == wheels
        select.select([robot], [], [], PATIENCE_S)  # we hang, and the robot is stopped
        select.select([], [], [], 0.02)
        for now_ns in (S, S + 100 * MS, S + 290 * MS):
            assert dead_man.allow(wheels, now_ns) == (0.0, 0.0)
        assert dead_man.allow(wheels, S + 310 * MS) == wheels


def test_a_driver_whose_dead_man_died_is_told_so(line: tuple[int, int]) -> None:
    with closing(DeadMan(line[1], STOP)) as dead_man:
        dead_man.sign()
        process = psutil.Process(dead_man._process.pid)
        process.kill()
        process.wait(PATIENCE_S)
        with pytest.raises(DriverError, match="dead man"):
            dead_man.sign()
        dead_man.close()


def test_a_dead_man_that_does_not_start_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, line: tuple[int, int]
) -> None:
    silent = tmp_path / "python"
    silent.write_text("#!/bin/sh\n")
    silent.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(silent))
    with pytest.raises(DriverError, match="does not start"):
        DeadMan(line[1], STOP)


def test_the_dead_man_imports_next_to_nothing() -> None:
    program = Path(sys.modules[DeadMan.__module__].__file__ or "").with_name("dead_man_process.py")
    imported = {line.split()[1] for line in program.read_text().splitlines() if line.startswith(("import", "from"))}
    assert imported == {"os", "select", "signal", "sys"}
