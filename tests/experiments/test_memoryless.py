"""Eqs 5 and 7 hold on the nonlinear plant, and are tight."""

import math

import numpy as np
import pytest

from robofleet.experiments.memoryless import MemorylessParameters, error_of, nonlinearity, run
from robofleet.experiments.paper import parameters_of

PARAMETERS: MemorylessParameters = parameters_of("memoryless")


@pytest.mark.long
def test_the_error_is_within_the_bound_and_near_it() -> None:
    p = PARAMETERS
    result = run(p)
    (table,) = result.tables
    assert len(table.rows) == 2 * len(p.alphas_1_s)
    for alpha, integrator, eta, bound, limsup, share in table.rows:
        assert eta == p.circle_radius * p.circle_rate_rad_s
        assert bound == pytest.approx(eta / alpha)
        assert limsup <= bound
        if integrator == "exact":
            expected = eta / math.hypot(alpha, p.circle_rate_rad_s)
            assert limsup == pytest.approx(expected, rel=0.05)
        assert share == pytest.approx(limsup / bound)


@pytest.mark.long
def test_a_flow_that_is_too_slow_for_the_claim_would_be_seen() -> None:
    times, errors = error_of(PARAMETERS, 3.0, "exact")
    assert errors[times >= 10].max() > PARAMETERS.circle_radius / 10  # of alpha = 10's bound


def test_the_plant_is_nonlinear_and_nowhere_singular() -> None:
    c = PARAMETERS.coupling
    g, g_u = nonlinearity(c)
    rng = np.random.default_rng(1)
    for u in rng.uniform(-4, 4, (300, 2)):
        assert np.linalg.det(g_u(u)) >= 1 - c * c - 1e-12
        e = 1e-6
        numeric = np.stack([(g(u + d) - g(u - d)) / (2 * e) for d in e * np.eye(2)], axis=1)
        assert np.abs(numeric - g_u(u)).max() < 1e-6
    assert np.abs(g_u(np.array([2.0, 2.0])) - g_u(np.zeros(2))).max() > 3
