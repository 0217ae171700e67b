"""The contract's checks of motion: what is asked is what the wheels do, and no more."""

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

import pytest

from robofleet.testing.driver_bench import DriverBench, DriverSubject, Moment
from robofleet.vehicles.interface import DriverError, WheelSpeeds
from robofleet.vehicles.readings import SensorReading
from robofleet.vehicles.sensors import is_sound

CRUISE = 0.4  # of the fastest that a wheel may turn
SETTLE_S, EVEN_S = 0.6, 0.5
OFF = 0.02  # of what is asked: rounding, and wheels between two of their counts
OFF_RAD_S = 0.05
STOP_S = 0.1  # from a word to the motors' new target, at most
TURNS = {"left forward": (1, 0), "left backward": (-1, 0), "right forward": (0, 1), "right backward": (0, -1)}


def mean(moments: list[Moment]) -> WheelSpeeds:
    """Return the wheels' true mean speeds [rad/s]."""
    left, right = zip(*(moment.speeds for moment in moments), strict=True)
    return WheelSpeeds(sum(left) / len(left), sum(right) / len(right))


def travel(moments: list[Moment]) -> float:
    """Return how far the wheel that turned more has truly turned [rad]."""
    return max(abs(b - a) for a, b in zip(moments[0].angles, moments[-1].angles, strict=True))


def cruise(subject: DriverSubject, left: float, right: float) -> WheelSpeeds:
    """Return wheels at shares of a speed that every robot can do."""
    speed = CRUISE * subject.drive.max_wheel_speed
    return WheelSpeeds(left * speed, right * speed)


def run_out(subject: DriverSubject, wheels: WheelSpeeds) -> float:
    """Return how far a wheel may turn after the word to stand [rad]."""
    return max(map(abs, wheels)) * (subject.drive.motor_lag + STOP_S)


def on_the_line(subject: DriverSubject) -> None:
    """Skip a check of the line where there is none."""
    if subject.twin is None:
        pytest.skip("its driver simulates it: there is no line")


class Checks:
    """What all checks have: ``subject``, the driver under test."""

    subject: DriverSubject

    @property
    def setpoint(self) -> WheelSpeeds:
        """Commanded speeds that differ."""
        return cruise(self.subject, 1.0, -0.6)

    @contextmanager
    def driving(self, wheels: WheelSpeeds | None, faster: float = 1.0) -> Iterator[DriverBench]:
        """Give a bench whose driver is made and whose wheels turn evenly."""
        with DriverBench(self.subject, faster=faster) as bench:
            bench.make()
            bench.drive(wheels, SETTLE_S)
            yield bench


class Motion(Checks):
    """Checks of motion."""

    def test_it_tells_of_its_sensors_where_it_is_asked(self) -> None:
        with DriverBench(self.subject) as bench:
            bench.make()
            moments = bench.drive(cruise(self.subject, 1, -1), SETTLE_S)
            sensors = [moment.reading.sensors for moment in moments if moment.reading is not None]
            if not self.subject.sensors:
                assert set(sensors) <= {None, SensorReading()}
                return
            known = [reading for reading in sensors if reading not in (None, SensorReading())]
            places = bench.sensors.places if bench.sensors is not None else ()
            assert known, "it tells of none"
            assert all(is_sound(reading) and len(reading.distances or places) == len(places) for reading in known)
            assert len(set(known)) > 3, "it tells the same all the time"

    @pytest.mark.parametrize("turn", TURNS)
    def test_each_wheel_turns_as_it_is_told(self, turn: str) -> None:
        setpoint = cruise(self.subject, *TURNS[turn])
        with self.driving(setpoint) as bench:
            done = mean(bench.drive(setpoint, EVEN_S))
        assert done == pytest.approx(setpoint, rel=OFF, abs=OFF_RAD_S)

    def test_the_angles_that_it_reads_are_those_that_the_wheels_turned(self) -> None:
        with self.driving(self.setpoint) as bench:
            first, *_, last = bench.drive(self.setpoint, 1.0)
        assert first.reading is not None
        assert last.reading is not None
        for side in (0, 1):
            turned = last.angles[side] - first.angles[side] if self.subject.encoders else 0.0
            assert last.reading[:2][side] - first.reading[:2][side] == pytest.approx(turned, rel=0.05)

    def test_the_speeds_that_it_reads_are_those_of_the_wheels(self) -> None:
        with self.driving(self.setpoint) as bench:
            moments = bench.drive(self.setpoint, 1.0)
        for side in (0, 1):
            read = [moment.reading[2:4][side] for moment in moments if moment.reading is not None]
            turned = mean(moments)[side] if self.subject.encoders else 0.0
            assert sum(read) / len(read) == pytest.approx(turned, rel=0.1)

    def test_a_robot_in_health_says_so(self) -> None:
        with DriverBench(self.subject) as bench:
            bench.make()
            readings = [moment.reading for moment in bench.drive(cruise(self.subject, 1.0, 1.0), 1.0)]
        for reading in readings:
            assert reading is not None
            assert all(map(math.isfinite, reading[:4]))
            assert math.isnan(reading.battery) or 0.0 <= reading.battery <= 1.0
            assert reading.faults == 0

    def test_it_stands_until_it_is_told_to_move(self) -> None:
        with DriverBench(self.subject) as bench:
            bench.make()
            moments = bench.drive(None, 1.0)
            assert bench.fastest == 0.0
        assert moments[-1].reading is not None
        assert moments[-1].reading[:4] == (0.0, 0.0, 0.0, 0.0)

    def test_it_never_turns_faster_than_it_may(self) -> None:
        drive = self.subject.drive
        straight = min(drive.max_wheel_speed, drive.max_speed / drive.wheel_radius)
        for left, right in (
            (straight, straight),
            (-straight, -straight),
            (drive.max_wheel_speed, -drive.max_wheel_speed),
        ):
            with self.driving(WheelSpeeds(left, right), faster=2.0) as bench:
                done = mean(bench.drive(WheelSpeeds(left, right), EVEN_S))
            assert max(map(abs, done)) <= 1.01 * abs(left)  # what its gate allows
            assert abs(done.left + done.right) / 2.0 <= 1.01 * drive.max_speed / drive.wheel_radius

    def test_it_stops_by_itself_when_it_is_told_nothing_more(self) -> None:
        """Reading goes on: that must not keep it moving."""
        silence_s = self.subject.stops_after_s
        if silence_s is None:
            pytest.skip("this robot does not stop by itself: drivers/dead_man.py does it for a process that is dead")
        setpoint = cruise(self.subject, 1.0, 1.0)
        with self.driving(setpoint) as bench:
            moments = bench.drive(None, silence_s + 1.0)
        assert travel(moments) <= run_out(self.subject, setpoint) + silence_s * max(setpoint)
        assert max(map(abs, moments[-1].speeds)) < OFF_RAD_S

    def test_it_stands_when_it_was_closed(self) -> None:
        with self.driving(self.setpoint) as bench:
            assert bench.driver is not None
            bench.driver.close()
            before = bench.angles
            bench.let_pass(1.0)
            rest = bench.angles
            bench.let_pass(0.5)
            assert max(abs(b - a) for a, b in zip(before, rest, strict=True)) <= run_out(self.subject, self.setpoint)
            assert bench.angles == pytest.approx(rest, abs=1e-3)

    def test_nothing_is_written_after_it_was_closed(self) -> None:
        """Not to the robot, and not to a file that got the line's number since."""
        on_the_line(self.subject)  # a robot of lockstep outlives its driver's process
        with self.driving(cruise(self.subject, 1.0, 1.0)) as bench, ExitStack() as files:
            driver = bench.driver
            assert driver is not None
            bench.give_up()
            others = [files.enter_context(tempfile.TemporaryFile()) for _ in range(5)]
            bench.let_pass(1.0)
            rest = bench.angles
            for _ in range(30):
                with suppress(DriverError, OSError):
                    driver.write(cruise(self.subject, 1.0, 1.0))
                with suppress(DriverError, OSError):
                    driver.read()
                assert bench.unheard() == 0
                bench.let_pass(0.03)
            assert bench.angles == pytest.approx(rest, abs=1e-3)
            assert [os.fstat(other.fileno()).st_size for other in others] == [0] * 5
