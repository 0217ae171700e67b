"""The contract's checks of what a driver costs: the processor, memory, descriptors, threads, processes."""

import gc
import os
import resource
import threading
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robofleet.core.clock import S
from robofleet.testing.driver_bench import LOOP_NS, DriverBench, DriverSubject
from robofleet.testing.driver_motion import Checks, cruise, on_the_line
from robofleet.testing.serial_world import open_descriptors
from robofleet.vehicles.interface import DriverError

LOOPS = 200
LOOP_COST_S = 0.8e-3  # of the processor, one read and a third of a write: 8 % at 100 Hz
OPENINGS = 8
HOUR_LOOPS = 360_000
LEFT_BYTES = 16.0  # a loop, at most: an object that stays is larger


class Cost(Checks):
    """Checks of cost."""

    def test_it_does_not_keep_the_processor_busy(self) -> None:
        with DriverBench(self.subject) as bench:
            bench.make()
            before = _processor_s()
            outside = 0.0
            for k in range(LOOPS):
                assert bench.driver is not None
                bench.driver.read()
                if k % 3 == 0:
                    bench.driver.write(self.setpoint)
                entered = _processor_s()
                bench.let_pass(0.01)
                outside += _processor_s() - entered
            assert _processor_s() - before - outside <= LOOPS * LOOP_COST_S

    def test_nothing_is_left_of_those_that_were_closed(self) -> None:
        self.assert_nothing_left(self.subject, OPENINGS)

    @pytest.mark.slow
    @pytest.mark.long
    def test_nothing_is_left_of_a_hundred_that_were_closed(self) -> None:
        self.assert_nothing_left(self.subject, 100)

    def test_nothing_is_left_of_those_that_could_not_be_made(self) -> None:
        on_the_line(self.subject)
        self.assert_nothing_left(replace(self.subject, twin="robofleet.testing.driver_port:Mute"), OPENINGS)

    def assert_nothing_left(self, subject: DriverSubject, openings: int) -> None:
        """Descriptors, threads and processes are as many after the last as after the second."""
        others, left = _belongings(), []  # of whatever else this process does, which may end meanwhile
        with DriverBench(subject) as bench:
            for _ in range(openings):
                with suppress(DriverError):
                    bench.make()
                    bench.drive(cruise(self.subject, 1.0, 1.0), 0.03)
                    bench.give_up()
                bench.let_pass(0.1)
                left.append([len(now - before) for now, before in zip(_belongings(), others, strict=True)])
        assert left[-1] == left[1]

    @pytest.mark.slow
    def test_its_memory_does_not_grow(self) -> None:
        loops = 100
        with self.driving(self.setpoint) as bench:
            tracemalloc.start()
            try:
                before = self.held_after(bench, 400)  # buffers of the robot are full by now
                grown = self.held_after(bench, loops) - before
            finally:
                tracemalloc.stop()
        assert grown <= LEFT_BYTES * loops

    @pytest.mark.slow
    @pytest.mark.long
    def test_its_memory_does_not_grow_in_an_hour(self) -> None:
        with self.driving(self.setpoint) as bench:
            before = _resident_bytes()
            for _ in range(HOUR_LOOPS // 3000):
                bench.drive(self.setpoint, 30.0)
            assert _resident_bytes() - before <= LEFT_BYTES * HOUR_LOOPS

    def held_after(self, bench: DriverBench, loops: int) -> int:
        """Return what Python has allocated after so many loops [bytes]."""
        bench.drive(self.setpoint, loops * LOOP_NS / S)
        gc.collect()
        return tracemalloc.get_traced_memory()[0]


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _belongings() -> tuple[set[Any], ...]:
    """Return this process's descriptors, threads and children."""
    tasks = Path(f"/proc/{os.getpid()}/task").iterdir()
    children = {child for task in tasks for child in (task / "children").read_text().split()}
    return set(open_descriptors()), set(threading.enumerate()), children
