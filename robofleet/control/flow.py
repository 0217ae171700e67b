"""The Newton-Raphson flow.

The input follows u' = alpha (dg/du)^-1 (r(t+T) - g(x, u))  (eq. 14). For a point that obeys x' = u the predicted
output is g(x, u) = x + T u (eq. 30) and dg/du = T, so that u' = (alpha / T) (r(t+T) - x - T u)  (eq. 31).
"""

import math
from typing import Literal

from robofleet.kernels import kernel


def integrator_gain(alpha: float, step: float, integrator: Literal["exact", "euler"]) -> float:
    """Return the fraction of the way to the flow's fixed point that u goes in one step.

    With r and x held over the step eq. 31 is linear in u: its exact solution goes 1 - exp(-alpha step) of the way and
    never overshoots; forward Euler, the paper's, goes alpha step, rings above 1 and diverges above 2.
    alpha [1/s], step [s].
    """
    return -math.expm1(-alpha * step) if integrator == "exact" else alpha * step


@kernel
def point_update(u: float, x: float, r: float, horizon: float, gain: float) -> float:
    """Return u after one step of eq. 31, for one coordinate. x, r [m], u [m/s], horizon T [s]; r is r(t+T)."""
    return u + gain * ((r - x) / horizon - u)
