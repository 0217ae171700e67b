"""A plant that is learned from samples: f(x, u) is a known part and a combination of features, fitted to what happened.

The known part may be a model whose parameters are wrong, or nothing but definitions (a position's rate is the
velocity); the rest is learned: polynomials of states and inputs by ridge regression, or a network of one hidden layer
of tanh by Levenberg's and Marquardt's method. What comes of it is a ``Plant`` like any other, with its Jacobians.

A sample is a state, the input that was held for a time after it, and the state then. The model is integrated over that
time, and what is missing at its end is what the features are fitted to, several times: so the fit is that of the
integrated model, and not of a difference quotient.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np

from robofleet.control.arrays import cached, compiled
from robofleet.control.flow_settings import FlowError
from robofleet.control.prediction import Plant
from robofleet.core.arrays import Array, Indices

_REFITS = 4  # each leaves a few percent of what the one before was off
_DAMPING = 1e-2  # of the first step of Levenberg's and Marquardt's method
_STEPS = 60


@dataclass(frozen=True)
class Samples:
    """What happened: K samples.

    Attributes:
        x: States (K, n).
        u: The inputs (K, m) that were held from then on.
        after: The states (K, n) a time ``step`` later.
        step: That time [s].
    """

    x: Array
    u: Array
    after: Array
    step: float


@dataclass(frozen=True)
class Polynomial:
    """Features: all products of up to ``degree`` of the scaled states and inputs."""

    degree: int


@dataclass(frozen=True)
class Network:
    """Features: ``hidden`` tanh of sums of the scaled states and inputs, and 1; ``seed`` draws the first sums."""

    hidden: int
    seed: int = 0


class Fit(NamedTuple):
    """A learned plant, and how well it explains each learned rate of the samples.

    Attributes:
        plant: The plant.
        unexplained: (R,) root mean square of the rates that it leaves [units of the states, by s].
    """

    plant: Plant
    unexplained: Array


@dataclass(frozen=True)
class _Features:
    """Both kernels take the two arrays first. ``values`` is written for one sample, xi (d,), and for K, xi (d, K)."""

    count: int
    values: Callable[[Any, Any, Array, Array], None]  # first, second, xi, phi (P, ...)
    slopes: Callable[[Any, Any, Array, Array, Array], None]  # first, second, xi, phi of it, dphi/dxi (P, d)
    first: Any
    second: Any


def learned_plant(
    known: Plant, samples: Samples, states: tuple[int, ...], rates: tuple[int, ...],
    features: Polynomial | Network, ridge: float = 1e-8,
) -> Fit:  # fmt: skip
    """Fit the rates that a known plant does not have right.

    Args:
        known: The part that is known; its output is the learned plant's.
        samples: What happened.
        states: Which states the rest depends on, beside all inputs.
        rates: Of which states the rates are learned.
        features: What is fitted.
        ridge: How dear large weights are, relative to the samples.

    Returns:
        The plant, with Jacobians if the known one has them.

    Raises:
        FlowError: There are too few samples, or a number in them cannot be used.
    """
    x, u, after = samples.x, samples.u, samples.after
    shapes = (len(x), known.n), (len(x), known.m)
    if (x.shape, u.shape, after.shape) != (*shapes, shapes[0]):
        raise FlowError(f"samples: expected x {shapes[0]}, u {shapes[1]}, after {shapes[0]}")
    if not (np.isfinite(x).all() and np.isfinite(u).all() and np.isfinite(after).all()):
        raise FlowError("samples: some numbers are not finite")
    chosen = np.array(states, dtype=np.int64)
    seen = np.concatenate([x[:, chosen], u], axis=1)
    centre, scale = seen.mean(axis=0), np.maximum(2.0 * seen.std(axis=0), 1e-9)
    middle = (np.concatenate([((x + after) / 2.0)[:, chosen], u], axis=1) - centre) / scale

    def missing(f: Callable[[Array, Array], Array]) -> Array:
        return (after - _integrated(f, x, u, samples.step))[:, list(rates)] / samples.step

    def rates_of(basis: _Features, weights: Array) -> Callable[[Array, Array], Array]:
        def f(at: Array, held: Array) -> Array:
            total = np.array([known.f(*each) for each in zip(at, held, strict=True)])
            xi = (np.concatenate([at[:, chosen], held], axis=1) - centre) / scale
            total[:, list(rates)] += _values(basis, xi) @ weights
            return total

        return f

    unknown = missing(lambda at, held: np.array([known.f(*each) for each in zip(at, held, strict=True)]))
    basis = _polynomial(middle.shape[1], features.degree) if isinstance(features, Polynomial) else (
        _trained(middle, unknown, features)
    )  # fmt: skip
    if len(x) < 2 * basis.count:
        raise FlowError(f"samples: {len(x)} are too few for {basis.count} features: give {2 * basis.count} or more")
    phi = _values(basis, middle)
    weights = np.zeros((basis.count, len(rates)))
    for _ in range(_REFITS):
        weights += _ridge(phi, missing(rates_of(basis, weights)), ridge, weights)
    left = missing(rates_of(basis, weights))
    plant = _plant(known, basis, weights, chosen, np.array(rates, dtype=np.int64), centre, scale)
    return Fit(plant, np.sqrt((left**2).mean(axis=0)))


def _integrated(f: Callable[[Array, Array], Array], x: Array, u: Array, step: float) -> Array:
    """Return the states (K, n) after a step of RK4."""
    k1 = f(x, u)
    k2 = f(x + step / 2.0 * k1, u)
    k3 = f(x + step / 2.0 * k2, u)
    return np.asarray(x + step / 6.0 * (k1 + 2.0 * (k2 + k3) + f(x + step * k3, u)))


def _values(basis: _Features, xi: Array) -> Array:
    """Return the features (K, P) of scaled samples (K, d)."""
    phi = np.empty((basis.count, len(xi)))
    basis.values.py_func(basis.first, basis.second, np.ascontiguousarray(xi.T), phi)  # type: ignore[attr-defined]
    return phi.T


def _ridge(phi: Array, target: Array, ridge: float, weights: Array) -> Array:
    """Return what added to the weights (P, R) brings phi (K, P) to the target (K, R), at a price of large sums."""
    normal, price = phi.T @ phi, ridge * len(phi) * np.eye(phi.shape[1])
    return np.asarray(np.linalg.solve(normal + price, phi.T @ target - price @ weights))


def _polynomial(inputs: int, degree: int) -> _Features:
    products = [p for d in range(degree + 1) for p in combinations_with_replacement(range(inputs), d)]
    index_of = {product: k for k, product in enumerate(products)}
    parent = np.array([index_of[p[:-1]] if p else 0 for p in products])  # each is its parent times one input
    factor = np.array([p[-1] if p else 0 for p in products])
    return _Features(len(products), _products, _product_slopes, parent, factor)


@cached
def _products(parent: Indices, factor: Indices, xi: Array, phi: Array) -> None:
    phi[0] = 1.0
    for k in range(1, len(parent)):
        phi[k] = phi[parent[k]] * xi[factor[k]]


@cached
def _product_slopes(parent: Indices, factor: Indices, xi: Array, phi: Array, dphi: Array) -> None:
    for i in range(len(xi)):
        dphi[0, i] = 0.0
    for k in range(1, len(parent)):
        for i in range(len(xi)):
            dphi[k, i] = dphi[parent[k], i] * xi[factor[k]]
        dphi[k, factor[k]] += phi[parent[k]]


@cached
def _tanhs(sums: Array, offset: Array, xi: Array, phi: Array) -> None:
    """Write tanh(sums xi + offset) (H,), and 1."""
    for k in range(len(offset)):
        phi[k] = offset[k]
        for i in range(len(xi)):
            phi[k] += sums[k, i] * xi[i]
        phi[k] = np.tanh(phi[k])
    phi[len(offset)] = 1.0


@cached
def _tanh_slopes(sums: Array, offset: Array, xi: Array, phi: Array, dphi: Array) -> None:
    for i in range(len(xi)):
        dphi[len(offset), i] = 0.0
        for k in range(len(offset)):
            dphi[k, i] = (1.0 - phi[k] * phi[k]) * sums[k, i]


def _trained(xi: Array, target: Array, network: Network) -> _Features:
    """Return the hidden layer that explains the target (K, R) best: its weights and the linear ones, all at once."""
    hidden, inputs, outputs = network.hidden, xi.shape[1], target.shape[1]
    rng = np.random.default_rng(network.seed)
    first = rng.normal(size=(hidden, inputs + 1)) / math.sqrt(inputs)
    size = np.maximum(target.std(axis=0), 1e-12)
    wanted, at = target / size, np.pad(xi, ((0, 0), (0, 1)), constant_values=1.0)
    phi = np.pad(np.tanh(at @ first.T), ((0, 0), (0, 1)), constant_values=1.0)
    last = _ridge(phi, wanted, 1e-6, np.zeros((hidden + 1, outputs)))

    def off(first: Array, last: Array) -> tuple[Array, Array]:
        phi = np.tanh(at @ first.T)
        return wanted - phi @ last[:-1] - last[-1], phi

    damping, many = _DAMPING, first.size + last.size
    missing, phi = off(first, last)
    for _ in range(_STEPS):
        whole = np.pad(phi, ((0, 0), (0, 1)), constant_values=1.0)
        bend = 1.0 - phi**2
        normal, gradient = np.zeros((many, many)), np.zeros(many)
        for r in range(outputs):  # an output's Jacobian: by the first weights, then by its own last ones
            by_first = ((bend * last[:-1, r])[:, :, None] * at[:, None, :]).reshape(len(at), -1)
            jacobian = np.zeros((len(at), many))
            jacobian[:, : first.size] = by_first
            jacobian[:, first.size + r :: outputs] = whole
            normal, gradient = normal + jacobian.T @ jacobian, gradient + jacobian.T @ missing[:, r]
        step = np.linalg.solve(normal + damping * len(at) * np.eye(many), gradient)
        trial = first + step[: first.size].reshape(first.shape), last + step[first.size :].reshape(last.shape)
        after, after_phi = off(*trial)
        if (after**2).sum() < (missing**2).sum():
            (first, last), missing, phi, damping = trial, after, after_phi, damping / 3.0
        else:
            damping *= 4.0
    sums, offset = np.ascontiguousarray(first[:, :-1]), np.ascontiguousarray(first[:, -1])
    return _Features(hidden + 1, _tanhs, _tanh_slopes, sums, offset)


@cached
def _scaled(x: Array, u: Array, states: Indices, centre: Array, scale: Array) -> Array:
    xi = np.empty(len(centre))
    for i in range(len(centre)):
        value = x[states[i]] if i < len(states) else u[i - len(states)]
        xi[i] = (value - centre[i]) / scale[i]
    return xi


@cached
def _add_rates(weights: Array, phi: Array, rates: Indices, dx: Array) -> None:
    for i in range(len(rates)):
        for k in range(len(phi)):
            dx[rates[i]] += weights[k, i] * phi[k]


@cached
def _add_slopes(
    weights: Array, dphi: Array, scale: Array, rates: Indices, columns: Indices, first: int, j: Array
) -> None:
    """Add the learned rates' derivatives by the inputs of the features from ``first`` on to columns of a Jacobian."""
    for i in range(len(rates)):
        for c in range(len(columns)):
            total = 0.0
            for k in range(len(dphi)):
                total += weights[k, i] * dphi[k, first + c]
            j[rates[i], columns[c]] += total / scale[first + c]


def _plant(
    known: Plant, basis: _Features, weights: Array, states: Indices, rates: Indices, centre: Array, scale: Array
) -> Plant:
    known_f, count, values, slopes = compiled(known.f), basis.count, basis.values, basis.slopes
    first, second = basis.first, basis.second

    def f(x: Array, u: Array) -> Array:
        dx: Array = known_f(x, u).copy()
        phi = np.empty(count)
        values(first, second, _scaled(x, u, states, centre, scale), phi)
        _add_rates(weights, phi, rates, dx)
        return dx

    def jacobian(known_jacobian: Any, columns: Indices, begin: int) -> Callable[[Array, Array], Array]:
        """Return the Jacobian whose columns are those of the features' inputs from ``begin`` on."""

        def slope(x: Array, u: Array) -> Array:
            j: Array = known_jacobian(x, u).copy()
            phi, dphi = np.empty(count), np.empty((count, len(centre)))
            xi = _scaled(x, u, states, centre, scale)
            values(first, second, xi, phi)
            slopes(first, second, xi, phi, dphi)
            _add_slopes(weights, dphi, scale, rates, columns, begin, j)
            return j

        return slope

    learned = replace(known, f=f, f_x=None, f_u=None, fused=None, fastest_rate=None)
    if known.f_x is None or known.f_u is None:
        return learned
    return replace(
        learned,
        f_x=jacobian(compiled(known.f_x), states, 0),
        f_u=jacobian(compiled(known.f_u), np.arange(known.m), len(states)),
    )
