"""The stability maps against the double integrator's own eigenvalues, and its boundary T_alpha = 1 / alpha."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.flow import FlowSettings, Integrator
from robofleet.experiments.paper import parameters_of
from robofleet.experiments.stability import (
    DOUBLE_INTEGRATOR,
    StabilityParameters,
    boundary,
    run,
    simulated_growth,
    spectral_radius,
)

EXACT = settings(deadline=None, derandomize=True, max_examples=40)
REST = np.zeros(2)


def exact_step(alpha: float, horizon: float, step: float, integrator: Integrator) -> np.ndarray:
    """Return the exact map (3, 3) of (x1, x2, u) over a control step with zero-order hold."""
    gain = -np.expm1(-alpha * step) if integrator == "exact" else alpha * step
    update = np.array([-2.0 * gain / horizon**2, -2.0 * gain / horizon, 1.0 - gain])
    return np.array([[1.0, step, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]) + np.outer([step**2 / 2, step, 1.0], update)


@EXACT
@given(st.floats(1, 100), st.floats(0.05, 5), st.floats(0.001, 1.9), st.sampled_from(("exact", "euler")))
def test_the_real_controller_has_the_exact_eigenvalues(
    alpha: float, alpha_t: float, alpha_step: float, integrator: Integrator
) -> None:
    T, step = alpha_t / alpha, alpha_step / alpha
    exact = np.abs(np.linalg.eigvals(exact_step(alpha, T, step, integrator))).max()
    found = spectral_radius(DOUBLE_INTEGRATOR, FlowSettings(alpha, T, step, integrator), REST)
    assert found == pytest.approx(exact, rel=1e-4)


@EXACT
@given(st.floats(0.5, 200))
@pytest.mark.long
def test_t_alpha_is_one_over_alpha(alpha: float) -> None:
    def radius(T: float) -> float:
        return spectral_radius(DOUBLE_INTEGRATOR, FlowSettings(alpha, T, 0.002 / alpha), REST)

    assert boundary(radius, 0.1 / alpha, 10 / alpha) == pytest.approx(1 / alpha, rel=0.002)


@pytest.mark.parametrize(("alpha_t", "stable"), [(0.98, False), (1.02, True)])
def test_simulation_agrees(alpha_t: float, stable: bool) -> None:
    growth = simulated_growth(DOUBLE_INTEGRATOR, FlowSettings(20.0, alpha_t / 20, 0.02 / 20), 200 / 20)
    assert (growth < 0.8) if stable else (growth > 1.25)


def test_euler_is_refused_from_two_over_alpha_on() -> None:
    assert spectral_radius(DOUBLE_INTEGRATOR, FlowSettings(20.0, 0.5, 0.1, "euler"), REST) == np.inf
    assert spectral_radius(DOUBLE_INTEGRATOR, FlowSettings(20.0, 0.5, 0.1, "exact"), REST) < 1.0


def test_no_boundary_is_nan() -> None:
    assert np.isnan(boundary(lambda T: 0.5, 1.0, 2.0))


@pytest.mark.long
def test_the_experiment() -> None:
    shipped: StabilityParameters = parameters_of("stability")
    p = shipped.model_copy(update={"points": 4})
    result = run(p)
    horizons, simulated, steps, delays = result.tables
    assert result.data["double_integrator_deviation"] < 0.02
    for plant, alpha, _, alpha_t in horizons.rows:
        low, high = (0.98, 1.02) if plant == "double integrator" else (0.98, 1.7)
        assert low < alpha_t < high, (plant, alpha)
    assert [row[3] for row in simulated.rows] == ["unstable", "stable"] * len(p.boundary_alphas_1_s)
    for _, integrator, alpha, _, alpha_step in steps.rows:
        assert (alpha_step < 2.0) if integrator == "euler" else (alpha_step > 2.0), alpha
    assert max(abs(float(row[4])) for row in delays.rows) < 1.0
    (over_t, over_step, over_delay) = result.figures
    assert len(over_delay.panels) == 3
    assert [panel.field.values.shape for panel in over_t.panels + over_step.panels] == [(4, 4)] * 7
    for panel in over_t.panels:
        stable = panel.field.values
        assert (stable[panel.field.y[:, None] * panel.field.x >= 3.0] == 1.0).all()  # the rule alpha T >= 3
        assert (stable[panel.field.y[:, None] * panel.field.x < 0.98] == 0.0).all()
