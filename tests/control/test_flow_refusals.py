"""What the flow refuses, in words; and that a refusal changes nothing."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest

from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import FlowError, FlowSettings, MemorylessFlow, NewtonRaphsonFlow
from robofleet.vehicles.bicycle import FALCONE_2007

GOOD = FlowSettings(30.0, 0.5, 0.01)
BICYCLE = bicycle_plant(FALCONE_2007)
STRAIGHT = np.array([0.0, 0, 19, 0, 0, 0])
NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alpha": 0.0}, "alpha: expected a finite number above 0"),
        ({"alpha": NAN}, "alpha: expected a finite"),
        ({"horizon": -0.5}, "horizon: expected"),
        ({"horizon": INF}, "horizon: expected"),
        ({"step": 0}, "step: expected"),
        ({"delay": -0.01}, "delay: expected a finite number of at least 0"),
        ({"delay": "1"}, "delay: expected"),
        ({"prediction_steps": 0}, "prediction_steps: expected a whole number"),
        ({"prediction_steps": 2.5}, "prediction_steps: expected a whole number"),
        ({"integrator": "exakt"}, "integrator: expected exact or euler, got 'exakt'"),
        ({"predictor": "rk5"}, "predictor: expected rk4 or euler"),
        ({"lower": (1.0,)}, "lower: expected 2 numbers"),
        ({"upper": (1.0, NAN)}, "upper: expected 2 numbers"),
        ({"lower": (0.0, 2.0), "upper": (1.0, 1.0)}, "lower[1] is above upper[1]: 2 > 1"),
        ({"max_condition": 0.0}, "max_condition: expected"),
        ({"step": 2 / 30, "integrator": "euler"}, "take a step below 0.0667 s, or integrator exact"),
        ({"step": 0.1, "integrator": "euler"}, "alpha * step is 3: forward Euler diverges from 2 on"),
    ],
)
def test_bad_settings_are_named(change: dict[str, object], words: str) -> None:
    with pytest.raises(FlowError, match=re.escape(words)):
        NewtonRaphsonFlow(BICYCLE, replace(GOOD, **change), np.zeros(2))


@pytest.mark.slow
def test_unwise_settings_are_warned_of() -> None:
    assert NewtonRaphsonFlow(BICYCLE, replace(GOOD, step=0.1), np.zeros(2)).warnings == []
    (small,) = NewtonRaphsonFlow(BICYCLE, replace(GOOD, horizon=0.09), np.zeros(2)).warnings
    assert small.startswith("alpha * horizon is 2.7, less than 3")
    (ringing,) = NewtonRaphsonFlow(BICYCLE, replace(GOOD, step=0.05, integrator="euler"), np.zeros(2)).warnings
    assert ringing.startswith("alpha * step is 1.5, more than 1")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"f": lambda x, u: x[:4]}, "plant.f: expected an array of shape (6,), got (4,)"),
        ({"h": lambda x: x}, "plant.h: expected an array of shape (2,), got (6,)"),
        ({"f_x": lambda x, u: np.zeros((6, 2))}, "plant.f_x: expected an array of shape (6, 6), got (6, 2)"),
        ({"f_u": lambda x, u: np.zeros(6)}, "plant.f_u: expected an array of shape (6, 2), got (6,)"),
        ({"h_x": lambda x: np.zeros((6, 2))}, "plant.h_x: expected an array of shape (2, 6), got (6, 2)"),
        ({"f_x": None}, "plant.f_x and plant.f_u: give both or neither"),
        ({"n": 3}, "plant.f: expected an array of shape (3,), got (6,)"),
        ({"n": 5, "f": lambda x, u: x + STRAIGHT}, "plant.f: fails for arrays of [5, 2] numbers"),
        ({"n": 0}, "plant.n: expected a whole number of at least 1, got 0"),
        ({"f": functools.partial(np.multiply, 2.0)}, "plant.f: expected a Python function, got functools.partial"),
        ({"f": lambda x, u: x.mass}, "plant.f: fails for arrays of [6, 2] numbers: AttributeError: 'numpy.ndarray'"),
    ],
)
def test_bad_plants_are_named(change: dict[str, object], words: str) -> None:
    with pytest.raises(FlowError, match=re.escape(words)):
        NewtonRaphsonFlow(replace(BICYCLE, **change), GOOD, np.zeros(2))


@pytest.mark.parametrize("u0", [[0.0], [0.0, 0.0, 0.0], "no", [None, 1.0], 1.0])
def test_bad_start(u0: object) -> None:
    with pytest.raises(FlowError, match="u0: expected"):
        NewtonRaphsonFlow(BICYCLE, GOOD, u0)


def refused(flow: NewtonRaphsonFlow, x: object, r: object) -> str:
    before = flow.u
    with pytest.raises(FlowError) as error:
        flow.update(x, r)
    assert flow.u.tolist() == before.tolist()
    return str(error.value)


def test_bad_states_and_references_are_named() -> None:
    flow = NewtonRaphsonFlow(BICYCLE, GOOD, np.zeros(2))
    r = np.array([9.5, 0.0])
    assert refused(flow, STRAIGHT[:5], r) == "x: expected shape (6,), got (5,)"
    assert refused(flow, STRAIGHT, np.zeros((2, 1))) == "r: expected shape (2,), got (2, 1)"
    assert refused(flow, np.array([0, 0, 19, NAN, 0, 0]), r).startswith("x[3] is not finite")
    assert refused(flow, STRAIGHT, np.array([9.5, -INF])).startswith("r[1] is not finite")
    assert refused(flow, "nonsense", r).startswith("x: expected 6 numbers")
    assert np.isfinite(flow.update(STRAIGHT, r)).all()


def test_other_arrays_mean_the_same() -> None:
    updates = []
    for x in (STRAIGHT, STRAIGHT.tolist(), STRAIGHT.astype(np.int32), np.stack([STRAIGHT] * 2, axis=1)[:, 0]):
        updates.append(NewtonRaphsonFlow(BICYCLE, GOOD, np.zeros(2)).update(x, np.array([9.6, 0.1])).tolist())
    frozen = STRAIGHT.copy()
    frozen.setflags(write=False)
    updates.append(NewtonRaphsonFlow(BICYCLE, GOOD, np.zeros(2)).update(frozen, (9.6, 0.1)).tolist())
    assert all(u == updates[0] for u in updates)


def test_too_few_prediction_steps() -> None:
    flow = NewtonRaphsonFlow(BICYCLE, replace(GOOD, prediction_steps=5), np.zeros(2))
    flow.update(STRAIGHT, np.array([9.5, 0.0]))
    slow = np.array([0.0, 0, 2, 0, 0, 0])
    assert "prediction_steps: 5 are too few for the fastest eigenvalue, 2" in refused(flow, slow, np.array([1.0, 0.0]))
    braking = NewtonRaphsonFlow(BICYCLE, replace(GOOD, prediction_steps=5), np.array([-15.0, 0.0]))
    assert "prediction_steps: 5 are too few" in refused(braking, np.array([0.0, 0, 8.5, 0, 0, 0]), np.array([1.0, 0.0]))


def test_a_vehicle_at_rest_has_no_finite_rate() -> None:
    flow = NewtonRaphsonFlow(BICYCLE, GOOD, np.zeros(2))
    assert "fastest eigenvalue of f_x" in refused(flow, np.zeros(6), np.array([1.0, 0.0]))
    assert "fastest eigenvalue of f_x" in refused(flow, np.array([0, 0, 1e-9, 0, 0, 0]), np.array([1.0, 0.0]))


def test_memoryless_of_a_wrong_shape() -> None:
    with pytest.raises(FlowError, match=re.escape("g: expected an array of shape (2,), got (3,)")):
        MemorylessFlow(lambda u: np.zeros(3), 2, 1.0, 0.1, [0.0, 0.0])
