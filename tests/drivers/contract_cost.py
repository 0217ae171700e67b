"""The contract's checks of what a driver costs: the processor, memory, descriptors, threads, processes."""

import gc
import os
import resource
import threading
import tracemalloc
from contextlib import suppress
from pathlib import Path

import pytest

from robofleet.vehicles.interface import DriverError
from tests.drivers import serial_world
from tests.drivers.contract_bench import Bench, Subject
from tests.drivers.contract_motion import cruise, on_the_line

LOOPS = 200
LOOP_COST_S = 0.8e-3  # of the processor, one read and a third of a write: 8 % at 100 Hz
OPENINGS = 8
HOUR_LOOPS = 360_000
LEFT_BYTES = 16.0  # a loop, at most: an object that stays is larger


class Cost:
    """``subject`` is what is tried."""

    subject: Subject

    def test_it_does_not_keep_the_processor_busy(self) -> None:
        with Bench(self.subject) as bench:
            bench.make()
            asked, before = cruise(self.subject, 1.0, 1.0), _processor_s()
            outside = 0.0
            for k in range(LOOPS):
                assert bench.driver is not None
                bench.driver.read()
                if k % 3 == 0:
                    bench.driver.write(asked)
                entered = _processor_s()
                bench.let_pass(0.01)
                outside += _processor_s() - entered
            assert _processor_s() - before - outside <= LOOPS * LOOP_COST_S

    def test_nothing_is_left_of_those_that_were_closed(self) -> None:
        with Bench(self.subject) as bench:
            left = []
            for _ in range(OPENINGS):
                bench.make()
                bench.drive(cruise(self.subject, 1.0, 1.0), 0.03)
                bench.give_up()
                bench.let_pass(0.1)
                left.append((len(serial_world.open_descriptors()), threading.active_count(), _children()))
        assert left[-1] == left[1]

    def test_nothing_is_left_of_those_that_could_not_be_made(self) -> None:
        on_the_line(self.subject)
        with Bench(self.subject._replace(twin="tests.drivers.strangers:Mute")) as bench:
            left = []
            for _ in range(OPENINGS // 2):
                with suppress(DriverError):
                    bench.make()
                bench.let_pass(0.1)
                left.append((len(serial_world.open_descriptors()), threading.active_count(), _children()))
        assert left[-1] == left[1]

    def test_its_memory_does_not_grow(self) -> None:
        self.assert_flat(200)

    @pytest.mark.slow
    def test_its_memory_does_not_grow_in_an_hour(self) -> None:
        self.assert_flat(HOUR_LOOPS)

    def assert_flat(self, loops: int) -> None:
        asked = cruise(self.subject, 1.0, -0.6)
        with Bench(self.subject) as bench:
            bench.make()
            bench.drive(asked, 1.0)
            gc.collect()
            tracemalloc.start()
            try:
                bench.drive(asked, 0.5)
                gc.collect()
                before = tracemalloc.get_traced_memory()[0]
                for _ in range(loops // 50):
                    bench.drive(asked, 0.5)
                gc.collect()
                grown = tracemalloc.get_traced_memory()[0] - before
            finally:
                tracemalloc.stop()
        assert grown <= LEFT_BYTES * loops


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _children() -> int:
    tasks = Path(f"/proc/{os.getpid()}/task").iterdir()
    return sum(len((task / "children").read_text().split()) for task in tasks)
