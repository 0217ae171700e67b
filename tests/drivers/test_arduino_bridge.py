"""ros_arduino_bridge's driver: what it says over a line that loses and spoils bytes, and what it makes of answers."""

import itertools
import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robofleet.core.clock import S
from robofleet.drivers.arduino_bridge import ArduinoBridge
from robofleet.simulation.firmwares.arduino_bridge import ArduinoBridgeFirmware
from robofleet.vehicles.interface import STOP, DriverError, DriverReading, WheelSpeeds
from tests.drivers.line_bench import COUNTS_PER_TURN, FRAME_S, LineBench, arduino
from tests.robots import GTERNAL

RAD_S = math.tau / COUNTS_PER_TURN / FRAME_S  # one count a frame
Targets = tuple[int, int]


def drive(bench: LineBench, left: float, right: float) -> None:
    """Tell the wheels, in counts a frame, one frame later."""
    bench.let_pass(FRAME_S)
    command(bench, left, right)


def command(bench: LineBench, left: float, right: float) -> None:
    """Tell the wheels, in counts a frame, just before the speed loop looks."""
    bench.driver.write(WheelSpeeds(left * RAD_S, right * RAD_S))
    assert bench.hear()
    bench.firmware.loop(bench.now_ns)


def poll(bench: LineBench) -> DriverReading:
    """Return what the driver reads of the counts of 20 ms later."""
    bench.let_pass(0.02)
    bench.driver.read()
    assert bench.hear()
    reading: DriverReading = bench.driver.read()
    return reading


def turned(bench: LineBench) -> np.ndarray:
    """Return what the wheels have truly turned [counts]."""
    return np.array(bench.plant.reading()[:2]) * COUNTS_PER_TURN / math.tau


def off(bench: LineBench, reading: DriverReading) -> float:
    """Return how far what was read is from what the wheels have turned [counts]."""
    return float(np.abs(np.array(reading[:2]) * COUNTS_PER_TURN / math.tau - turned(bench)).max())


def target(hardware: Any) -> Targets:
    """Return what the motors are told, in counts a frame."""
    return round(hardware.command.left / RAD_S), round(hardware.command.right / RAD_S)


def board() -> tuple[ArduinoBridgeFirmware, Any]:
    """Return a sketch and its wheels."""
    wheels = SimpleNamespace(radians_per_count=math.tau / COUNTS_PER_TURN, loop_period=FRAME_S, counts=(0, 0))
    return ArduinoBridgeFirmware(wheels), wheels  # type: ignore[arg-type]


@pytest.fixture
def unmet() -> Iterator[LineBench]:
    with arduino() as bench:
        yield bench


@pytest.fixture
def bench(unmet: LineBench) -> LineBench:
    """Return a bench whose driver has met its robot."""
    unmet.open(counts_per_turn=COUNTS_PER_TURN)
    return unmet


def executed(firmware: ArduinoBridgeFirmware, wheels: Any, data: bytes, now_ns: int) -> list[Targets]:
    """Return what the speed loop would take after each byte."""
    targets = []
    for k in range(len(data)):
        firmware.receive(data[k : k + 1], now_ns)
        firmware.loop(now_ns)
        targets.append(target(wheels))
    return targets


@pytest.mark.parametrize(("targets", "then"), [((34, 12), (35, 13)), ((-120, 101), (-119, 102)), ((5, -7), (0, 0))])
def test_of_a_line_cut_anywhere_wheels_get_no_more_than_they_were_told_until_the_next_is_complete(
    bench: LineBench, targets: Targets, then: Targets
) -> None:
    bench.to_robot = lambda data: b""
    drive(bench, *targets)
    drive(bench, *then)
    first, second = bench.received[-2:]
    for kept in range(len(first)):
        firmware, wheels = board()
        before = executed(firmware, wheels, b"m 33, 11\r" + first[:kept], S)[-1]
        assert before == (33, 11)  # what is cut does nothing yet
        healing = executed(firmware, wheels, second, S)
        assert healing[-1] == then
        for between in healing[:-1]:
            plausible = all(
                0 <= got * math.copysign(1, most) <= abs(most) for got, most in zip(between, targets, strict=True)
            )
            assert between == before or plausible


def test_no_single_wrong_bit_makes_a_wheel_faster_than_its_digits(bench: LineBench) -> None:
    for targets in itertools.product((-34, 5, 120), repeat=2):
        drive(bench, *targets)
        *_, line = bench.received
        for index, bit in itertools.product(range(len(line)), range(8)):
            spoilt = bytes(byte ^ (1 << bit) if k == index else byte for k, byte in enumerate(line))
            firmware, wheels = board()
            for taken in executed(firmware, wheels, spoilt, S):
                for got, speed in zip(taken, targets, strict=True):
                    assert abs(got) < 10 ** len(str(abs(speed))), spoilt


def test_a_healthy_line_is_not_doctored(bench: LineBench) -> None:
    bench.received.clear()
    for targets in ((34, 12), (35, 12), (35, 13)):
        drive(bench, *targets)
        poll(bench)
    assert bench.received == [b"m 34, 12\r", b"e\r", b"m 35, 12\r", b"e\r", b"m 35, 13\r", b"e\r"]


def test_rounding_leaves_nothing_behind(bench: LineBench) -> None:
    rng = np.random.default_rng(2)
    mean = np.zeros(2)
    for targets in np.array([6.3, -1.4]) + np.cumsum(rng.normal(0.0, 0.3, (300, 2)), axis=0):
        before = turned(bench)
        mean += targets
        command(bench, *targets)
        bench.let_pass(FRAME_S)
        done = turned(bench) - before
        assert np.all(done * targets >= 0.0)  # never the other way
        assert np.all(np.abs(done - targets) <= 1.0 + 1e-6)
    assert np.abs(turned(bench) - mean).max() <= 0.5 + 1e-6


@pytest.mark.slow
def test_a_wheel_that_is_told_zero_gets_zero(bench: LineBench) -> None:
    for tenths in range(5, 500):
        drive(bench, tenths / 10, 8.0)
        drive(bench, 0.0, 8.0)
        bench.let_pass(0.001)
        assert target(bench.hardware) == (0, 8)


def test_at_rest_the_line_is_left_free(bench: LineBench) -> None:
    before = len(bench.received)
    for _ in range(100):
        bench.driver.read()
        bench.driver.write(STOP)
        bench.hear()
        bench.let_pass(0.01)
    commands = b"".join(bench.received[before:])
    assert len(commands) * 10 <= 0.15 * 57600
    assert commands.count(b"m 0, 0\r") >= 30  # one that was lost is told again soon


def test_angles_go_on_where_the_counters_wrap(unmet: LineBench) -> None:
    unmet.firmware._zero = (100 - (1 << 31),) * 2
    unmet.open(counts_per_turn=COUNTS_PER_TURN)
    drive(unmet, 34, 34)
    for _ in range(20):
        reading = poll(unmet)
        assert off(unmet, reading) <= 0.5
    assert turned(unmet)[0] > 100
    assert (reading.left_speed, reading.right_speed) == pytest.approx((34 * RAD_S, 34 * RAD_S), abs=0.04)
    assert math.isnan(reading.battery)


def test_of_counts_cut_anywhere_nothing_wrong_is_read(bench: LineBench) -> None:
    drive(bench, 120, 34)
    for _ in range(20):
        poll(bench)
    for kept in range(len(b"1470 416\r\n")):
        bench.to_driver = lambda answer, kept=kept: answer[:kept]  # type: ignore[misc]
        assert off(bench, poll(bench)) <= 120 * (0.02 + FRAME_S) / FRAME_S + 1.0  # what was read before
        bench.to_driver = bytes
        for _ in range(3):
            drive(bench, 120, 34)
            reading = poll(bench)
        assert off(bench, reading) <= 0.5


def test_a_wrong_digit_is_believed_only_where_the_wheel_can_have_turned_so_far(bench: LineBench) -> None:
    drive(bench, 120, 34)
    for _ in range(20):
        poll(bench)
    drive(bench, 0, 0)
    answer = b"%d %d\r\n" % bench.hardware.counts
    truth = poll(bench)[:2]
    reach = 2.0 * GTERNAL.max_wheel_speed * 0.04  # twice what it may do, in the time of two polls
    for index, digit in itertools.product(range(len(answer) - 2), b"0123456789"):
        spoilt = answer[:index] + bytes([digit]) + answer[index + 1 :]
        bench.to_driver = lambda _, spoilt=spoilt: spoilt  # type: ignore[misc]
        read = poll(bench)[:2]
        assert max(abs(a - b) for a, b in zip(read, truth, strict=True)) <= reach
        bench.to_driver = bytes
        assert poll(bench)[:2] == truth


def test_late_counts_are_not_taken_for_later_ones(bench: LineBench) -> None:
    drive(bench, 34, 34)
    for _ in range(10):
        poll(bench)
    held: list[bytes] = []

    def hold(answer: bytes) -> bytes:
        held.append(answer)
        return b""

    def let_go(answer: bytes) -> bytes:
        return b"".join((*held, answer))

    for late in (False, True, True, False) * 5:
        bench.to_driver = hold if late else let_go
        reading = poll(bench)
        assert reading.left_speed == pytest.approx(34 * RAD_S, rel=0.03)
        assert off(bench, reading) <= 34 * 0.06 / FRAME_S + 0.5
        if not late:
            held.clear()


def test_whatever_was_lost_answers_find_their_questions_again(bench: LineBench) -> None:
    def lost(_: bytes) -> bytes:
        return b""

    drive(bench, 34, 12)
    for losses in itertools.product(("", "said", "answered"), repeat=3):
        for loss in losses:
            bench.to_robot = lost if loss == "said" else bytes
            bench.to_driver = lost if loss == "answered" else bytes
            drive(bench, 34, 12)
            bench.read()
        bench.to_robot = bench.to_driver = bytes
        drive(bench, 34, 12)
        bench.read()
        bench.hear()
        bench.received.clear()
        drive(bench, 34, 12)
        reading = poll(bench)
        assert bench.received == [b"m 34, 12\r", b"e\r"], losses
        assert off(bench, reading) <= 0.5


def test_counters_that_a_wrong_letter_set_to_zero_are_gone_on_with(bench: LineBench) -> None:
    drive(bench, 120, 34)
    for _ in range(40):
        before = poll(bench)
    bench.firmware.receive(b"r\r", bench.now_ns)
    drive(bench, 120, 34)
    for _ in range(40):
        reading = poll(bench)
    # what it turned until its new counts were believed is lost
    assert reading.left_angle - before.left_angle == pytest.approx(40 * 0.02 * reading.left_speed, rel=0.1)
    assert reading.left_speed == pytest.approx(120 * RAD_S, rel=0.02)


def test_a_robot_that_is_silent_for_half_a_second_is_said_to_be_lost(bench: LineBench) -> None:
    bench.to_driver = lambda answer: b""
    for _ in range(20):
        poll(bench)
    with pytest.raises(DriverError, match=r"r1\.tty: no possible encoder counts came for 0\.\d s: is the robot on"):
        for _ in range(10):
            poll(bench)


def test_a_driver_that_was_held_up_itself_does_not_blame_the_robot(bench: LineBench) -> None:
    poll(bench)
    bench.let_pass(3.0)
    poll(bench)


def test_closing_stops_the_wheels_though_the_first_word_is_lost(bench: LineBench) -> None:
    drive(bench, 34, 12)
    losses = iter([True])
    bench.to_robot = lambda data: data[:3] if next(losses, False) else data
    bench.driver.close()
    bench.let_pass(FRAME_S)
    assert target(bench.hardware) == (0, 0)
    with pytest.raises(DriverError, match="closed"):
        bench.driver.write(STOP)


def test_gains_are_told_at_opening(unmet: LineBench) -> None:
    unmet.open(counts_per_turn=COUNTS_PER_TURN, gains=(30, 14, 2, 60))
    assert unmet.firmware.gains == (30, 14, 2, 60)


@pytest.mark.parametrize(
    ("answer", "why"), [(b"", "nothing answers"), (b"hello\r\n", "does not speak ros_arduino_bridge")]
)
def test_what_does_not_speak_the_protocol_is_refused(unmet: LineBench, answer: bytes, why: str) -> None:
    unmet.to_driver = lambda _: answer
    with pytest.raises(DriverError, match=why):
        unmet.open(counts_per_turn=COUNTS_PER_TURN)


def test_a_board_that_starts_is_waited_for(unmet: LineBench) -> None:
    deaf = iter(range(4))
    unmet.to_robot = lambda data: b"" if next(deaf, None) is not None else data
    unmet.open(counts_per_turn=COUNTS_PER_TURN)


@pytest.mark.parametrize("counts_per_turn", [1.0, 1e9])
def test_encoders_that_cannot_drive_the_robot_are_refused(counts_per_turn: float) -> None:
    settings = ArduinoBridge.Settings(port="/dev/null", counts_per_turn=counts_per_turn)
    [(key, why)] = ArduinoBridge.refusals(settings, GTERNAL)
    assert key == "settings.counts_per_turn"
    assert "counts a frame" in why
    assert not ArduinoBridge.refusals(settings.model_copy(update={"counts_per_turn": 2000.0}), GTERNAL)
