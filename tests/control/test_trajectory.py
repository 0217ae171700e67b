"""References in time, and the unicycle's prediction: against their definitions, and against numbers found otherwise."""

import math

import numpy as np
import pytest

from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant
from robofleet.control.path import Path
from robofleet.control.trajectory import Trajectory, demanded, spline
from robofleet.control.unicycle import unicycle_plant

SQUARE = np.array([[-1.0, -0.5], [1.0, -0.5], [1.0, 0.5], [-1.0, 0.5]])


def through(points: np.ndarray, *, closed: bool, speed: float = 0.15, most: float = 0.1) -> Trajectory:
    return Trajectory.waypoints(
        points, closed=closed, speed=speed, acceleration=0.2, most=lambda curvature: most / (0.2 + curvature)
    )


@pytest.mark.parametrize("closed", [True, False])
def test_the_velocity_is_the_derivative_of_the_position(closed: bool) -> None:
    way = through(SQUARE, closed=closed)
    t, near = way.instants(0.05), 1e-6
    assert way.velocity(t) == pytest.approx((way.position(t + near) - way.position(t - near)) / (2 * near), abs=1e-8)


@pytest.mark.parametrize("closed", [True, False])
def test_a_way_leads_through_its_points_within_its_limits(closed: bool) -> None:
    way = through(SQUARE, closed=closed)
    at = way.position(np.linspace(0.0, way.end, 50_001))
    assert max(np.linalg.norm(at - point, axis=1).min() for point in SQUARE) < 1e-4
    t = way.instants(0.002)
    velocity = way.velocity(t)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    assert speed.max() < 0.15 * 1.01
    assert np.abs(np.diff(speed) / np.diff(t)).max() < 0.2 * 1.1
    turned = np.abs(np.diff(np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])))) / np.diff(t)
    moving = speed[:-1] > 0.02
    assert (speed[:-1] * (0.2 + turned / np.maximum(speed[:-1], 0.01)))[moving].max() < 0.1 * 1.05


def test_an_open_way_begins_and_ends_at_rest_and_stays_there() -> None:
    way = through(SQUARE, closed=False)
    outside = np.array([-1.0, 0.0, way.end, way.end + 1.0])
    assert way.velocity(outside) == pytest.approx(np.zeros((4, 2)), abs=1e-9)
    assert way.position(outside) == pytest.approx(SQUARE[[0, 0, 3, 3]])
    assert np.array([way.at(float(t)) for t in outside]) == pytest.approx(SQUARE[[0, 0, 3, 3]])


def test_a_closed_way_goes_on_smoothly_where_it_began() -> None:
    way = through(SQUARE, closed=True)
    before, after = way.velocity(np.array([way.end - 1e-9, way.end + 1e-9]))
    assert before == pytest.approx(after, abs=1e-6)
    assert way.position(np.array([3.0])) == pytest.approx(way.position(np.array([3.0 + 2 * way.end])))


def test_the_spline_of_a_circles_points_has_its_curvature() -> None:
    angle = np.arange(24) * math.tau / 24
    bend = spline(0.4 * np.column_stack([np.cos(angle), np.sin(angle)]), closed=True)
    assert np.hypot(*bend.points.T) == pytest.approx(0.4, rel=1e-4)
    assert bend.curvature == pytest.approx(1 / 0.4, rel=0.02)


def test_a_way_that_turns_back_has_a_very_sharp_bend() -> None:
    assert spline(np.array([[0.0, 0.0], [1.0, 0.0], [0.3, 0.0]]), closed=False).curvature.max() > 1e3
    assert spline(np.array([[0.0, 0.0], [1.0, 0.3]]), closed=False).curvature.max() < 1e-9


def test_a_path_at_a_rate_begins_at_its_parameter() -> None:
    path = Path.hermite(SQUARE, np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]]))
    way, t = Trajectory.path(path, 0.1, 1.5), np.linspace(0.0, 100.0, 301)
    assert way.position(t) == pytest.approx(path.position(1.5 + 0.1 * t))
    assert np.array([way.at(float(instant)) for instant in t]) == pytest.approx(way.position(t))
    assert way.velocity(t) == pytest.approx(0.1 * path.derivative(1.5 + 0.1 * t))


@pytest.mark.parametrize("smooth", [True, False])
def test_samples_are_met_at_their_times(smooth: bool) -> None:
    times, points = np.array([1.0, 2.0, 4.0, 4.5]), np.array([[0.0, 0.0], [0.1, 0.1], [0.5, 0.0], [0.5, 0.2]])
    way = Trajectory.samples(times, points, smooth=smooth)
    assert way.position(times) == pytest.approx(points)
    if not smooth:
        assert way.position(np.array([3.0])) == pytest.approx(np.array([[0.3, 0.05]]))
    else:
        before, after = way.velocity(np.array([2.0 - 1e-9, 2.0 + 1e-9]))
        assert before == pytest.approx(after, abs=1e-6)


@pytest.mark.parametrize("ahead", [0.0, 0.08])
def test_what_a_circle_demands(ahead: float) -> None:
    angle = np.arange(64) * math.tau / 64
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    path = Path.hermite(0.4 * circle, 0.4 * math.tau / 64 * circle[:, ::-1] * [-1.0, 1.0])
    t, v, omega, centre = demanded(Trajectory.path(path, 64 * 0.1 / (0.4 * math.tau), 0.0), ahead, 0.01)
    assert t[1] - t[0] == pytest.approx(0.01, rel=0.01)
    assert omega == pytest.approx(0.1 / 0.4, rel=1e-3)
    assert v == pytest.approx(0.1 * math.sqrt(1 - (ahead / 0.4) ** 2), rel=1e-3)
    assert np.hypot(*centre.T) == pytest.approx(math.sqrt(0.4**2 - ahead**2), rel=1e-3)


@pytest.mark.long
def test_the_unicycles_arc_is_what_the_general_prediction_integrates() -> None:
    """By hand and by RK4 with the equations, eqs 11 to 13, 24 and 25, the flow takes the same step."""
    plant = unicycle_plant()
    general = Plant(plant.f, plant.h, plant.n, plant.m, plant.f_x, plant.f_u, plant.h_x)
    settings = FlowSettings(45.0, 0.6, 0.033, prediction_steps=50)
    rng = np.random.default_rng(5)
    closed, integrated = (NewtonRaphsonFlow(model, settings, (0.1, 0.2)) for model in (plant, general))
    for omega in (0.0, 1e-5, 0.3, -2.0):
        x, r = rng.uniform(-1.0, 1.0, 5) * [1.0, 1.0, 3.0, 0.02, 0.2], rng.uniform(-1.0, 1.0, 2)
        for flow in (closed, integrated):
            flow.applied((0.12, omega))
            flow.update(x, r)
        assert closed.prediction == pytest.approx(integrated.prediction, abs=1e-9)
        assert closed.u == pytest.approx(integrated.u, rel=1e-6)
