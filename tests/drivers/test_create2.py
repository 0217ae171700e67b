"""The driver of a Create 2: what it tells the robot, what it understands, when something is wrong."""

import math
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robofleet.drivers.create2 import MODE_LOST, MOTORS_OFF, Create2
from robofleet.simulation.firmwares.create2 import Mode
from robofleet.vehicles.interface import STOP, DriverError, RobotFault, WheelSpeeds
from tests.drivers.line_bench import MM_S, LineBench, create2
from tests.robots import CREATE2

COUNT = 2 * math.pi / 508.8  # [rad]
SPEEDS = st.floats(-CREATE2.max_wheel_speed, CREATE2.max_wheel_speed)
FORWARD = WheelSpeeds(5.0, 5.0)


@pytest.fixture
def bench() -> Iterator[LineBench]:
    with create2() as bench:
        bench.open()
        yield bench


def test_opening_stops_whatever_it_did_and_returns_when_it_streams() -> None:
    with create2() as bench:
        bench.firmware.receive(bytes((128, 132, 145, 0, 200, 0, 200)), 0)
        reading = bench.open(mode="safe").read()
        assert bench.hardware.command == STOP
        assert bench.firmware.mode is Mode.SAFE
        assert reading[:2] == (0.0, 0.0)
        assert reading.battery == pytest.approx(1.0, abs=0.01)
        assert reading.faults == 0
        assert b"".join(bench.received).lstrip(b"\0").startswith(bytes((145, 0, 0, 0, 0, 128))), (
            "rest is the first thing said"
        )


@given(left=SPEEDS, right=SPEEDS)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_each_wheel_is_told_its_own_speed_to_half_a_millimetre_a_second(
    bench: LineBench, left: float, right: float
) -> None:
    bench.write(left, right)
    target = bench.hardware.command
    assert target == pytest.approx((left, right), abs=0.8 * MM_S)
    assert max(map(abs, target)) <= CREATE2.max_wheel_speed
    bench.write(0.0, 0.0)
    assert bench.hardware.command == STOP


def test_what_it_goes_by_already_is_not_said_again_until_it_goes_by_something_else(bench: LineBench) -> None:
    def drive(ticks: int) -> None:
        for _ in range(ticks):
            bench.write(*FORWARD)
            for _ in range(3):
                bench.let_pass(0.011)
                bench.read()

    bench.pass_time(0.1, STOP)
    bench.received.clear()
    drive(4)
    assert b"\x91" in b"".join(bench.received)
    bench.received.clear()
    drive(30)
    assert not bench.received
    bench.firmware.receive(bytes((145, 0, 10, 0, 10)), bench.now_ns)  # nobody's command
    drive(3)
    assert bench.hardware.command == pytest.approx(FORWARD, abs=MM_S)


def test_a_command_that_was_cut_is_completed_however_often_it_was_said_before(bench: LineBench) -> None:
    bench.pass_time(0.2, FORWARD)
    for length in range(1, 5):
        bench.to_robot = lambda data, length=length: data[:length]  # type: ignore[misc]
        bench.write(3.0 + length, 2.0)
        bench.to_robot = bytes
        for _ in range(3):
            bench.let_pass(0.011)
        bench.write(3.0 + length, 2.0)
        assert bench.hardware.command == pytest.approx((3.0 + length, 2.0), abs=MM_S)
        bench.pass_time(0.2, WheelSpeeds(3.0 + length, 2.0))


def test_angles_are_those_of_the_wheels_through_their_counters_overflow(bench: LineBench) -> None:
    opened = bench.plant.reading()
    for wheels in (WheelSpeeds(13.0, -13.0), WheelSpeeds(-13.0, -6.0)):
        bench.pass_time(4.0, wheels)
        reading, true = bench.read(), bench.plant.reading()
        since = 13.0 * 0.015 + COUNT  # a frame is up to 15 ms old
        assert reading.left_angle == pytest.approx(true.left_angle - opened.left_angle, abs=since)
        assert reading.right_angle == pytest.approx(true.right_angle - opened.right_angle, abs=since)
        assert (reading.left_speed, reading.right_speed) == pytest.approx(wheels, rel=0.2)
    bench.pass_time(1.0, STOP)
    assert bench.read()[2:4] == (0.0, 0.0)


@pytest.mark.parametrize("fault", [RobotFault.BUMPED, RobotFault.CLIFF, RobotFault.WHEEL_DROPPED, RobotFault.CHARGING])
def test_what_the_robot_feels_is_its_fault_as_long_as_it_feels_it(bench: LineBench, fault: RobotFault) -> None:
    bench.hardware.feels = fault
    assert bench.pass_time(0.03)[-1].faults == fault
    assert bench.pass_time(1.0, STOP)[-1].faults == fault
    bench.hardware.feels = RobotFault(0)
    assert bench.pass_time(0.06, STOP)[-1].faults == 0
    assert bench.firmware.mode is Mode.SAFE


def test_what_it_felt_for_one_frame_between_two_readings_is_read(bench: LineBench) -> None:
    bench.hardware.feels = RobotFault.BUMPED
    bench.let_pass(0.015)
    bench.hardware.feels = RobotFault(0)
    bench.let_pass(0.015)
    assert bench.read().faults == RobotFault.BUMPED
    assert bench.pass_time(0.03)[-1].faults == 0


def test_a_motor_that_draws_too_much_is_at_fault_only_when_that_lasts(bench: LineBench) -> None:
    for _ in range(10):
        bench.hardware.feels = RobotFault.OVERCURRENT
        assert not any(reading.faults for reading in bench.pass_time(0.15, FORWARD))
        bench.hardware.feels = RobotFault(0)
        bench.pass_time(0.03, FORWARD)
    bench.hardware.feels = RobotFault.OVERCURRENT
    assert bench.pass_time(0.5, FORWARD)[-1].faults == RobotFault.OVERCURRENT


@pytest.mark.parametrize("fault", [RobotFault.CLIFF, RobotFault.WHEEL_DROPPED])
def test_its_own_stop_in_safe_mode_is_not_undone_while_its_cause_is_there(bench: LineBench, fault: RobotFault) -> None:
    bench.pass_time(0.1, FORWARD)
    bench.hardware.feels = fault
    bench.pass_time(0.03)
    bench.pass_time(1.0, FORWARD)  # no gate would
    assert bench.hardware.command == STOP
    assert bench.firmware.mode is Mode.PASSIVE


def test_a_robot_that_begins_to_clean_is_brought_back_by_the_next_command(bench: LineBench) -> None:
    bench.firmware.receive(bytes((135,)), bench.now_ns)
    assert bench.hardware.command.left > 0.0
    assert not any(reading.faults for reading in bench.pass_time(0.04, STOP))
    assert bench.firmware.mode is Mode.SAFE
    assert bench.hardware.command == STOP


def test_a_mode_that_does_not_come_back_is_a_fault(bench: LineBench) -> None:
    bench.to_robot = lambda data: b""
    bench.firmware.receive(bytes((128,)), bench.now_ns)
    readings = bench.pass_time(0.3, STOP)
    assert readings[3].faults == 0
    assert readings[-1].faults == MODE_LOST


def test_full_mode_is_said_so() -> None:
    with create2() as bench:
        bench.open(mode="full")
        bench.hardware.feels = RobotFault.CLIFF
        assert bench.pass_time(0.1, FORWARD)[-1].faults == RobotFault.CLIFF
        assert bench.firmware.mode is Mode.FULL
        assert bench.hardware.command != STOP, "its gate stops it: the robot itself does not"


def test_a_robot_that_falls_silent_is_asked_again_then_it_is_an_error(bench: LineBench) -> None:
    bench.firmware.receive(bytes((150, 0)), bench.now_ns)  # the stream pauses
    bench.pass_time(0.2, STOP)
    assert bench.firmware.loop(bench.now_ns)
    bench.firmware.receive(bytes((150, 0)), bench.now_ns)
    bench.to_robot = lambda data: b""
    bench.pass_time(0.49)
    with pytest.raises(DriverError, match="said nothing"):
        bench.pass_time(0.03)


def test_closing_is_said_again_when_the_robot_has_not_heard_it(bench: LineBench) -> None:
    bench.pass_time(0.2, FORWARD)
    answers = iter([b"", b""])
    bench.to_robot = lambda data: next(answers, data) if data else data
    bench.driver.close()
    bench.hear()
    assert bench.hardware.command == STOP
    assert bench.firmware.mode is Mode.OFF


def test_a_command_from_before_a_hang_moves_nothing_after_its_dead_man_s_stop(bench: LineBench) -> None:
    bench.pass_time(0.2, FORWARD)
    old = bytes((0, 0, 0, 0, 145, 0, 100, 0, 100))
    bench.firmware.receive(MOTORS_OFF + old, bench.now_ns)
    assert bench.hardware.command == STOP
    assert not any(reading.faults for reading in bench.pass_time(0.1, STOP))
    bench.write(*FORWARD)
    assert bench.hardware.command != STOP


def test_after_a_hang_it_comes_back_into_its_mode_and_does_nothing_old() -> None:
    with create2() as bench:
        bench.open(silent_s=0.5)
        bench.pass_time(0.2, FORWARD)
        while bench.hardware.command != STOP:
            bench.hear()  # from its dead man: we say nothing
        assert bench.pass_time(0.1)[-1].faults == 0
        assert bench.firmware.mode is Mode.SAFE
        bench.write(*FORWARD)
        assert bench.hardware.command == STOP
        bench.skip(0.3)
        bench.write(*FORWARD)
        assert bench.hardware.command != STOP


@pytest.mark.parametrize("answer", [b"", b"57600\r\n", bytes((19, 44)) * 30])
def test_what_is_no_create_2_is_named_and_its_port_is_free_again(answer: bytes) -> None:
    with create2() as bench:
        bench.to_driver, bench.babble = lambda _: b"", answer
        with pytest.raises(DriverError, match=rf"{bench.port}: the device that answers is not a Create 2"):
            bench.open()
        bench.to_driver, bench.babble = bytes, b""
        bench.open()


def test_wheels_that_are_asked_for_more_than_it_can_are_refused() -> None:
    assert Create2.refusals(Create2.Settings(port="x"), CREATE2) == []
    ((key, words),) = Create2.refusals(Create2.Settings(port="x", wheel_diameter_m=0.08), CREATE2)
    assert key == "vehicle.max_wheel_speed_rad_s"
    assert "12.5 rad/s at most" in words
