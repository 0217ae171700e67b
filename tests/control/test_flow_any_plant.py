"""The flow on plants of a user's own: what one step does, limits, delay, disturbances."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import (
    FlowError,
    FlowSettings,
    Integrator,
    MemorylessFlow,
    NewtonRaphsonFlow,
    Plant,
    integrator_gain,
    point_update,
)
from robofleet.core.arrays import Array
from robofleet.experiments.stability import DOUBLE_INTEGRATOR
from robofleet.vehicles.bicycle import FALCONE_2007

EXACT = settings(deadline=None, derandomize=True, max_examples=60)


def switched_slope(x: Array, u: Array) -> Array:
    """x1' = a x1^2 + u1, x2' = b u1 + c u2; a, b, c stand in the state: a point (0, 0, 1) or one that escapes."""
    return np.array([x[2] * x[0] * x[0] + u[0], x[3] * u[0] + x[4] * u[1], 0.0, 0.0, 0.0])


SWITCHED = Plant(switched_slope, lambda x: x[:2].copy(), 5, 2)
POINT = np.array([0.0, 0.0, 1.0])
DOUBLE = DOUBLE_INTEGRATOR  # x1' = x2, x2' = u, y = x1


def moved(x: Array, u: float, dt: float, push: float = 0.0) -> Array:
    """The double integrator after ``dt`` of constant input and disturbance."""
    a = u + push
    return np.array([x[0] + dt * x[1] + a * dt * dt / 2, x[1] + a * dt])


@EXACT
@given(
    st.floats(1, 100), st.floats(0.1, 2), st.floats(1e-3, 0.019), st.sampled_from(("exact", "euler")),
    st.tuples(*[st.floats(-2, 2)] * 6),
)  # fmt: skip
@pytest.mark.long
def test_eq_31_is_the_flow_of_a_point(
    alpha: float, T: float, step: float, integrator: Integrator, numbers: tuple[float, ...]
) -> None:
    u, x, r = np.array(numbers[:2]), np.array(numbers[2:4]), np.array(numbers[4:])
    flow = NewtonRaphsonFlow(SWITCHED, FlowSettings(alpha, T, step, integrator), u)
    gain = integrator_gain(alpha, step, integrator)
    by_hand = [point_update(u[i], x[i], r[i], T, gain) for i in range(2)]
    assert flow.update(np.concatenate([x, POINT]), r) == pytest.approx(by_hand, rel=1e-8, abs=1e-8)
    assert flow.prediction == pytest.approx(x + T * u)
    assert flow.control_error == pytest.approx(np.linalg.norm(r - x - T * u), abs=1e-12)


@EXACT
@given(st.floats(1, 60), st.floats(0.1, 2), st.floats(1e-3, 0.1), st.floats(-1, 1), st.floats(-1, 1))
@pytest.mark.long
def test_exact_solves_the_linear_flow(alpha: float, T: float, step: float, velocity: float, r: float) -> None:
    x, u, n = np.array([0.2, velocity]), 0.3, 400
    after = NewtonRaphsonFlow(DOUBLE, FlowSettings(alpha, T, step), [u]).update(x, np.array([r]))
    h = step / n
    for _ in range(n):  # u' = alpha 2 / T^2 (r - x1 - T x2 - T^2 / 2 u), midpoint rule

        def rate(u: float) -> float:
            return alpha * 2 / T**2 * (r - x[0] - T * x[1] - T**2 / 2 * u)

        u += h * rate(u + h / 2 * rate(u))
    assert after[0] == pytest.approx(u, rel=2e-3, abs=1e-3 * max(1, 1 / T**2))


@pytest.mark.long
def test_limits_hold_and_do_not_wind_up() -> None:
    flow = NewtonRaphsonFlow(DOUBLE, FlowSettings(20.0, 0.5, 0.02, lower=(-1.0,), upper=(2.0,)), [0.0])
    for _ in range(50):
        u = flow.update(np.zeros(2), np.array([100.0]))
    assert u.tolist() == [2.0]
    free = NewtonRaphsonFlow(DOUBLE, FlowSettings(20.0, 0.5, 0.02), [2.0])
    target = np.array([0.2])
    assert flow.update(np.zeros(2), target) == pytest.approx(free.update(np.zeros(2), target))
    for _ in range(50):
        u = flow.update(np.zeros(2), np.array([-100.0]))
    assert u.tolist() == [-1.0]


@pytest.mark.slow
def test_what_was_applied_is_where_the_flow_goes_on() -> None:
    flow = NewtonRaphsonFlow(DOUBLE, FlowSettings(20.0, 0.5, 0.02), [0.0])
    given_back = flow.update(np.zeros(2), np.array([1.0]))
    given_back[:] = 99.0  # ours: the flow does not see it
    flow.applied([0.25])
    assert flow.u.tolist() == [0.25]
    fresh = NewtonRaphsonFlow(DOUBLE, FlowSettings(20.0, 0.5, 0.02), [0.25])
    assert flow.update(np.zeros(2), np.array([1.0])) == pytest.approx(fresh.update(np.zeros(2), np.array([1.0])))


@pytest.mark.parametrize("delay", [0.02, 0.06, 0.013, 0.075])
def test_a_known_delay_changes_nothing_but_the_time(delay: float) -> None:
    step, start, target = 0.02, np.array([0.3, -0.4]), np.array([1.0])
    late = NewtonRaphsonFlow(DOUBLE, FlowSettings(15.0, 0.5, step, delay=delay), [0.1])
    prompt = NewtonRaphsonFlow(DOUBLE, FlowSettings(15.0, 0.5, step), [0.1])
    whole = math.floor(delay / step + 1e-9)
    part = delay - whole * step
    x, ahead, commands = start, moved(start, 0.1, delay), [0.1] * (whole + 1)
    for _ in range(60):
        u = late.update(x, target)
        assert u == pytest.approx(prompt.update(ahead, target), rel=1e-7, abs=1e-9)
        ahead = moved(ahead, u[0], step)
        commands.append(u[0])
        x = moved(moved(x, commands[-whole - 2], part), commands[-whole - 1], step - part)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_offset_free_removes_a_constant_disturbance(delay: float) -> None:
    def rests_at(offset_free: bool, push: float) -> tuple[float, NewtonRaphsonFlow]:
        chosen = FlowSettings(20.0, 0.5, 0.01, delay=delay, offset_free=offset_free)
        flow, x = NewtonRaphsonFlow(DOUBLE, chosen, [0.0]), np.zeros(2)
        acting = [0.0] * round(delay / 0.01)
        for _ in range(1500):
            acting.append(flow.update(x, np.array([1.0]))[0])
            x = moved(x, acting.pop(0), 0.01, push)
        return float(x[0]), flow

    assert abs(rests_at(False, 0.5)[0] - 1.0) > 0.05
    y, flow = rests_at(True, 0.5)
    assert y == pytest.approx(1.0, abs=1e-7)
    assert flow.disturbance[1] == pytest.approx(0.5, abs=1e-4)
    assert rests_at(True, 0.0)[0] == pytest.approx(rests_at(False, 0.0)[0], abs=1e-9)


def test_offset_free_leaves_the_law_of_a_right_model_alone() -> None:
    plain, estimating = (
        NewtonRaphsonFlow(DOUBLE, FlowSettings(20.0, 0.5, 0.01, offset_free=free), [0.0]) for free in (False, True)
    )
    x = np.array([0.4, 1.0])
    for k in range(200):
        r = np.array([math.sin(0.05 * k)])
        u = plain.update(x, r)
        assert estimating.update(x, r) == pytest.approx(u, rel=1e-6, abs=1e-6)
        x = moved(x, u[0], 0.01)


@pytest.mark.long
def test_prediction_steps_grow_as_the_bicycle_slows_down() -> None:
    flow = NewtonRaphsonFlow(bicycle_plant(FALCONE_2007), FlowSettings(30.0, 0.5, 0.01), np.zeros(2))
    steps = []
    for v in (19.0, 10.0, 4.0, 1.0):
        flow.applied(np.zeros(2))
        assert np.abs(flow.update(np.array([0, 0, v, 0, 0, 0.0]), np.array([0.5 * v, 0.01]))).max() < 1.0
        steps.append(flow.prediction_steps)
    assert steps[0] == 5
    assert steps == sorted(steps) and steps[-1] >= 0.5 * 209 / 2.7


@pytest.mark.long
def test_a_diverging_prediction_names_its_step() -> None:
    flow = NewtonRaphsonFlow(SWITCHED, FlowSettings(30.0, 0.5, 0.01, prediction_steps=100), np.zeros(2))
    with pytest.raises(FlowError, match=r"the prediction is not finite in step \d+ of 100") as error:
        flow.update(np.array([50.0, 0.0, 1.0, 1.0, 1.0]), np.array([1.0, 0.0]))  # infinite after 1 / 50 s: step 4
    assert 4 <= int(re.search(r"step (\d+) of", str(error.value))[1]) <= 20
    assert flow.u.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("k", "limit", "fine"), [(1.0, 1e6, True), (1e-9, 1e6, True), (1.0, 3.9, False), (0.0, 1e6, False)]
)
@pytest.mark.long
def test_singular_is_refused_whatever_the_units(k: float, limit: float, fine: bool) -> None:
    flow = NewtonRaphsonFlow(SWITCHED, FlowSettings(30.0, 0.5, 0.01, max_condition=limit), np.zeros(2))
    x, r = np.array([0.1, 0.0, 1.0, 1.0, k]), np.array([0.2, 0.1])
    if fine:
        assert np.isfinite(flow.update(x, r)).all()
    else:
        with pytest.raises(FlowError, match=f"singular or nearly so: condition number {'4' if k else 'inf'}"):
            flow.update(x, r)
        assert flow.u.tolist() == [0.0, 0.0]


@pytest.mark.long
def test_functions_may_return_a_part_of_what_they_are_given() -> None:
    flow = NewtonRaphsonFlow(Plant(lambda x, u: u, lambda x: x, 1, 1), FlowSettings(20.0, 0.5, 0.01), [0.3])
    by_hand = point_update(0.3, 0.1, 0.6, 0.5, integrator_gain(20.0, 0.01, "exact"))
    assert flow.update(np.array([0.1]), np.array([0.6])) == pytest.approx([by_hand], rel=1e-8)
    memoryless = MemorylessFlow(lambda u: u, 1, 20.0, 0.01, [0.3])
    assert memoryless.update(np.array([0.6])) == pytest.approx([0.6 - 0.3 * math.exp(-0.2)], rel=1e-8)


@pytest.mark.long
def test_memoryless_without_jacobian_solves_g() -> None:
    def g(u: Array) -> Array:
        return np.array([u[0] ** 3 + u[0] + 0.5 * u[1], u[1] - 0.5 * np.sin(u[0])])

    target, flow, errors = np.array([2.0, -0.7]), MemorylessFlow(g, 2, 5.0, 0.02, [0.0, 0.0]), []
    for _ in range(300):
        u = flow.update(target)
        errors.append(flow.control_error)
    assert g(u) == pytest.approx(target, abs=1e-12)
    assert errors[50] / errors[40] == pytest.approx(math.exp(-5.0 * 0.02 * 10), rel=1e-2)  # e' = -alpha e
