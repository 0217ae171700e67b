"""One step of the Newton-Raphson flow (eq. 31) against the solution of its differential equation."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.flow import integrator_gain, point_update

ALPHA, T, STEP = 45.0, 0.6, 0.033
EXACT = settings(deadline=None, derandomize=True)


def solve(u: float, x: float, r: float, alpha: float, horizon: float, step: float) -> float:
    """Integrate u' = (alpha / T) (r - x - T u) by the classical Runge-Kutta method."""
    n = 2000
    h = step / n

    def rate(u: float) -> float:
        return alpha / horizon * (r - x - horizon * u)

    for _ in range(n):
        k1 = rate(u)
        k2 = rate(u + h / 2 * k1)
        k3 = rate(u + h / 2 * k2)
        u += h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(u + h * k3))
    return u


@pytest.mark.parametrize(("alpha", "step"), [(45.0, 0.033), (10.0, 0.1), (100.0, 0.05), (1.0, 0.001)])
def test_exact_is_the_solution_of_the_flow(alpha: float, step: float) -> None:
    gain = integrator_gain(alpha, step, "exact")
    for u, x, r in ((0.0, 0.1, 0.3), (0.4, -0.2, -0.1), (-0.1, 0.0, 0.0)):
        assert point_update(u, x, r, T, gain) == pytest.approx(solve(u, x, r, alpha, T, step), abs=1e-9)


def test_euler_is_one_step_along_the_slope() -> None:
    gain = integrator_gain(ALPHA, STEP, "euler")
    u, x, r = 0.05, 0.2, 0.35
    assert point_update(u, x, r, T, gain) == pytest.approx(u + STEP * ALPHA / T * (r - x - T * u))


@EXACT
@given(st.floats(0.1, 200.0), st.floats(1e-4, 0.5), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_exact_never_overshoots(alpha: float, step: float, u: float, r: float) -> None:
    fixed_point = r / T
    after = point_update(u, 0.0, r, T, integrator_gain(alpha, step, "exact"))
    low, high = sorted((u, fixed_point))
    assert low - 1e-12 <= after <= high + 1e-12
    assert abs(after - fixed_point) <= abs(u - fixed_point) * math.exp(-alpha * step) + 1e-12


@EXACT
@given(st.floats(0.1, 100.0), st.floats(1e-4, 0.1), st.integers(1, 7))
def test_exact_does_not_depend_on_the_step(alpha: float, step: float, pieces: int) -> None:
    u = 0.3
    for _ in range(pieces):
        u = point_update(u, 0.0, 0.1, T, integrator_gain(alpha, step / pieces, "exact"))
    assert u == pytest.approx(point_update(0.3, 0.0, 0.1, T, integrator_gain(alpha, step, "exact")))


@pytest.mark.parametrize(
    ("step", "rings", "diverges"), [(0.02, False, False), (0.033, True, False), (0.045, True, True)]
)
def test_euler_rings_above_1_and_diverges_above_2(step: float, rings: bool, diverges: bool) -> None:
    gain = integrator_gain(ALPHA, step, "euler")
    errors = [1.0]
    for _ in range(50):
        errors.append(point_update(errors[-1], 0.0, 0.0, T, gain))
    changes = np.sign(errors[1:]) != np.sign(errors[:-1])
    assert changes.all() if rings else not changes.any()
    assert (abs(errors[-1]) > 1.0) == diverges
