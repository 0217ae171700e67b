"""A plant that is learned from samples: its rates against those that made the samples, its Jacobians against them."""

import numpy as np
import pytest

from robofleet.control.flow import FlowError, FlowSettings, NewtonRaphsonFlow, Plant
from robofleet.control.learned import Network, Polynomial, Samples, learned_plant
from robofleet.control.margins import slopes
from robofleet.core.arrays import Array

STEP = 0.02


def chain(x: Array, u: Array) -> Array:
    """What is known: the position's rate is the velocity."""
    return np.array([x[1], 0.0])


def by_state(x: Array, u: Array) -> Array:
    return np.array([[0.0, 1.0], [0.0, 0.0]])


def by_input(x: Array, u: Array) -> Array:
    return np.zeros((2, 1))


def stiff(x: Array, u: Array) -> Array:
    """A spring that hardens, with a damper and a motor."""
    return np.array([x[1], -2.0 * x[0] - x[0] ** 3 - 8.0 * x[1] + 3.0 * u[0]])


def saturated(x: Array, u: Array) -> Array:
    return np.array([x[1], -3.0 * np.tanh(2.0 * x[0]) - x[1] + 2.0 * u[0]])


def half_known(x: Array, u: Array) -> Array:
    return np.array([x[1], -x[0] - 5.0 * x[1] + 3.0 * u[0]])


CHAIN = Plant(chain, lambda x: x[:1].copy(), 2, 1, by_state, by_input)
KINDS = [Polynomial(2), pytest.param(Network(6), marks=pytest.mark.slow)]


def driven(f, count: int = 600) -> Samples:  # type: ignore[no-untyped-def]
    """Samples from a drive under random inputs, integrated in short steps."""
    rng = np.random.default_rng(3)
    states, inputs = [np.zeros(2)], []
    for _ in range(count):
        u, x = rng.uniform(-2, 2, 1), states[-1].copy()
        for _ in range(20):
            k = f(x, u)
            x = x + STEP / 20 * f(x + STEP / 40 * k, u)
        inputs.append(u)
        states.append(x if abs(x[0]) < 1.5 else rng.uniform(-1, 1, 2))
    after = np.array([*states[1:]])
    moved = np.abs(after[:, 0] - np.array(states[:-1])[:, 0]) < 0.2  # not those that were set back
    return Samples(np.array(states[:-1])[moved], np.array(inputs)[moved], after[moved], STEP)


def off(plant: Plant, truth, samples: Samples) -> float:  # type: ignore[no-untyped-def]
    """The largest error of the learned rate where the samples are."""
    return max(abs(plant.f(x, u)[1] - truth(x, u)[1]) for x, u in zip(samples.x[::7], samples.u[::7], strict=True))


@pytest.mark.parametrize("known", [pytest.param(chain, marks=pytest.mark.slow), half_known])
def test_a_polynomial_is_found_alone_and_as_the_rest_of_a_wrong_model(known) -> None:  # type: ignore[no-untyped-def]
    samples = driven(stiff)
    plant, unexplained = learned_plant(Plant(known, CHAIN.h, 2, 1), samples, (0, 1), (1,), Polynomial(3))
    assert off(plant, stiff, samples) < 1e-3  # a difference quotient would be off by some 8 % of 8 |x2|
    assert unexplained[0] < 1e-4


@pytest.mark.slow
def test_a_network_finds_what_saturates() -> None:
    samples = driven(saturated)
    plant, unexplained = learned_plant(CHAIN, samples, (0, 1), (1,), Network(8))
    assert off(plant, saturated, samples) < 0.2
    assert unexplained[0] < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_jacobians_are_those_of_the_rates(kind: Polynomial | Network) -> None:
    plant = learned_plant(CHAIN, driven(stiff), (0, 1), (1,), kind).plant
    assert plant.f_x is not None and plant.f_u is not None
    x, u = np.array([0.3, -0.2]), np.array([0.7])
    assert plant.f_x(x, u) == pytest.approx(slopes(lambda at: plant.f(at, u), x), abs=1e-6)
    assert plant.f_u(x, u) == pytest.approx(slopes(lambda at: plant.f(x, at), u), abs=1e-6)


@pytest.mark.long
def test_the_flow_steps_on_a_learned_plant_as_on_the_true_one() -> None:
    plant = learned_plant(CHAIN, driven(stiff), (0, 1), (1,), Polynomial(3)).plant
    updates = []
    for each in (plant, Plant(stiff, CHAIN.h, 2, 1)):
        flow = NewtonRaphsonFlow(each, FlowSettings(20.0, 0.3, 0.02), [0.0])
        updates.append([float(flow.update(np.array([0.2, 0.1]), np.array([0.5]))[0]) for _ in range(5)])
    assert updates[0] == pytest.approx(updates[1], rel=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: Samples(s.x[:30], s.u[:30], s.after[:30], STEP), "30 are too few for 20 features: give 40 or more"),
        (lambda s: Samples(s.x * np.nan, s.u, s.after, STEP), "some numbers are not finite"),
        (lambda s: Samples(s.x, s.u[:-1], s.after, STEP), "samples: expected x"),
    ],
)
def test_samples_that_cannot_be_used_are_refused(change, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(FlowError, match=message):
        learned_plant(CHAIN, change(driven(stiff, 60)), (0, 1), (1,), Polynomial(3))
