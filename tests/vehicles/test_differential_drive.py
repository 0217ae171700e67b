"""Kinematics of a differential drive: round trips, eq. 28, symmetries, limits."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.vehicles.differential_drive import (
    DifferentialDrive,
    body_from_point,
    body_from_wheels,
    feasible_ratio,
    point_from_pose,
    wheels_from_body,
)

wheel = st.floats(-40.0, 40.0)
velocity = st.floats(-0.5, 0.5)
angle = st.floats(-math.pi, math.pi)
ahead = st.floats(0.02, 0.2)
radius = st.floats(0.01, 0.1)
base = st.floats(0.05, 0.5)
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
def test_feasible_ratio(drive: DifferentialDrive, left: float, right: float) -> None:
    limits = drive.wheel_radius, drive.max_wheel_speed, drive.max_speed
    ratio = feasible_ratio(left, right, *limits)
    assert 0.0 < ratio <= 1.0
    scaled = ratio * left, ratio * right
    v, _ = body_from_wheels(*scaled, drive.wheel_radius, drive.wheel_base)
    assert max(map(abs, scaled)) <= drive.max_wheel_speed
    assert abs(v) <= drive.max_speed
    # and it gives away nothing: unscaled, or at one of the two limits
    inside = max(abs(left), abs(right)) < 0.999 * drive.max_wheel_speed
    inside = inside and drive.wheel_radius * abs(left + right) / 2 < 0.999 * drive.max_speed
    if inside:
        assert ratio == 1.0
    if ratio < 1.0:
        used = max(max(map(abs, scaled)) / drive.max_wheel_speed, abs(v) / drive.max_speed)
        assert used == pytest.approx(1.0, abs=1e-8)


def test_each_limit_binds_where_it_should(drive: DifferentialDrive) -> None:
    limits = drive.wheel_radius, drive.max_wheel_speed, drive.max_speed
    assert feasible_ratio(-25.0, 25.0, *limits) == pytest.approx(0.5)  # on the spot: the wheels' limit
    slow_body = drive.wheel_radius, 100.0, drive.max_speed
    assert feasible_ratio(25.0, 25.0, *slow_body) == pytest.approx(0.5)  # straight on: the body's
