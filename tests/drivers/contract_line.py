"""The contract's checks of a line that is bad, of a robot that does not answer, and of a plug that is pulled out."""

import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from types import FrameType
from typing import Literal

import numpy as np
import pytest

from robofleet.clock import MS, S
from robofleet.comms.bus import MemoryBus
from robofleet.comms.keys import STATUS
from robofleet.comms.messages import ROBOT_STATUS
from robofleet.config.troubles import LineFault, LinkFault
from robofleet.processes.driver import DriverProcess
from robofleet.processes.keeping import MemoryKeeping
from robofleet.safety.gate import Latch
from robofleet.vehicles.interface import STOP, DriverError
from tests.drivers.contract_bench import LOOP_NS, Bench, Moment, Subject
from tests.drivers.contract_motion import OFF, OFF_RAD_S, SETTLE_S, cruise, mean, on_the_line, run_out

BAD_S, SHARE, LATE_S = 3.0, 0.1, 0.05
SILENT_S = 0.6  # at most, until a robot that does not answer is an error
WRONG_NS = 100 * MS  # at most, that a wheel aims at what nobody has told it
STALE_S = 0.2  # a reading of a healthy line is no older
PULLED_S = 1.0
TOLD_NS = 100 * MS
_BLOCKED_S = 2.0
_CALLS = 2000

LineTrouble = Literal["line_cut", "line_garbage", "line_late"]


class BadLines:
    """``subject`` is what is tried."""

    subject: Subject

    @pytest.mark.parametrize("kind", ["line_cut", "line_garbage", "line_late"])
    def test_bad_lines_are_borne(self, kind: LineTrouble) -> None:
        """No error but the driver's own, no angle that cannot be, no wrong motion that lasts; good again afterwards."""
        on_the_line(self.subject)
        asked = cruise(self.subject, 1.0, -0.6)
        with Bench(
            self.subject, LineFault(kind=kind, at_s=0.0, duration_s=BAD_S, share=SHARE, delay_s=LATE_S)
        ) as bench:
            bench.make()
            bench.drive(asked, SETTLE_S)
            bench.strike()
            moments = bench.drive_on(asked, BAD_S, hold=True)
            assert bench.twin is not None
            assert bench.twin.ledger is not None
            assert bench.twin.ledger.longest_ns <= WRONG_NS
            bench.drive_on(asked, SETTLE_S, hold=True)
            after = bench.drive(asked, 1.0)
        self.assert_possible(moments)
        assert mean(moments) == pytest.approx(asked, rel=0.5)
        assert mean(after) == pytest.approx(asked, rel=OFF, abs=OFF_RAD_S)
        if self.subject.encoders:
            self.assert_true(after)

    def assert_possible(self, moments: list[Moment]) -> None:
        """No wheel has turned between two readings by more than it can."""
        fastest, moved_ns = self.subject.drive.max_wheel_speed, moments[0].at_ns
        for before, now in pairwise(moments):
            if before.reading is None or now.reading is None or before.made != now.made:
                moved_ns = now.at_ns
                continue
            turned = max(abs(b - a) for a, b in zip(before.reading[:2], now.reading[:2], strict=True))
            assert turned <= fastest * ((now.at_ns - moved_ns) / S + LATE_S + STALE_S)
            if turned:
                moved_ns = now.at_ns

    def assert_true(self, moments: list[Moment]) -> None:
        """The angles of a driver are the true ones, but for where it began to count, and for their age."""
        for side in (0, 1):
            off = [moment.reading[side] - moment.angles[side] for moment in moments if moment.reading is not None]
            assert max(off) - min(off) <= STALE_S * self.subject.drive.max_wheel_speed

    def test_a_line_that_was_bad_leaves_the_angles_true(self) -> None:
        """What a driver read of bad lines is not in its angles for good."""
        on_the_line(self.subject)
        if not self.subject.encoders:
            pytest.skip("it has no encoders")
        asked = cruise(self.subject, 1.0, -0.6)
        faults = [
            LineFault(kind=kind, at_s=0.0, duration_s=BAD_S, share=SHARE)
            for kind in ("line_cut", "line_garbage", "line_late")
        ]
        with Bench(self.subject, *faults) as bench:
            bench.make()
            before = bench.drive(asked, SETTLE_S)[-1]
            bench.strike()
            bench.drive_on(asked, BAD_S, hold=True)
            after = bench.drive_on(asked, SETTLE_S, hold=True)[-1]
        if before.made == after.made:
            assert before.reading is not None
            assert after.reading is not None
            for side in (0, 1):
                turned = after.angles[side] - before.angles[side]
                assert after.reading[side] - before.reading[side] == pytest.approx(turned, abs=0.1 * max(asked))

    def test_a_robot_that_does_not_answer_is_an_error_and_stands_when_it_does_again(self) -> None:
        on_the_line(self.subject)
        asked = cruise(self.subject, 1.0, 1.0)
        with Bench(self.subject, LinkFault(kind="firmware_hangs", robot="r1", at_s=0.0, duration_s=PULLED_S)) as bench:
            bench.make()
            bench.drive(asked, SETTLE_S)
            bench.strike()
            silent = bench.drive_on(asked, PULLED_S)
            after = bench.drive_on(STOP, 4.0)
            assert bench.driver is not None, "it was not made again"
            driven = mean(bench.drive_on(asked, 1.0, hold=True)[50:])
        failed_s = next((k * LOOP_NS / S for k, moment in enumerate(silent) if moment.reading is None), math.inf)
        assert failed_s <= SILENT_S
        assert max(abs(b - a) for a, b in zip(after[0].angles, after[-1].angles, strict=True)) <= run_out(
            self.subject, asked
        )
        assert driven == pytest.approx(asked, rel=OFF, abs=OFF_RAD_S)

    @pytest.mark.parametrize("word", ["read", "write"])
    def test_a_plug_that_is_pulled_out_is_an_error_at_the_next_word(self, word: str) -> None:
        on_the_line(self.subject)
        asked = cruise(self.subject, 1.0, 1.0)
        with Bench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0, duration_s=PULLED_S)) as bench:
            driver = bench.make()
            bench.drive(asked, SETTLE_S)
            bench.strike()
            bench.let_pass(0.01)
            with pytest.raises(DriverError, match=bench.port.name):
                if word == "read":
                    driver.read()
                else:
                    driver.write(asked)

    def test_a_robot_that_is_plugged_in_again_drives_again(self) -> None:
        on_the_line(self.subject)
        asked = cruise(self.subject, 1.0, -0.6)
        with Bench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0, duration_s=PULLED_S)) as bench:
            bench.make()
            bench.drive(asked, SETTLE_S)
            bench.strike()
            bench.drive_on(asked, PULLED_S + 4.0)
            rest = bench.angles
            bench.drive(None, 0.5)
            assert bench.angles == pytest.approx(rest, abs=1e-3), "nobody told it to go on"
            bench.drive(asked, SETTLE_S)
            driven = mean(bench.drive(asked, 1.0))
        assert driven == pytest.approx(asked, rel=OFF, abs=OFF_RAD_S)

    def test_a_robot_that_turns_when_its_line_is_opened_stands_when_it_has_been(self) -> None:
        on_the_line(self.subject)
        asked, pulled_s = cruise(self.subject, 1.0, 1.0), 0.02
        with Bench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0, duration_s=pulled_s)) as bench:
            bench.make()
            bench.drive(asked, SETTLE_S)
            bench.strike()
            bench.let_pass(0.01)
            bench.give_up()
            bench.let_pass(0.02)
            bench.make()
            opened = bench.angles
            bench.drive(None, 1.0)
            assert max(abs(b - a) for a, b in zip(opened, bench.angles, strict=True)) <= run_out(self.subject, asked)

    def test_the_status_says_within_100_ms_that_the_plug_was_pulled_out(self) -> None:
        on_the_line(self.subject)
        with Bench(self.subject, LinkFault(kind="unplugged", robot="r1", at_s=0.0)) as bench:
            said: list[tuple[int, bytes]] = []
            bus = MemoryBus(bench.config.arena.name, bench.clock, 0)
            bus.listen(STATUS, "r1", lambda at_ns, payload: said.append((at_ns, payload)))
            wake, rng = (lambda _: None), np.random.default_rng(1)
            process = DriverProcess(bench.config, ("r1",), bus, bench.clock, wake, rng, MemoryKeeping())
            try:
                bench.run(process.step, 0.5)
                healthy_ns = bench.now_ns
                bench.strike()
                bench.run(process.step, 0.2)
            finally:
                with suppress(ExceptionGroup):  # its line is gone
                    process.close()
        statuses = [(at_ns, ROBOT_STATUS.decode(payload)) for at_ns, payload in said]
        failed = [at_ns for at_ns, status in statuses if status is not None and status.latch == Latch.DRIVER_FAILED]
        assert statuses[0][0] < healthy_ns < failed[0] <= healthy_ns + TOLD_NS

    def test_a_robot_that_takes_nothing_keeps_nobody_waiting(self) -> None:
        """A tty's buffer that is full: each call returns or raises, and none waits."""
        with Bench(self.subject) as bench:
            driver = bench.make()
            waited_ns = bench.waited_ns
            with _no_longer_than(_BLOCKED_S):
                for _ in range(_CALLS):
                    with suppress(DriverError, OSError):
                        driver.write(cruise(self.subject, 1.0, 1.0))
                    with suppress(DriverError, OSError):
                        driver.read()
                assert bench.waited_ns == waited_ns
                with suppress(DriverError, OSError):
                    driver.close()


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
