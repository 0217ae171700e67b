"""The GTernal's driver: what it says on the line, and what it makes of what comes back."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robofleet.core.clock import MS
from robofleet.drivers.gternal import GTernal
from robofleet.vehicles.interface import STOP, DriverError, WheelSpeeds
from tests.drivers.gternal_desk import Desk
from tests.robots import GTERNAL

AHEAD = WheelSpeeds(5.0, 4.0)
BOUND = 5e-4  # of a wheel [rad/s]: the line's last decimals, by half
wheel = st.floats(-12.5, 12.5)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    desk = Desk(tmp_path_factory.mktemp("gternal"))
    yield desk
    desk.line.unplug()


@pytest.fixture
def driver(desk: Desk) -> Iterator[GTernal]:
    desk.answer = desk.obey
    driver = desk.make()
    desk.lines.clear()
    yield driver
    desk.meanwhile(driver.close)


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Desk, GTernal]]:
    """A desk and a driver that many examples share."""
    desk = Desk(tmp_path_factory.mktemp("steady"))
    driver = desk.make()
    yield desk, driver
    desk.meanwhile(driver.close)
    desk.line.unplug()


def test_it_asks_before_it_tells_and_lets_the_robot_stand(desk: Desk) -> None:
    desk.hardware.command = AHEAD
    desk.lines.clear()
    driver = desk.make()
    assert b"write" not in desk.lines[0]
    assert any(b'{"v":0.0,"w":0.0}' in line for line in desk.lines)
    assert desk.clock.now_ns() - desk.heard_ns >= 300 * MS  # motors without current: it rolls on
    assert driver.read() == (0.0, 0.0, 0.0, 0.0, pytest.approx(1.0, abs=0.01), 0, None)
    desk.meanwhile(driver.close)


@given(wheel, wheel)
@example(0.0, 0.0)
@example(-1e-9, 0.0)
@example(12.5, 12.5)
@settings(deadline=None)
def test_wheels_come_out_as_they_were_told(steady: tuple[Desk, GTernal], left: float, right: float) -> None:
    desk, driver = steady
    command = desk.tell(driver, WheelSpeeds(left, right))
    if command == STOP:
        assert max(abs(left), abs(right)) < 0.05
    else:
        assert command == pytest.approx((left, right), abs=BOUND)


@given(wheel, wheel, wheel, wheel, st.data())
@settings(deadline=None)
def test_half_a_line_moves_nothing(
    steady: tuple[Desk, GTernal], left: float, right: float, a: float, b: float, data: st.DataObject
) -> None:
    desk, driver = steady
    desk.tell(driver, WheelSpeeds(left, right))
    before = desk.tell(driver, WheelSpeeds(left, right))
    desk.answer = lambda line: b""
    desk.tell(driver, WheelSpeeds(a, b))
    line = desk.lines[-1]
    desk.firmware.receive(line[: data.draw(st.integers(1, len(line) - 1))], desk.clock.now_ns())
    desk.firmware.loop(desk.clock.now_ns())
    assert desk.hardware.command == before
    desk.answer = desk.obey
    for _ in range(2):
        assert desk.tell(driver, WheelSpeeds(a, b)) in (before, pytest.approx((a, b), abs=BOUND), STOP)
    assert desk.tell(driver, WheelSpeeds(a, b)) in (pytest.approx((a, b), abs=BOUND), STOP)


@given(
    st.lists(
        st.binary(max_size=300) | st.sampled_from([b'{"status"', b':[1],"body":[{"batt_volt":1e999}]}', b"[" * 999])
    )
)
@settings(deadline=None)
def test_garbage_from_the_robot_is_no_news(steady: tuple[Desk, GTernal], chunks: list[bytes]) -> None:
    desk, driver = steady
    desk.answer = desk.obey
    for chunk in chunks:
        desk.line.write(chunk)
        battery = driver.read().battery
        assert 0.0 <= battery <= 1.0
    desk.line.write(b'{"status":[1],"body":[{"batt_volt":3.3}]}')
    assert reads_battery(desk, driver, 0.0)
    desk.line.write(b'{"status":[1],"body":[{"batt_volt":4.2}]}')
    assert reads_battery(desk, driver, 1.0)


def test_an_answer_may_come_in_pieces(steady: tuple[Desk, GTernal]) -> None:
    desk, driver = steady
    for piece in (b'{"sta', b'tus":[1,1],"bo', b'dy":[{},{"batt_volt":3.', b"75}]}"):
        desk.line.write(piece)
        for _ in range(3):
            desk.hear(0.005)
            driver.read()
    assert reads_battery(desk, driver, 0.5)


def reads_battery(desk: Desk, driver: GTernal, charge: float) -> bool:
    """Return whether it comes to say so; a pseudo-terminal takes a moment."""
    for _ in range(1000):
        if driver.read().battery == pytest.approx(charge):
            return True
        desk.hear(0.001)
    return False


def test_while_it_is_driven_it_asks_only_together_with_its_motion(desk: Desk, driver: GTernal) -> None:
    for _ in range(60):
        desk.tell(driver, AHEAD)
        desk.let_pass(3, driver)
    assert all(b'"motor"' in line for line in desk.lines)
    assert 1 <= sum(b"batt_volt" in line for line in desk.lines) <= 3  # in 1.8 s


def test_its_own_questions_keep_no_robot_going(desk: Desk, driver: GTernal) -> None:
    assert desk.tell(driver, AHEAD) == pytest.approx(AHEAD, abs=BOUND)
    desk.lines.clear()
    desk.let_pass(49, driver)
    assert desk.hardware.command != STOP
    desk.let_pass(3, driver)
    assert desk.hardware.command == STOP
    assert desk.lines
    assert not any(b"write" in line for line in desk.lines)


@pytest.mark.parametrize("answer", [b"", b'{"status":[],"body":[]}'])
def test_a_robot_that_answers_or_understands_no_more_is_lost_after_half_a_second(
    answer: bytes, desk: Desk, driver: GTernal
) -> None:
    desk.answer = lambda data: answer
    desk.tell(driver, AHEAD)
    desk.let_pass(48, driver)
    with pytest.raises(DriverError, match="does not answer"):
        desk.let_pass(4, driver)


def test_closed_it_stands_even_if_a_line_is_lost(desk: Desk, driver: GTernal) -> None:
    desk.tell(driver, AHEAD)
    lost: list[bytes] = []

    def lose_the_first(data: bytes) -> bytes:
        if lost:
            return desk.obey(data)
        lost.append(data)
        return b""

    desk.answer = lose_the_first
    desk.meanwhile(driver.close)
    desk.firmware.loop(desk.clock.now_ns())
    assert lost
    assert desk.hardware.command == STOP
    for late in (lambda: driver.write(AHEAD), driver.read):
        with pytest.raises(DriverError, match="closed"):
            late()


@pytest.mark.parametrize(
    ("says", "message"),
    [(b"", "nothing answers"), (b"Invalid Command\r\n", "the device that answers is not a GTernal")],
)
def test_what_is_no_gternal_is_named_and_not_told_to_move(tmp_path: Path, says: bytes, message: str) -> None:
    desk = Desk(tmp_path)
    desk.answer = lambda data: says
    with pytest.raises(DriverError, match=message):
        desk.make()
    assert desk.lines
    assert not any(b"write" in line for line in desk.lines)


def test_one_that_talks_all_the_time_and_obeys_nothing_is_named(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.answer = lambda line: b""
    desk.unasked = b'{"status":[1],"body":[{}]}'
    with pytest.raises(DriverError, match="does not stop"):
        desk.make()


def test_figures_of_another_robots_firmware_are_refused() -> None:
    port = "/dev/ttyAMA0"
    assert GTernal.refusals(GTernal.Settings(port=port), GTERNAL) == []
    ((where, why),) = GTernal.refusals(GTernal.Settings(port=port, wheel_radius_m=16.0), GTERNAL)
    assert where == "settings.wheel_radius_m"
    assert "16 in the firmware, but this robot has 0.016" in why
    ((where, _),) = GTernal.refusals(GTernal.Settings(port=port, wheel_base_m=0.0525), GTERNAL)
    assert where == "settings.wheel_base_m"
