"""Simulated sensors against what geometry and mechanics say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robofleet.core.clock import MS, S
from robofleet.drivers.simulated import SimulatedRobot
from robofleet.vehicles.differential_drive import arc
from robofleet.vehicles.interface import DriverContext, Simulation, WheelSpeeds
from robofleet.vehicles.readings import SensorReading, TruePose
from robofleet.vehicles.sensors import (
    DistanceSensors,
    Errors,
    Sensing,
    SensorKind,
    SimulatedSensors,
    is_sound,
    packed,
    unpacked,
)
from tests.robots import GTERNAL, WORN

Walls = tuple[tuple[float, float, float, float], ...]
HALF_X, HALF_Y = 1.6, 1.0
EDGES = (
    (-HALF_X, -HALF_Y, HALF_X, -HALF_Y),
    (HALF_X, -HALF_Y, HALF_X, HALF_Y),
    (HALF_X, HALF_Y, -HALF_X, HALF_Y),
    (-HALF_X, HALF_Y, -HALF_X, -HALF_Y),
)
EXACT, EXACT_3 = Errors((0.0,), 0.0), Errors((0.0,) * 3, 0.0)
FIELD = (6.07e-6, 0.0, -39.9e-6)
PLACES = tuple((0.05 * math.cos(a), 0.05 * math.sin(a), a) for a in np.linspace(-math.pi, math.pi, 7))
IDEAL = SensorKind(
    0.03, EXACT_3, EXACT_3, (0.0, 0.0), EXACT_3, FIELD, EXACT, DistanceSensors(PLACES, 10.0, 0.0, 0.0, 0.0)
)
STEP_NS = 30 * MS
pose = st.tuples(st.floats(-1.5, 1.5), st.floats(-0.9, 0.9), st.floats(-10.0, 10.0))


def sensors(kind: SensorKind, walls: Walls = EDGES) -> SimulatedSensors:
    return SimulatedSensors([0], [Sensing(kind, walls, np.random.default_rng(1))])


def seen(
    at: tuple[float, float, float], *others: tuple[float, float, float], kind: SensorKind = IDEAL, walls: Walls = EDGES
) -> list[float]:
    """Return what the distance sensors of a robot say; ``others``: x, y and radius of other bodies [m]."""
    truths = [TruePose(*at, 0.0, 0.0), *(TruePose(x, y, 0.3, 0.0, 0.0) for x, y, _ in others)]
    reading = sensors(kind, walls).first(S, truths, [0.055, *(radius for *_, radius in others)])
    return list(reading.distances)


@given(pose)
@settings(deadline=None)
def test_in_an_empty_arena_a_ray_ends_at_the_edge(at: tuple[float, float, float]) -> None:
    x, y, psi = at
    for (ahead, left, direction), distance in zip(PLACES, seen(at), strict=True):
        from_x = x + ahead * math.cos(psi) - left * math.sin(psi)
        from_y = y + ahead * math.sin(psi) + left * math.cos(psi)
        c, s = math.cos(psi + direction), math.sin(psi + direction)
        to_x = (math.copysign(HALF_X, c) - from_x) / c if c else math.inf
        to_y = (math.copysign(HALF_Y, s) - from_y) / s if s else math.inf
        assert distance == pytest.approx(min(to_x, to_y), abs=1e-9)


@given(pose, st.integers(0, 6), st.floats(0.2, 5.0), st.floats(-1.2, 1.2), st.floats(0.02, 0.2))
@settings(deadline=None)
def test_a_body_in_the_way_is_seen_where_its_disc_begins(
    at: tuple[float, float, float], sensor: int, far: float, beside: float, radius: float
) -> None:
    """``beside``: how far from its middle the ray meets the disc, in radii."""
    assume(abs(abs(beside) - 1.0) > 1e-6)  # a ray that only touches it is seen or not
    x, y, psi = at
    _, _, direction = PLACES[sensor]
    c, s = math.cos(psi + direction), math.sin(psi + direction)
    offset = beside * radius
    body = x + (0.05 + far) * c - offset * s, y + (0.05 + far) * s + offset * c, radius
    (alone, met) = (seen(at, *bodies, walls=())[sensor] for bodies in ((), (body,)))
    assert math.isnan(alone)
    if abs(beside) > 1.0:
        assert math.isnan(met)
    else:
        assert met == pytest.approx(far - math.sqrt(radius**2 - offset**2), abs=1e-6)
    assert math.isnan(seen((x, y, psi + math.pi), body, walls=())[sensor])  # its back is turned to it


def test_a_sensor_sees_no_farther_than_its_range_and_nothing_behind_it() -> None:
    ahead = SensorKind(0.03, distances=DistanceSensors(((0.05, 0.0, 0.0),), 0.5, 0.0, 0.0, 0.0))
    wall = ((1.0, -1.0, 1.0, 1.0),)
    assert seen((0.46, 0.0, 0.0), kind=ahead, walls=wall) == [pytest.approx(0.49)]
    assert np.isnan(seen((0.44, 0.0, 0.0), kind=ahead, walls=wall)).all()
    assert np.isnan(seen((1.5, 0.0, 0.0), kind=ahead, walls=wall)).all()
    assert np.isnan(seen((0.46, 1.01, 0.0), kind=ahead, walls=wall)).all()  # past its end
    assert np.isnan(seen((0.46, -1.01, 0.0), kind=ahead, walls=wall)).all()
    assert seen((0.46, 0.0, 0.0), (0.7, 0.0, 0.05), kind=ahead, walls=wall) == [pytest.approx(0.14)]
    assert seen((0.46, 0.0, 0.0), (0.54, 0.0, 0.05), kind=ahead, walls=wall) == [0.0]  # they touch


@pytest.mark.slow
def test_the_gyro_adds_up_to_the_heading() -> None:
    """Of a worn robot whose wheels follow any commands: what it turned is what its gyro told."""
    rng, now_ns = np.random.default_rng(2), 5 * S
    kind = replace(IDEAL, period=0.03)
    own = Sensing(kind, (), np.random.default_rng(3))
    simulation = Simulation(
        drive=GTERNAL,
        imperfections=WORN,
        start=(0.0, 0.0, 3.0),
        trouble=None,
        rng=np.random.default_rng(1),
        radius=0.055,
        sensing=own,
    )
    robot = SimulatedRobot(DriverContext(robot="r1", drive=GTERNAL, simulation=simulation, now_ns=lambda: now_ns))
    readings: list[SensorReading] = []
    for loop in range(3000):
        if loop % 30 == 0:
            wheels = WheelSpeeds(*rng.uniform(-12.0, 12.0, 2))
        robot.write(wheels)
        reading = robot.read().sensors
        if loop % 3 == 0:
            readings.append(reading)
            psi = robot.truth().psi
        now_ns += 10 * MS
    assert readings[-1].heading == pytest.approx(math.remainder(psi, math.tau))
    assert abs(psi - 3.0) > 1.0
    turned = sum(reading.gyro[2] * 0.03 for reading in readings[1:] if reading.gyro is not None)
    assert turned == pytest.approx(psi - 3.0, abs=1e-6)


@pytest.mark.slow
@given(st.floats(-0.2, 0.2), st.floats(-4.0, 4.0), st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))
@settings(deadline=None)
def test_on_a_circle_the_accelerometer_points_at_the_centre(v: float, omega: float, x: float, y: float) -> None:
    """At the axle's middle it is v omega to the left; elsewhere on the robot the turning pulls outwards, too."""
    own = sensors(replace(IDEAL, accelerometer_place=(x, y)))
    at = (0.1, 0.2, 3.0)
    for step in range(3):
        truth = TruePose(*at, v, omega)
        reading = own.first(S + step * STEP_NS, [truth], [0.0])
        at = arc(*at, v, omega, STEP_NS / S)
    assert reading.accelerometer == pytest.approx((-(omega**2) * x, v * omega - omega**2 * y, 9.80665), abs=1e-6)


def test_who_speeds_up_feels_it() -> None:
    own, reading = sensors(replace(IDEAL, accelerometer_place=(0.1, 0.02))), SensorReading()
    for step in range(3):  # 0.3 m/s^2 and 2 rad/s^2 from rest: the turning itself is still slow
        t = step * 0.001
        reading = own.first(S + step * MS, [TruePose(0.0, 0.0, t**2, 0.3 * t, 2.0 * t)], [0.0])
    assert reading.accelerometer == pytest.approx((0.3 - 2.0 * 0.02, 2.0 * 0.1, 9.80665), abs=1e-4)


@pytest.mark.slow
@given(pose)
@settings(deadline=None)
def test_the_field_turns_against_the_robot(at: tuple[float, float, float]) -> None:
    reading = sensors(IDEAL).first(S, [TruePose(*at, 0.0, 0.0)], [0.0])
    assert reading.magnetometer is not None and reading.heading is not None
    x, y, z = reading.magnetometer
    assert (math.hypot(x, y), z) == pytest.approx((FIELD[0], FIELD[2]))
    assert math.remainder(math.atan2(-y, x) - at[2], math.tau) == pytest.approx(0.0, abs=1e-9)
    assert math.remainder(reading.heading - at[2], math.tau) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi < reading.heading <= math.pi


def test_errors_are_as_large_as_configured() -> None:
    """Standard deviations within 6 %, that is four of their own, of 2000 readings."""
    noise = 0.1, 0.2, 0.4
    kind = SensorKind(
        0.03, Errors(noise, 3.0), Errors(noise, 0.0), (0.0, 0.0), Errors(noise, 0.0), FIELD, Errors((0.05,), 0.0),
        DistanceSensors(((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)), 2.0, 0.03, 0.1, 0.0),
    )  # fmt: skip
    own = sensors(kind)
    still = np.array([[0.6, 0.0, 0.0, 0.0, 0.0]])
    readings = np.concatenate([own.read(S + k * STEP_NS, still, np.zeros(1)) for k in range(2000)])
    inertial, distances = readings[:, :10], readings[:, 10:]
    assert inertial.std(axis=0) == pytest.approx([*noise, *noise, *noise, 0.05], rel=0.06)
    bias = inertial[:, :3].mean(axis=0)
    assert (np.abs(bias) < 3.1).all() and np.ptp(bias) > 0.1  # each axis its own, and within its bound
    assert inertial[:, 3:6].mean(axis=0) == pytest.approx((0.0, 0.0, 9.80665), abs=0.04)
    assert np.isnan(distances).mean(axis=0) == pytest.approx([0.1, 0.1], abs=0.03)
    assert np.nanmean(distances, axis=0) == pytest.approx((1.0, 1.0), abs=0.004)
    assert np.nanstd(distances, axis=0) == pytest.approx((0.03, 0.03), rel=0.06)
    wild = sensors(replace(IDEAL, distances=DistanceSensors(((0.0, 0.0, 0.0),), 2.0, 0.0, 0.0, 0.5)))
    anything = np.concatenate([wild.read(S + k * STEP_NS, still, np.zeros(1)) for k in range(500)])[:, 10]
    assert np.mean(np.abs(anything - 1.0) > 1e-9) == pytest.approx(0.5, abs=0.1)
    assert anything.min() >= 0.0 and anything.max() <= 2.0


def test_a_robots_errors_are_its_own() -> None:
    """What a robot's sensors say depends neither on who else is in its unit, nor on its place there."""
    truths, radii = np.array([[0.1, 0.2, 0.3, 0.1, 0.5], [0.5, -0.4, 1.0, 0.2, 0.0]]), np.full(2, 0.055)
    kinds = [replace(IDEAL, gyro=Errors((0.1,) * 3, 0.1)), SensorKind(0.05, heading=Errors((0.1,), 0.0))]
    both = [Sensing(kind, EDGES, np.random.default_rng(row)) for row, kind in enumerate(kinds)]
    alone = [Sensing(kind, EDGES, np.random.default_rng(row)) for row, kind in enumerate(kinds)]
    together = SimulatedSensors([0, 1], both)
    readings = together.readings(together.read(S, truths, radii))
    for row, reading in enumerate(alone):
        single = SimulatedSensors([row], [reading])
        assert single.readings(single.read(S, truths, radii)) == [readings[row]]
    assert readings[1].gyro is None and readings[1].distances is None and readings[1].heading is not None


@pytest.mark.parametrize(
    "impossible",
    [
        SensorReading(gyro=(1.0, 2.0)),  # type: ignore[arg-type]
        SensorReading(accelerometer=(math.nan, 0.0, 0.0)),
        SensorReading(heading=math.inf),
        SensorReading(distances=(math.inf,)),
        SensorReading(distances=(1.0,) * 300),
    ],
)  # fmt: skip
def test_what_no_sensor_says(impossible: SensorReading) -> None:
    assert not is_sound(impossible)
    assert is_sound(SensorReading((0.0, 0.0, 0.0), None, None, 1.0, (math.nan, 0.3)))


def test_an_array_is_as_good_as_a_tuple() -> None:
    reading = SensorReading(gyro=np.arange(3.0), distances=np.array([0.5, math.nan]))  # type: ignore[arg-type]
    assert is_sound(reading)
    parts, count, numbers = packed(reading)
    again = unpacked(parts, count, numbers)
    assert again.gyro == (0.0, 1.0, 2.0) and again.distances is not None
    assert again.distances == pytest.approx((0.5, math.nan), nan_ok=True)
