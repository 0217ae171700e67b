"""The GTernal's driver: what it says on the line, and what it makes of what comes back."""

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from robofleet.core.clock import MS
from robofleet.drivers.gternal import GTernal
from robofleet.vehicles.interface import STOP, DriverError, WheelSpeeds
from tests.drivers.line_bench import LineBench, gternal
from tests.robots import GTERNAL

AHEAD = WheelSpeeds(5.0, 4.0)
BOUND = 5e-4  # of a wheel [rad/s]: the line's last decimals, by half
SHARED = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
wheel = st.floats(-12.5, 12.5)


@pytest.fixture
def unmet() -> Iterator[LineBench]:
    with gternal() as bench:
        yield bench


@pytest.fixture
def bench(unmet: LineBench) -> LineBench:
    """Return a bench whose driver has met its robot."""
    unmet.open()
    unmet.received.clear()
    return unmet


def tell(bench: LineBench, wheels: WheelSpeeds) -> WheelSpeeds:
    """Write, and return what the controller's motors are asked for then."""
    bench.write(*wheels)
    bench.firmware.loop(bench.now_ns)
    return bench.hardware.command


def test_it_asks_before_it_tells_and_lets_the_robot_stand(unmet: LineBench) -> None:
    unmet.hardware.command = AHEAD
    driver = unmet.open()
    assert b"write" not in unmet.received[0]
    assert any(b'{"v":0.0,"w":0.0}' in line for line in unmet.received)
    assert unmet.now_ns - unmet.heard_ns >= 300 * MS  # motors without current: it rolls on
    assert driver.read() == (0.0, 0.0, 0.0, 0.0, pytest.approx(1.0, abs=0.01), 0, None)


@given(wheel, wheel)
@example(0.0, 0.0)
@example(-1e-9, 0.0)
@example(12.5, 12.5)
@SHARED
def test_wheels_come_out_as_they_were_told(bench: LineBench, left: float, right: float) -> None:
    command = tell(bench, WheelSpeeds(left, right))
    if command == STOP:
        assert max(abs(left), abs(right)) < 0.05
    else:
        assert command == pytest.approx((left, right), abs=BOUND)


@pytest.mark.slow
@given(wheel, wheel, wheel, wheel, st.data())
@SHARED
def test_half_a_line_moves_nothing(
    bench: LineBench, left: float, right: float, a: float, b: float, data: st.DataObject
) -> None:
    tell(bench, WheelSpeeds(left, right))
    before = tell(bench, WheelSpeeds(left, right))
    bench.to_robot = lambda _: b""
    tell(bench, WheelSpeeds(a, b))
    line = bench.received[-1]
    bench.firmware.receive(line[: data.draw(st.integers(1, len(line) - 1))], bench.now_ns)
    bench.firmware.loop(bench.now_ns)
    assert bench.hardware.command == before
    bench.to_robot = bytes
    for _ in range(2):
        assert tell(bench, WheelSpeeds(a, b)) in (before, pytest.approx((a, b), abs=BOUND), STOP)
    assert tell(bench, WheelSpeeds(a, b)) in (pytest.approx((a, b), abs=BOUND), STOP)


@pytest.mark.slow
@given(
    st.lists(
        st.binary(max_size=300) | st.sampled_from([b'{"status"', b':[1],"body":[{"batt_volt":1e999}]}', b"[" * 999])
    )
)
@SHARED
def test_garbage_from_the_robot_is_no_news(bench: LineBench, chunks: list[bytes]) -> None:
    for chunk in chunks:
        bench.say(chunk)
        assert 0.0 <= bench.driver.read().battery <= 1.0
    for volt, charge in ((b"3.3", 0.0), (b"4.2", 1.0)):
        bench.say(b'{"status":[1],"body":[{"batt_volt":' + volt + b"}]}")
        assert bench.driver.read().battery == pytest.approx(charge)


def test_an_answer_may_come_in_pieces(bench: LineBench) -> None:
    for piece in (b'{"sta', b'tus":[1,1],"bo', b'dy":[{},{"batt_volt":3.', b"75}]}"):
        bench.say(piece)
        battery = bench.driver.read().battery
    assert battery == pytest.approx(0.5)


def test_while_it_is_driven_it_asks_only_together_with_its_motion(bench: LineBench) -> None:
    for _ in range(60):
        tell(bench, AHEAD)
        bench.pass_time(0.03)
    assert all(b'"motor"' in line for line in bench.received)
    assert 1 <= sum(b"batt_volt" in line for line in bench.received) <= 3  # in 1.8 s


def test_its_own_questions_keep_no_robot_going(bench: LineBench) -> None:
    assert tell(bench, AHEAD) == pytest.approx(AHEAD, abs=BOUND)
    bench.received.clear()
    bench.pass_time(0.49)
    assert bench.hardware.command != STOP
    bench.pass_time(0.03)
    assert bench.hardware.command == STOP
    assert bench.received
    assert not any(b"write" in line for line in bench.received)


@pytest.mark.parametrize("answer", [b"", b'{"status":[],"body":[]}'])
def test_a_robot_that_answers_or_understands_no_more_is_lost_after_half_a_second(
    answer: bytes, bench: LineBench
) -> None:
    bench.to_robot, bench.babble = lambda _: b"", answer
    tell(bench, AHEAD)
    bench.pass_time(0.48)
    with pytest.raises(DriverError, match="does not answer"):
        bench.pass_time(0.04)


def test_closed_it_stands_even_if_a_line_is_lost(bench: LineBench) -> None:
    tell(bench, AHEAD)
    losses = iter([True])
    bench.to_robot = lambda data: b"" if next(losses, False) else data
    bench.driver.close()
    bench.firmware.loop(bench.now_ns)
    assert bench.hardware.command == STOP
    for late in (lambda: bench.driver.write(AHEAD), bench.driver.read):
        with pytest.raises(DriverError, match="closed"):
            late()


@pytest.mark.parametrize(
    ("says", "message"),
    [(b"", "nothing answers"), (b"Invalid Command\r\n", "the device that answers is not a GTernal")],
)
def test_what_is_no_gternal_is_named_and_not_told_to_move(unmet: LineBench, says: bytes, message: str) -> None:
    unmet.to_robot, unmet.babble = lambda _: b"", says
    with pytest.raises(DriverError, match=message):
        unmet.open()
    assert unmet.received
    assert not any(b"write" in line for line in unmet.received)


@pytest.mark.slow
def test_one_that_talks_all_the_time_and_obeys_nothing_is_named(unmet: LineBench) -> None:
    unmet.to_robot, unmet.babble = lambda _: b"", b'{"status":[1],"body":[{}]}'
    with pytest.raises(DriverError, match="does not stop"):
        unmet.open()


def test_figures_of_another_robots_firmware_are_refused() -> None:
    port = "/dev/ttyAMA0"
    assert GTernal.refusals(GTernal.Settings(port=port), GTERNAL) == []
    ((where, why),) = GTernal.refusals(GTernal.Settings(port=port, wheel_radius_m=16.0), GTERNAL)
    assert where == "settings.wheel_radius_m"
    assert "16 in the firmware, but this robot has 0.016" in why
    ((where, _),) = GTernal.refusals(GTernal.Settings(port=port, wheel_base_m=0.0525), GTERNAL)
    assert where == "settings.wheel_base_m"
