"""Kinematics of a differential drive: round trips, eq. 28, symmetries, limits, arcs."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.vehicles.differential_drive import (
    arc,
    body_from_point,
    body_from_wheels,
    feasible_ratio,
    point_from_pose,
    wheels_from_body,
)
from tests.robots import GTERNAL

wheel = st.floats(-40.0, 40.0)
velocity = st.floats(-0.5, 0.5)
angle = st.floats(-math.pi, math.pi)
ahead = st.floats(0.02, 0.2)
radius = st.floats(0.01, 0.1)
base = st.floats(0.05, 0.5)
metres = st.floats(-2.0, 2.0)
heading = st.floats(-math.pi, math.pi, exclude_min=True)
speed = st.floats(-1.0, 1.0)
yaw_rate = st.floats(-6.0, 6.0)
seconds = st.floats(0.0, 2.0)
EXACT = settings(deadline=None, derandomize=True)


@EXACT
@given(wheel, wheel, radius, base)
def test_wheels_to_body_and_back(left: float, right: float, r: float, b: float) -> None:
    assert wheels_from_body(*body_from_wheels(left, right, r, b), r, b) == pytest.approx((left, right), abs=1e-10)


def test_signs() -> None:
    v, omega = body_from_wheels(1.0, 1.0, 0.016, 0.105)
    assert v == pytest.approx(0.016)
    assert omega == 0.0
    v, omega = body_from_wheels(-1.0, 1.0, 0.016, 0.105)
    assert v == 0.0
    assert omega == pytest.approx(2 * 0.016 / 0.105)  # the right wheel forward turns counter-clockwise


@EXACT
@given(velocity, st.floats(-3.0, 3.0), angle, ahead)
def test_body_from_point_inverts_the_motion_of_the_point(v: float, omega: float, psi: float, l: float) -> None:
    h = 1e-5  # the pose on the arc, by its definition, a moment before and after

    def p(t: float) -> tuple[float, float]:
        mean = psi + omega * t / 2
        chord = v * t * (math.sin(omega * t / 2) / (omega * t / 2) if abs(omega * t) > 1e-12 else 1.0)
        return point_from_pose(chord * math.cos(mean), chord * math.sin(mean), psi + omega * t, l)

    (x0, y0), (x1, y1) = p(-h), p(h)
    u = (x1 - x0) / (2 * h), (y1 - y0) / (2 * h)
    assert body_from_point(*u, psi, l) == pytest.approx((v, omega), abs=1e-6)


@EXACT
@given(velocity, velocity, angle, st.floats(-10.0, 10.0), ahead)
def test_turning_the_world_changes_no_wheel(u_x: float, u_y: float, psi: float, turn: float, l: float) -> None:
    c, s = math.cos(turn), math.sin(turn)
    turned = body_from_point(c * u_x - s * u_y, s * u_x + c * u_y, psi + turn, l)
    before = body_from_point(u_x, u_y, psi, l)
    assert wheels_from_body(*turned, 0.016, 0.105) == pytest.approx(wheels_from_body(*before, 0.016, 0.105), abs=1e-8)


@EXACT
@given(wheel, wheel)
def test_feasible_ratio(left: float, right: float) -> None:
    limits = GTERNAL.wheel_radius, GTERNAL.max_wheel_speed, GTERNAL.max_speed
    ratio = feasible_ratio(left, right, *limits)
    assert 0.0 < ratio <= 1.0
    scaled = ratio * left, ratio * right
    v, _ = body_from_wheels(*scaled, GTERNAL.wheel_radius, GTERNAL.wheel_base)
    assert max(map(abs, scaled)) <= GTERNAL.max_wheel_speed
    assert abs(v) <= GTERNAL.max_speed
    # and it gives away nothing: unscaled, or at one of the two limits
    inside = max(abs(left), abs(right)) < 0.999 * GTERNAL.max_wheel_speed
    inside = inside and GTERNAL.wheel_radius * abs(left + right) / 2 < 0.999 * GTERNAL.max_speed
    if inside:
        assert ratio == 1.0
    if ratio < 1.0:
        used = max(max(map(abs, scaled)) / GTERNAL.max_wheel_speed, abs(v) / GTERNAL.max_speed)
        assert used == pytest.approx(1.0, abs=1e-8)


def test_each_limit_binds_where_it_should() -> None:
    limits = GTERNAL.wheel_radius, GTERNAL.max_wheel_speed, GTERNAL.max_speed
    assert feasible_ratio(-25.0, 25.0, *limits) == pytest.approx(0.5)  # on the spot: the wheels' limit
    slow_body = GTERNAL.wheel_radius, 100.0, GTERNAL.max_speed
    assert feasible_ratio(25.0, 25.0, *slow_body) == pytest.approx(0.5)  # straight on: the body's


# Arcs


def apart(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Return the largest difference of two poses, headings modulo a turn."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(math.remainder(a[2] - b[2], math.tau)))


@pytest.mark.slow
@EXACT
@given(metres, metres, heading, speed, yaw_rate.filter(lambda w: abs(w) > 0.05), seconds)
def test_it_is_the_circle_about_its_centre(
    x: float, y: float, psi: float, v: float, omega: float, duration: float
) -> None:
    rho, end = v / omega, psi + omega * duration
    circle = x + rho * (math.sin(end) - math.sin(psi)), y - rho * (math.cos(end) - math.cos(psi)), end
    assert apart(arc(x, y, psi, v, omega, duration), circle) < 1e-12


@pytest.mark.parametrize("omega", [0.0, 1e-9, -1e-4, 0.3, -2.0])
def test_fine_euler_steps_converge_to_it(omega: float) -> None:
    n, v, duration = 20_000, 0.15, 1.0
    x = y = psi = 0.0
    for _ in range(n):
        middle = psi + omega * duration / n / 2
        x += v * duration / n * math.cos(middle)
        y += v * duration / n * math.sin(middle)
        psi += omega * duration / n
    assert apart(arc(0.0, 0.0, 0.0, v, omega, duration), (x, y, psi)) < 1e-9


@EXACT
@given(metres, metres, heading, speed, yaw_rate, seconds, st.floats(0.0, 1.0))
def test_two_pieces_make_the_whole(
    x: float, y: float, psi: float, v: float, omega: float, duration: float, fraction: float
) -> None:
    first = arc(x, y, psi, v, omega, fraction * duration)
    both = arc(*first, v, omega, (1 - fraction) * duration)
    assert apart(both, arc(x, y, psi, v, omega, duration)) < 1e-12


@EXACT
@given(heading, st.floats(-20.0, 20.0))
def test_heading_stays_in_its_range(psi: float, turn: float) -> None:
    result = arc(0.0, 0.0, psi, 0.0, turn, 1.0)[2]
    assert -math.pi < result <= math.pi
    assert math.remainder(result - psi - turn, math.tau) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("psi", [math.pi, -math.pi])
def test_backwards_is_plus_pi(psi: float) -> None:
    assert arc(0.0, 0.0, psi, 0.1, 0.0, 0.1)[2] == math.pi
