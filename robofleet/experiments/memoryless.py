"""The flow on a memoryless plant (eqs 1-7): the error's limsup is at most eta, and eta / alpha with speed-up alpha.

g(u) = (u1 + u1^3 / 3 + c sin u2, u2 + u2^3 / 3 - c sin u1). dg/du = ((1 + u1^2, c cos u2), (-c cos u1, 1 + u2^2)) has
the determinant (1 + u1^2)(1 + u2^2) + c^2 cos u1 cos u2 >= 1 - c^2: nonsingular everywhere for |c| < 1. And |g| grows
without bound, so that g(u) = r has a solution for every r.
"""

import functools
import math
from collections.abc import Callable, Iterator

import numpy as np
from pydantic import Field

from robofleet.config.faults import Complaint
from robofleet.config.files.parameters import Parameters
from robofleet.control.flow import Integrator, MemorylessFlow
from robofleet.core.arrays import Array
from robofleet.core.settings import Positive
from robofleet.experiments.results import Cell, Curve, Figure, Panel, Result, Table

_TIME_CONSTANTS = 10.0  # after so many 1 / alpha the start is forgotten


class MemorylessParameters(Parameters):
    """What configs/paper/memoryless.yaml holds."""

    alphas_1_s: tuple[Positive, ...] = Field(min_length=1, strict=False)
    step_s: Positive
    duration_s: Positive
    settle_s: Positive
    circle_radius: Positive
    circle_rate_rad_s: Positive
    coupling: float = Field(gt=-1, lt=1)

    def complaints(self) -> Iterator[Complaint]:
        """A limsup needs some time after the transient."""
        slowest = max(self.settle_s, _TIME_CONSTANTS / min(self.alphas_1_s))
        if self.duration_s <= slowest + math.tau / self.circle_rate_rad_s:
            yield "duration_s", f"must be longer than {slowest:g} s of transient and one round of the circle"


@functools.cache
def nonlinearity(c: float) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Return g and dg/du; c is the coupling."""

    def g(u: Array) -> Array:
        return np.array([u[0] + u[0] ** 3 / 3.0 + c * np.sin(u[1]), u[1] + u[1] ** 3 / 3.0 - c * np.sin(u[0])])

    def g_u(u: Array) -> Array:
        return np.array([[1.0 + u[0] ** 2, c * np.cos(u[1])], [-c * np.cos(u[0]), 1.0 + u[1] ** 2]])

    return g, g_u


def run(parameters: MemorylessParameters) -> Result:
    """Drive the flow around the circle for every alpha and integrator; compare the error with eta / alpha."""
    p = parameters
    eta = p.circle_radius * p.circle_rate_rad_s
    rows: list[tuple[Cell, ...]] = []
    curves = []
    for alpha in p.alphas_1_s:
        for integrator in ("exact", "euler"):
            t, errors = error_of(p, alpha, integrator)
            largest = float(errors[t >= max(p.settle_s, _TIME_CONSTANTS / alpha)].max())
            rows.append((alpha, integrator, eta, eta / alpha, largest, largest * alpha / eta))
            if integrator == "exact":
                curves.append(Curve(f"alpha {alpha:g}", t, errors))
                curves.append(Curve(f"eta / alpha, {alpha:g}", t[[0, -1]], np.full(2, eta / alpha), "dashed"))
    notes = (
        f"The error is |r - g(u)| after each step of {p.step_s:g} s; eta = sup |r'|, the circle's speed.",
        "On a circle of rate q the flow's error tends to eta / sqrt(alpha^2 + q^2): the bound is nearly reached.",
    )
    columns = ("alpha [1/s]", "integrator", "eta", "eta / alpha", "limsup of the error", "of the bound")
    table = Table(
        "Memoryless plant: error and its bound (eqs 5, 7)",
        columns,
        tuple(rows),
        notes,
        ("g", "", ".4g", ".4g", ".4f", ".4f"),
    )
    panel = Panel("time [s]", "|r - g(u)|", tuple(curves), scales=("linear", "log"))
    data = {"eta": eta, "worst_of_bound": max(float(row[5] or 0.0) for row in rows)}
    return Result((table,), (Figure("error", "Tracking error of the memoryless flow and its bounds", (panel,)),), data)


def error_of(p: MemorylessParameters, alpha: float, integrator: Integrator) -> tuple[Array, Array]:
    """Return times (N,) and |r - g(u)| (N,) after each step."""
    g, g_u = nonlinearity(p.coupling)
    flow = MemorylessFlow(g, 2, alpha, p.step_s, np.zeros(2), g_u=g_u, integrator=integrator)
    t: Array = p.step_s * np.arange(1.0, round(p.duration_s / p.step_s) + 1.0)
    angle = p.circle_rate_rad_s * t
    r = p.circle_radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    u = np.array([flow.update(target) for target in r])
    y = g(u.T).T
    return t, np.asarray(np.linalg.norm(r - y, axis=1), dtype=np.float64)
