"""The contract's checks of a line that is bad, of a robot that does not answer, and of a plug that is pulled out."""

import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from types import FrameType
from typing import Literal

import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import STATUS
from robofleet.bus.messages import UNIT_STATUS
from robofleet.config.troubles import LineFault, LinkFault
from robofleet.core.clock import MS, S
from robofleet.nodes.unit.driver import DriverProcess
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.nodes.unit.state_store import MemoryStateStore
from robofleet.safety.latches import Latch
from robofleet.testing.driver_bench import LOOP_NS, DriverBench, Moment
from robofleet.testing.driver_motion import EVEN_S, OFF, OFF_RAD_S, SETTLE_S, Checks, mean, on_the_line, run_out, travel
from robofleet.vehicles.interface import DriverError, RobotFault

BAD_S, SHARE, LATE_S = 2.0, 0.15, 0.05
SILENT_S = 0.6  # at most, until a robot that does not answer is an error
WRONG_NS = 100 * MS  # at most, that a wheel aims at what nobody has told it
STALE_S = 0.2  # a reading of a healthy line is no older
AWAY_S, BACK_S = 1.0, 1.0
SEEN_S = 0.3  # at most, until a robot that is back is stopped
TOLD_NS = 100 * MS
_BLOCKED_S = 2.0
_CALLS = 1000

LineTrouble = Literal["line_cut", "line_garbage", "line_late"]


class BadLines(Checks):
    """Checks of bad lines."""

    def driven(self, bench: DriverBench, *, hold: bool = False) -> list[Moment]:
        """Drive until the wheels turn evenly, and return the half second after that."""
        if bench.driver is None:
            bench.make()
        bench.drive_on(self.setpoint, SETTLE_S, hold=hold)
        return bench.drive_on(self.setpoint, EVEN_S, hold=hold)

    @pytest.mark.parametrize("kind", ["line_cut", "line_garbage", "line_late"])
    def test_bad_lines_are_borne(self, kind: LineTrouble) -> None:
        """No error but the driver's own, no angle that cannot be, no wrong motion that lasts; good again afterwards."""
        on_the_line(self.subject)
        fault = LineFault(kind=kind, at_s=0.0, duration_s=BAD_S, share=SHARE, delay_s=LATE_S)
        with DriverBench(self.subject, fault) as bench:
            before = self.driven(bench, hold=True)
            bench.strike()
            during = bench.drive_on(self.setpoint, BAD_S, hold=True)
            after = self.driven(bench, hold=True)
            assert bench.twin is not None
            assert bench.twin.ledger is not None
            assert bench.twin.ledger.longest_ns <= WRONG_NS
        assert mean(during) == pytest.approx(mean(before), rel=0.5)
        assert mean(after) == pytest.approx(mean(before), rel=OFF, abs=OFF_RAD_S)
        self.assert_possible([*during, *after])
        if before[-1].made == after[-1].made:
            self.assert_counted(before[-1], after[-1])

    def assert_possible(self, moments: list[Moment]) -> None:
        """No wheel has turned between two readings by more than it can."""
        fastest, moved_ns = self.subject.drive.max_wheel_speed, moments[0].at_ns
        for before, now in pairwise(moments):
            turned = math.inf
            if before.reading is not None and now.reading is not None and before.made == now.made:
                turned = max(abs(b - a) for a, b in zip(before.reading[:2], now.reading[:2], strict=True))
                assert turned <= fastest * ((now.at_ns - moved_ns) / S + STALE_S)
            if turned:
                moved_ns = now.at_ns

    def assert_counted(self, before: Moment, after: Moment) -> None:
        """What a driver read of bad lines is not in its angles for good."""
        assert before.reading is not None
        assert after.reading is not None
        for side in (0, 1):
            turned = abs(after.angles[side] - before.angles[side]) if self.subject.encoders else 0.0
            read = abs(after.reading[:2][side] - before.reading[:2][side])
            assert read == pytest.approx(turned, abs=STALE_S * max(self.setpoint))

    def test_a_robot_that_does_not_answer_is_an_error_and_stands_when_it_does_again(self) -> None:
        on_the_line(self.subject)
        with DriverBench(
            self.subject, LinkFault(kind="firmware_hangs", robot="r1", at_s=0.0, duration_s=AWAY_S)
        ) as bench:
            before = self.driven(bench)
            bench.strike()
            silent = bench.drive_on(self.setpoint, AWAY_S)
            returned = bench.drive_on(None, BACK_S)
            assert bench.driver is not None, "it was not made again"
            after = self.driven(bench)
        failed_s = next((k * LOOP_NS / S for k, moment in enumerate(silent) if moment.reading is None), math.inf)
        assert failed_s <= SILENT_S
        assert travel(returned) <= run_out(self.subject, self.setpoint) + SEEN_S * max(self.setpoint)
        assert mean(after) == pytest.approx(mean(before), rel=OFF, abs=OFF_RAD_S)

    @pytest.mark.parametrize("word", ["read", "write"])
    def test_a_plug_that_is_pulled_out_is_an_error_at_the_next_word(self, word: str) -> None:
        on_the_line(self.subject)
        with DriverBench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0)) as bench:
            driver = bench.make()
            bench.drive(self.setpoint, 0.3)
            bench.strike()
            bench.let_pass(0.01)
            with pytest.raises(DriverError, match=bench.port.name):
                if word == "read":
                    driver.read()
                else:
                    driver.write(self.setpoint)

    def test_a_robot_that_is_plugged_in_again_stands_and_drives_again(self) -> None:
        on_the_line(self.subject)
        with DriverBench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0, duration_s=AWAY_S)) as bench:
            before = self.driven(bench)
            bench.strike()
            bench.drive_on(self.setpoint, AWAY_S)
            returned = bench.drive_on(None, BACK_S)
            assert bench.driver is not None, "it was not made again"
            after = self.driven(bench)
        assert travel(returned) <= run_out(self.subject, self.setpoint) + SEEN_S * max(self.setpoint)
        assert mean(after) == pytest.approx(mean(before), rel=OFF, abs=OFF_RAD_S)

    def test_a_robot_that_turns_when_its_line_is_opened_stands_when_it_has_been(self) -> None:
        on_the_line(self.subject)
        with DriverBench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0, duration_s=0.02)) as bench:
            bench.make()
            bench.drive(self.setpoint, SETTLE_S)
            bench.strike()
            bench.let_pass(0.01)
            bench.give_up()
            bench.let_pass(0.02)
            bench.make()
            assert travel(bench.drive(None, 1.0)) <= run_out(self.subject, self.setpoint)

    def test_the_status_says_within_100_ms_that_the_plug_was_pulled_out(self) -> None:
        on_the_line(self.subject)
        with DriverBench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0)) as bench:
            payloads: list[tuple[int, bytes]] = []
            bus = MemoryBus(bench.config.arena.name, bench.clock, 0)
            bus.listen(STATUS, "r1", lambda at_ns, payload: payloads.append((at_ns, payload)))
            process = DriverProcess(
                bench.config, "r1", bus, bench.clock, lambda _: None, 77, 0, MemoryStateStore(),
                ConfiguredDrivers(bench.config, bench.clock.now_ns),
            )  # fmt: skip
            try:
                bench.run(process.step, 0.5)
                healthy_ns = bench.now_ns
                bench.strike()
                bench.run(process.step, 0.2)
            finally:
                with suppress(ExceptionGroup):  # its line is gone
                    process.close()
        decoded = [(at_ns, UNIT_STATUS.decode(payload)) for at_ns, payload in payloads]
        statuses = [(at_ns, unit.robots[0]) for at_ns, unit in decoded if unit is not None]
        lost = [at_ns for at_ns, status in statuses if status.faults & RobotFault.UNREACHABLE]
        latched = [at_ns for at_ns, status in statuses if status.latch == Latch.DRIVER_FAILED]
        assert statuses[0][0] < healthy_ns < lost[0] == latched[0] <= healthy_ns + TOLD_NS

    def test_a_robot_that_takes_nothing_keeps_nobody_waiting(self) -> None:
        """A tty's buffer that is full: each call returns or raises, and none waits."""
        with DriverBench(self.subject) as bench:
            driver = bench.make()
            waited_ns = bench.waited_ns
            try:
                with _no_longer_than(_BLOCKED_S):
                    for _ in range(_CALLS):
                        with suppress(DriverError, OSError):
                            driver.write(self.setpoint)
                        with suppress(DriverError, OSError):
                            driver.read()
                        assert bench.waited_ns == waited_ns
                        bench.clock.advance_to(bench.now_ns + LOOP_NS)
                    with suppress(DriverError, OSError):
                        driver.close()
            finally:
                bench.let_pass(0.2)  # now there is room, also for one that waits for it


@contextmanager
def _no_longer_than(seconds: float) -> Iterator[None]:
    def late(_number: int, _frame: FrameType | None) -> None:
        raise AssertionError(f"{_CALLS} calls took more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
