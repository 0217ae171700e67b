"""What a loop bears: against Nyquist and Routh in continuous time, and against nonlinear simulations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import FlowError, FlowSettings, NewtonRaphsonFlow
from robofleet.experiments.growth import flow_growth, robot_growth
from robofleet.experiments.stability import DOUBLE_INTEGRATOR, INVERTED_PENDULUM
from robofleet.runs.margins import robot_loop
from robofleet.vehicles.bicycle import FALCONE_2007

REST, NO_INPUT = np.zeros(2), [0.0]
STRAIGHT = np.array([0.0, 0.0, 19.0, 0.0, 0.0, 0.0])


def phase_margin_delay(alpha: float, T: float) -> float:
    """The delay margin of 2 alpha (1 + T s) / (T^2 s^2 (s + alpha)): the flow on the double integrator [s]."""
    low, high = 1e-3, 1e4
    for _ in range(200):
        omega = math.sqrt(low * high)
        size = 2 * alpha * math.hypot(1, omega * T) / (T**2 * omega**2 * math.hypot(omega, alpha))
        low, high = (omega, high) if size > 1 else (low, omega)
    return (math.atan(omega * T) - math.atan(omega / alpha)) / omega


def routh_lag(alpha: float, T: float) -> float:
    """The largest tau of tau s^4 + (1 + alpha tau) s^3 + alpha s^2 + 2 alpha / T s + 2 alpha / T^2 [s]."""
    low, high = 0.0, 100.0
    for _ in range(100):
        tau = (low + high) / 2
        b, c, d, e = 1 + alpha * tau, alpha, 2 * alpha / T, 2 * alpha / T**2
        first = (b * c - tau * d) / b
        stable = first > 0 and (first * d - b * e) / first > 0
        low, high = (tau, high) if stable else (low, tau)
    return low


@pytest.mark.parametrize(("alpha", "T", "step"), [(20.0, 0.3, 2e-3), (60.0, 0.1, 5e-4), (10.0, 0.25, 2e-3)])
def test_with_short_steps_the_margins_are_those_of_continuous_time(alpha: float, T: float, step: float) -> None:
    found = NewtonRaphsonFlow(DOUBLE_INTEGRATOR, FlowSettings(alpha, T, step), NO_INPUT).margins(REST, NO_INPUT)
    assert found.delay + step / 2 == pytest.approx(phase_margin_delay(alpha, T), rel=0.02)
    assert found.lag == pytest.approx(routh_lag(alpha, T), rel=0.05)
    assert found.gain[0] == -1.0 and found.gain[1] > 50.0  # alpha T > 1 is stable for every gain


def test_a_loop_that_is_unstable_by_itself_bears_nothing() -> None:
    found = NewtonRaphsonFlow(DOUBLE_INTEGRATOR, FlowSettings(20.0, 0.04, 0.001), NO_INPUT).margins(REST, NO_INPUT)
    assert found.spectral_radius > 1.0
    assert (found.delay, found.lag, found.gain) == (0.0, 0.0, (0.0, 0.0))


@pytest.mark.parametrize("offset_free", [False, True])
def test_errors_of_a_bicycle_die_away_below_its_margin_and_grow_above(offset_free: bool) -> None:
    settings, plant = FlowSettings(30.0, 0.25, 0.01, delay=0.013, offset_free=offset_free), bicycle_plant(FALCONE_2007)

    def flow() -> NewtonRaphsonFlow:
        return NewtonRaphsonFlow(plant, settings, np.zeros(2))

    margin = flow().margins(STRAIGHT, np.zeros(2)).delay
    below, above = (flow_growth(flow(), plant, STRAIGHT, 15.0, share * margin) for share in (0.97, 1.03))
    assert below < 1.0 < above


@pytest.mark.slow
def test_errors_of_an_inverted_pendulum_do_so_too() -> None:
    settings = FlowSettings(40.0, 0.2, 0.02, delay=0.03)

    def flow() -> NewtonRaphsonFlow:
        return NewtonRaphsonFlow(INVERTED_PENDULUM, settings, NO_INPUT)

    found = flow().margins(REST, NO_INPUT)
    below, above = (flow_growth(flow(), INVERTED_PENDULUM, REST, 20.0, share * found.delay) for share in (0.97, 1.03))
    assert below < 1.0 < above
    assert -1.0 < found.gain[0] < 0.0  # with too little gain it falls


@pytest.mark.slow
@pytest.mark.parametrize("disturbance", ["none", pytest.param("estimated", marks=pytest.mark.slow)])
def test_errors_of_a_robot_under_its_filter_do_so_too(disturbance: str) -> None:
    config = load_config(SHIPPED / "platoon.yaml", [f"controller.disturbance={disturbance}", "controller.alpha=30"])
    robot = config.members[0]
    margin = robot_loop(config, robot, 0.15).margins().delay
    below, above = (robot_growth(config, robot, 0.15, 20.0, share * margin) for share in (0.96, 1.04))
    assert below < 1.0 < above


def test_limits_of_the_input_do_not_count() -> None:
    free = FlowSettings(20.0, 0.3, 0.01)
    bounded = replace(free, lower=(0.0,), upper=(0.0,))
    margins = [NewtonRaphsonFlow(DOUBLE_INTEGRATOR, s, NO_INPUT).margins(REST, NO_INPUT) for s in (free, bounded)]
    assert margins[0] == margins[1]


def test_a_state_at_which_the_flow_cannot_step_is_named() -> None:
    flow = NewtonRaphsonFlow(bicycle_plant(FALCONE_2007), FlowSettings(30.0, 0.25, 0.01), np.zeros(2))
    with pytest.raises(FlowError, match="x: expected shape"):
        flow.margins(REST, np.zeros(2))
    with pytest.raises(FlowError, match="fastest eigenvalue"):
        flow.margins(np.zeros(6), np.zeros(2))
