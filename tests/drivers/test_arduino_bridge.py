"""ros_arduino_bridge's driver: what it says over a line that loses and spoils bytes, and what it makes of answers."""

import itertools
import math
import select
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.drivers.arduino_bridge import ArduinoBridge
from robofleet.simulation.firmwares.arduino_bridge import ArduinoBridgeFirmware
from robofleet.simulation.serial_line import SerialLine
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, Simulation, WheelSpeeds
from tests.robots import GTERNAL, IDEAL

COUNTS_PER_TURN = 2000
FRAME_S = 0.033  # 1000 / 30, in whole milliseconds
RAD_S = math.tau / COUNTS_PER_TURN / FRAME_S  # one count a frame
NOBODY = Simulation(
    drive=GTERNAL, imperfections=IDEAL, start=(0.0, 0.0, 0.0), trouble=None, rng=np.random.default_rng(0)
)
Targets = tuple[int, int]


class Wheels:
    """Hardware whose wheels turn as they are told, at once."""

    def __init__(self) -> None:
        self.radians_per_count, self.loop_period, self.command = math.tau / COUNTS_PER_TURN, FRAME_S, STOP
        self.turned = [0.0, 0.0]  # in counts

    @property
    def counts(self) -> Targets:
        return math.floor(self.turned[0] + 0.5), math.floor(self.turned[1] + 0.5)

    @property
    def target(self) -> Targets:
        """What the motors are told, in counts a frame."""
        return round(self.command.left / RAD_S), round(self.command.right / RAD_S)

    def turn(self, seconds: float) -> None:
        for side in (0, 1):
            self.turned[side] += self.command[side] * seconds / self.radians_per_count


def firmware_on(wheels: Wheels) -> ArduinoBridgeFirmware:
    return ArduinoBridgeFirmware(wheels)  # type: ignore[arg-type]


class Robot:
    """A sketch at the end of a line. Its answers and what it hears can be held back or changed."""

    def __init__(self, port: Path, first: int) -> None:
        self.line, self.wheels, self.clock = SerialLine(port), Wheels(), SimulatedClock()
        self.firmware = firmware_on(self.wheels)
        self.wheels.turned = [first, first]
        self.received: list[bytes] = []
        self.on_the_way: Callable[[bytes], bytes] = bytes
        self.on_the_way_back: Callable[[bytes], bytes] = bytes
        self.clock.advance_to(S)

    def hear(self) -> None:
        """Take what was written, which must come, and answer it."""
        assert self.take(1.0)

    def take(self, patience_s: float) -> bool:
        """Take what was written and answer it; returns whether something came in time."""
        assert self.line.descriptor is not None
        if not select.select([self.line.descriptor], [], [], patience_s)[0]:
            return False
        self.listen()
        return True

    def listen(self) -> None:
        """Answer what has come."""
        if data := self.line.read():
            self.received.append(data)
            answer = self.firmware.receive(self.on_the_way(data), self.clock.now_ns())
            self.line.write(self.on_the_way_back(answer))

    def let_pass(self, seconds: float) -> None:
        """Let the wheels turn, a millisecond at a time; the speed loop runs in each of them."""
        for _ in range(round(seconds * 1000)):
            self.clock.advance_to(self.clock.now_ns() + MS)
            self.firmware.loop(self.clock.now_ns())
            self.wheels.turn(0.001)

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Let a thread hear meanwhile, for a driver that waits."""
        ended = threading.Event()

        def go_on() -> None:
            while not ended.wait(0.001):
                self.listen()

        thread = threading.Thread(target=go_on)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


class Bench:
    """A driver and its robot."""

    def __init__(self, folder: Path, first: int = 0, gains: tuple[int, int, int, int] | None = None) -> None:
        self.port = folder / "r1.tty"
        self.robot = Robot(self.port, first)
        settings = ArduinoBridge.Settings(port=str(self.port), counts_per_turn=COUNTS_PER_TURN, gains=gains)
        context = DriverContext(
            robot="r1", drive=GTERNAL, simulation=NOBODY, now_ns=self.robot.clock.now_ns, settings=settings
        )
        with self.robot.answering():
            self.driver = ArduinoBridge(context)

    def write(self, left: float, right: float) -> None:
        """Tell the wheels, in counts a frame, one frame later."""
        self.robot.let_pass(FRAME_S)
        self.driver.write(WheelSpeeds(left * RAD_S, right * RAD_S))
        self.robot.hear()

    def poll(self) -> DriverReading:
        """Return what the driver reads of the counts of 20 ms later."""
        self.robot.let_pass(0.02)
        self.driver.read()
        self.robot.hear()
        return self.driver.read()

    def look(self) -> None:
        """Let the driver read once, whether it asks for counts or not."""
        self.driver.read()
        self.robot.take(0.0)

    def off(self, reading: DriverReading) -> float:
        """Return how far what was read is from what the wheels have turned [counts]."""
        read = (angle * COUNTS_PER_TURN / math.tau for angle in reading[:2])
        return max(abs(a - b) for a, b in zip(read, self.robot.wheels.turned, strict=True))

    def close(self) -> None:
        with self.robot.answering():
            self.driver.close()
        self.robot.line.unplug()


@pytest.fixture(autouse=True)
def undisturbed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A dead man's clock does not stand still while a test is held up; without a sign of life he watches nobody."""
    monkeypatch.setattr("robofleet.drivers.dead_man.DeadMan.sign", lambda _: None)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def executed(firmware: ArduinoBridgeFirmware, wheels: Wheels, data: bytes, now_ns: int) -> list[Targets]:
    """Return what the speed loop would take after each byte."""
    targets = []
    for k in range(len(data)):
        firmware.receive(data[k : k + 1], now_ns)
        firmware.loop(now_ns)
        targets.append(wheels.target)
    return targets


@pytest.mark.parametrize("targets", [(34, 12), (-34, 12), (5, -7), (-120, -101), (0, 9)])
def test_the_wheels_get_what_they_are_told(bench: Bench, targets: Targets) -> None:
    bench.write(*targets)
    bench.robot.let_pass(FRAME_S)
    assert bench.robot.wheels.target == targets


@pytest.mark.parametrize(("targets", "then"), [((34, 12), (35, 13)), ((-120, 101), (-119, 102)), ((5, -7), (0, 0))])
def test_of_a_line_cut_anywhere_wheels_get_no_more_than_they_were_told_until_the_next_is_complete(
    bench: Bench, targets: Targets, then: Targets
) -> None:
    bench.robot.on_the_way = lambda data: b""
    bench.write(*targets)
    bench.write(*then)
    first, second = bench.robot.received[-2:]
    for kept in range(len(first)):
        wheels = Wheels()
        firmware = firmware_on(wheels)
        before = executed(firmware, wheels, b"m 33, 11\r" + first[:kept], S)[-1]
        assert before == (33, 11)  # what is cut does nothing yet
        healing = executed(firmware, wheels, second, S)
        assert healing[-1] == then
        for target in healing[:-1]:
            plausible = all(
                0 <= got * math.copysign(1, most) <= abs(most) for got, most in zip(target, targets, strict=True)
            )
            assert target == before or plausible


def test_no_single_wrong_bit_makes_a_wheel_faster_than_its_digits(bench: Bench) -> None:
    for targets in itertools.product((-34, 5, 120), repeat=2):
        bench.write(*targets)
        *_, line = bench.robot.received
        for index, bit in itertools.product(range(len(line)), range(8)):
            spoilt = bytes(byte ^ (1 << bit) if k == index else byte for k, byte in enumerate(line))
            wheels = Wheels()
            firmware = firmware_on(wheels)
            for target in executed(firmware, wheels, spoilt, S):
                for got, speed in zip(target, targets, strict=True):
                    assert abs(got) < 10 ** len(str(abs(speed))), spoilt


def test_a_healthy_line_is_not_doctored(bench: Bench) -> None:
    bench.robot.received.clear()
    for targets in ((34, 12), (35, 12), (35, 13)):
        bench.write(*targets)
        bench.poll()
    assert bench.robot.received == [b"m 34, 12\r", b"e\r", b"m 35, 12\r", b"e\r", b"m 35, 13\r", b"e\r"]


def test_rounding_leaves_nothing_behind(bench: Bench) -> None:
    rng = np.random.default_rng(2)
    mean = np.zeros(2)
    for targets in np.array([6.3, -1.4]) + np.cumsum(rng.normal(0.0, 0.3, (300, 2)), axis=0):
        before = np.array(bench.robot.wheels.turned)
        mean += targets
        bench.driver.write(WheelSpeeds(*(targets * RAD_S)))
        bench.robot.hear()
        bench.robot.let_pass(FRAME_S)
        done = np.array(bench.robot.wheels.turned) - before
        assert np.all(done * targets >= 0.0)  # never the other way
        assert np.all(np.abs(done - targets) <= 1.0 + 1e-6)
    assert np.abs(np.array(bench.robot.wheels.turned) - mean).max() <= 0.5 + 1e-6


def test_a_wheel_that_is_told_zero_gets_zero(bench: Bench) -> None:
    for tenths in range(5, 500):
        bench.write(tenths / 10, 8.0)
        bench.write(0.0, 8.0)
        bench.robot.let_pass(0.001)
        assert bench.robot.wheels.target == (0, 8)


def test_at_rest_the_line_is_left_free(bench: Bench) -> None:
    before = len(bench.robot.received)
    for _ in range(100):
        bench.driver.read()
        bench.driver.write(STOP)
        bench.robot.take(0.005)
        bench.robot.let_pass(0.01)
    commands = b"".join(bench.robot.received[before:])
    assert len(commands) * 10 <= 0.15 * 57600
    assert commands.count(b"m 0, 0\r") >= 30  # one that was lost is told again soon


def test_angles_and_speeds_are_those_of_the_wheels(bench: Bench) -> None:
    bench.write(34, -12)
    for _ in range(20):
        reading = bench.poll()
        assert bench.off(reading) <= 0.5
    assert (reading.left_speed, reading.right_speed) == pytest.approx((34 * RAD_S, -12 * RAD_S), abs=0.04)
    assert math.isnan(reading.battery)


def test_angles_go_on_where_the_counters_wrap(tmp_path: Path) -> None:
    first = (1 << 31) - 100
    bench = Bench(tmp_path, first)
    bench.write(34, 34)
    for _ in range(20):
        reading = bench.poll()
        assert bench.off(reading) - first == pytest.approx(0.0, abs=0.5)
    assert bench.robot.wheels.counts[0] > 1 << 31
    bench.close()


def test_of_counts_cut_anywhere_nothing_wrong_is_read(bench: Bench) -> None:
    bench.write(120, 34)
    for _ in range(20):
        bench.poll()
    for kept in range(len(b"1470 416\r\n")):
        bench.robot.on_the_way_back = lambda answer, kept=kept: answer[:kept]  # type: ignore[misc]
        assert bench.off(bench.poll()) <= 120 * (0.02 + FRAME_S) / FRAME_S + 1.0  # what was read before
        bench.robot.on_the_way_back = bytes
        for _ in range(3):
            bench.write(120, 34)
            reading = bench.poll()
        assert bench.off(reading) <= 0.5


def test_a_wrong_digit_is_believed_only_where_the_wheel_can_have_turned_so_far(bench: Bench) -> None:
    bench.write(120, 34)
    for _ in range(20):
        bench.poll()
    bench.write(0, 0)
    answer = b"%d %d\r\n" % bench.robot.wheels.counts
    truth = bench.poll()[:2]
    reach = 2.0 * GTERNAL.max_wheel_speed * 0.04  # twice what it may do, in the time of two polls
    for index, digit in itertools.product(range(len(answer) - 2), b"0123456789"):
        spoilt = answer[:index] + bytes([digit]) + answer[index + 1 :]
        bench.robot.on_the_way_back = lambda _, spoilt=spoilt: spoilt  # type: ignore[misc]
        read = bench.poll()[:2]
        assert max(abs(a - b) for a, b in zip(read, truth, strict=True)) <= reach
        bench.robot.on_the_way_back = bytes
        assert bench.poll()[:2] == truth


def test_late_counts_are_not_taken_for_later_ones(bench: Bench) -> None:
    bench.write(34, 34)
    for _ in range(10):
        bench.poll()
    held: list[bytes] = []

    def hold(answer: bytes) -> bytes:
        held.append(answer)
        return b""

    def let_go(answer: bytes) -> bytes:
        return b"".join((*held, answer))

    for late in (False, True, True, False) * 5:
        bench.robot.on_the_way_back = hold if late else let_go
        reading = bench.poll()
        assert reading.left_speed == pytest.approx(34 * RAD_S, rel=0.03)
        assert bench.off(reading) <= 34 * 0.06 / FRAME_S + 0.5
        if not late:
            held.clear()


def test_whatever_was_lost_answers_find_their_questions_again(bench: Bench) -> None:
    def lost(_: bytes) -> bytes:
        return b""

    bench.write(34, 12)
    for losses in itertools.product(("", "said", "answered"), repeat=3):
        for loss in losses:
            bench.robot.on_the_way = lost if loss == "said" else bytes
            bench.robot.on_the_way_back = lost if loss == "answered" else bytes
            bench.write(34, 12)
            bench.look()
        bench.robot.on_the_way = bench.robot.on_the_way_back = bytes
        bench.write(34, 12)
        bench.look()
        bench.robot.take(0.01)
        bench.robot.received.clear()
        bench.write(34, 12)
        reading = bench.poll()
        assert bench.robot.received == [b"m 34, 12\r", b"e\r"], losses
        assert bench.off(reading) <= 0.5


def test_counters_that_a_wrong_letter_set_to_zero_are_gone_on_with(bench: Bench) -> None:
    bench.write(120, 34)
    for _ in range(40):
        before = bench.poll()
    bench.robot.firmware.receive(b"r\r", bench.robot.clock.now_ns())
    bench.write(120, 34)
    for _ in range(40):
        reading = bench.poll()
    # what it turned until its new counts were believed is lost
    assert reading.left_angle - before.left_angle == pytest.approx(40 * 0.02 * reading.left_speed, rel=0.1)
    assert reading.left_speed == pytest.approx(120 * RAD_S, rel=0.02)


def test_a_robot_that_is_silent_for_half_a_second_is_said_to_be_lost(bench: Bench) -> None:
    bench.robot.on_the_way_back = lambda answer: b""
    for _ in range(20):
        bench.poll()
    with pytest.raises(DriverError, match=r"r1\.tty: no possible encoder counts came for 0\.\d s: is the robot on"):
        for _ in range(10):
            bench.poll()


def test_a_driver_that_was_held_up_itself_does_not_blame_the_robot(bench: Bench) -> None:
    bench.poll()
    bench.robot.let_pass(3.0)
    bench.poll()


def test_closing_stops_the_wheels_though_the_first_word_is_lost(bench: Bench) -> None:
    bench.write(34, 12)
    losses = iter([True])
    bench.robot.on_the_way = lambda data: data[:3] if next(losses, False) else data
    with bench.robot.answering():
        bench.driver.close()
    bench.robot.let_pass(FRAME_S)
    assert bench.robot.wheels.target == (0, 0)
    with pytest.raises(DriverError, match="closed"):
        bench.driver.write(STOP)


def test_gains_are_told_at_opening(tmp_path: Path) -> None:
    bench = Bench(tmp_path, gains=(30, 14, 2, 60))
    assert bench.robot.firmware.gains == (30, 14, 2, 60)
    bench.close()


def driver_in_a_hurry(robot: Robot, port: Path) -> ArduinoBridge:
    """Return a driver whose clock does not wait for answers that do not come."""

    def hurrying() -> int:
        robot.clock.advance_to(robot.clock.now_ns() + 250 * MS)
        return robot.clock.now_ns()

    settings = ArduinoBridge.Settings(port=str(port), counts_per_turn=COUNTS_PER_TURN)
    with robot.answering():
        return ArduinoBridge(
            DriverContext(robot="r1", drive=GTERNAL, simulation=NOBODY, now_ns=hurrying, settings=settings)
        )


@pytest.mark.parametrize(
    ("answer", "why"), [(b"", "nothing answers"), (b"hello\r\n", "does not speak ros_arduino_bridge")]
)
def test_what_does_not_speak_the_protocol_is_refused(tmp_path: Path, answer: bytes, why: str) -> None:
    robot = Robot(tmp_path / "r1.tty", 0)
    robot.on_the_way_back = lambda _: answer
    with pytest.raises(DriverError, match=why):
        driver_in_a_hurry(robot, tmp_path / "r1.tty")
    robot.line.unplug()


def test_a_board_that_starts_is_waited_for(tmp_path: Path) -> None:
    robot = Robot(tmp_path / "r1.tty", 0)
    deaf = iter(range(4))
    robot.on_the_way = lambda data: b"" if next(deaf, None) is not None else data
    driver = driver_in_a_hurry(robot, tmp_path / "r1.tty")
    with robot.answering():
        driver.close()
    robot.line.unplug()


@pytest.mark.parametrize("counts_per_turn", [1.0, 1e9])
def test_encoders_that_cannot_drive_the_robot_are_refused(counts_per_turn: float) -> None:
    settings = ArduinoBridge.Settings(port="/dev/null", counts_per_turn=counts_per_turn)
    [(key, why)] = ArduinoBridge.refusals(settings, GTERNAL)
    assert key == "settings.counts_per_turn"
    assert "counts a frame" in why
    assert not ArduinoBridge.refusals(settings.model_copy(update={"counts_per_turn": 2000.0}), GTERNAL)
