"""The two thresholds of a wheel, dead band and breakaway: their posterior on a grid.

They make the squares a staircase, which has no derivative. What the other parameters become where a threshold is
another one counts too: linearised, they are as likely as they can be at each point of the grid.
"""

from collections.abc import Callable
from dataclasses import astuple, replace
from itertools import product

import numpy as np

from robofleet.calibration.robots.information import (
    OUTLIER_SIGMA,
    PARAMETERS,
    THRESHOLDS,
    Prior,
    Residuals,
    derivative,
)
from robofleet.calibration.robots.shooting import Wheels
from robofleet.core.arrays import Array

_STEP = 0.05  # [rad/s]
_COARSE = _STEP * (np.arange(50) + 0.5)  # none is 0: the plant's wheel never stands if nothing holds it
_LIKELY = 1e-3  # of the most likely one's likelihood
_FINE = 13  # values of each threshold that are likely

Cost = Callable[[Wheels], float]


def cost(residuals: Residuals, wheels: Wheels, prior: Prior, names: tuple[str, ...]) -> Cost:
    """Return minus twice the log-posterior of a model's thresholds, where ``names`` of other parameters may change.

    ``wheels`` is the model whose other parameters are the best ones now. What no noise explains counts as an outlier.
    """
    rows = [PARAMETERS.index(name) for name in names]
    thresholds = [PARAMETERS.index(name) for name in THRESHOLDS]
    jacobian = np.vstack([derivative(residuals, wheels, prior, names), np.eye(len(names))])
    explained, _ = np.linalg.qr(jacobian)

    def scaled(model: Wheels) -> Array:
        return np.asarray((np.array(astuple(model)) - prior.centre) / prior.sigmas)

    def of(model: Wheels) -> float:
        e = np.clip(residuals(model).ravel(), -OUTLIER_SIGMA, OUTLIER_SIGMA)
        e = np.concatenate([e, scaled(model)[rows]])
        return float(e @ e - np.sum((explained.T @ e) ** 2) + np.sum(scaled(model)[thresholds] ** 2))

    return of


def posterior(cost: Cost, wheels: Wheels) -> tuple[Array, Array]:
    """Return the means (2,) and standard deviations (2,) of THRESHOLDS [rad/s]."""
    best, grids = wheels, []
    for name in THRESHOLDS:
        weights = _weights([cost(replace(best, **{name: value})) for value in _COARSE.tolist()])
        best = replace(best, **{name: _COARSE[weights.argmax()]})
        likely = _COARSE[weights > _LIKELY * weights.max()]
        edges = np.linspace(max(0.0, likely[0] - _STEP), likely[-1] + _STEP, _FINE + 1)
        grids.append((edges[:-1] + edges[1:]) / 2.0)
    points = np.array([(band, breakaway) for band, breakaway in product(*grids) if band <= breakaway])
    models = [replace(wheels, **dict(zip(THRESHOLDS, point, strict=True))) for point in points.tolist()]
    weights = _weights([cost(model) for model in models])
    means = weights @ points
    steps = np.array([grid[1] - grid[0] for grid in grids])
    return means, np.sqrt(weights @ (points - means) ** 2 + steps**2 / 12.0)


def _weights(costs: list[float]) -> Array:
    likelihoods = np.exp(-0.5 * (np.array(costs) - min(costs)))
    return np.asarray(likelihoods / likelihoods.sum())
