"""One step of the Newton-Raphson flow (eq. 31) against the solution of its differential equation."""

import numpy as np
import pytest

from robofleet.control.flow import integrator_gain, point_update

ALPHA, T, STEP = 45.0, 0.6, 0.033


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
