"""A closed path of planar cubics, one for each side, with the two searches of Algorithm 1.

A point of the path is r(sigma) with sigma in [0, S), S the number of sides, one unit a side; sigma wraps. Positions
are in metres in the world frame. Both questions reduce to the real roots of one polynomial: the squared distance of
r from a point q has degree 6 on a side, and between two roots of its derivative (a quintic) it is monotone.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

HERMITE = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]], dtype=np.float64)
_CLEARLY_NEARER = 0.999  # of a squared distance: beyond any rounding
_LAST_STEP = 1e-9  # of Newton: what is left is its square
_ROUNDING = 1e-13  # of the largest coefficient
_CHOOSE_OF_5 = (1.0, 5.0, 10.0, 10.0, 5.0, 1.0)
_NEWTON_STEPS = 60  # bisection alone would need 53


@dataclass(frozen=True)
class Path:
    """A closed path; ``coefficients[k, j]`` multiplies s**j on side k, shape (S, 4, 2) [m]."""

    coefficients: Array

    @classmethod
    def hermite(cls, knots: Array, derivatives: Array) -> Self:
        """Return the cubics through ``knots`` (S, 2) [m] with ``derivatives`` (S, 2) [m a side]."""
        ends = np.stack([knots, np.roll(knots, -1, 0), derivatives, np.roll(derivatives, -1, 0)], axis=1)
        return cls(np.ascontiguousarray(HERMITE @ ends))

    @property
    def sides(self) -> int:
        return len(self.coefficients)

    def position(self, sigma: Array | float) -> Array:
        """Return r(sigma), shape (..., 2) [m]."""
        return self._power_sum(sigma, np.array([1.0, 1.0, 1.0, 1.0]), 0)

    def derivative(self, sigma: Array | float) -> Array:
        """Return r'(sigma), shape (..., 2) [m a side]."""
        return self._power_sum(sigma, np.array([0.0, 1.0, 2.0, 3.0]), 1)

    def second_derivative(self, sigma: Array | float) -> Array:
        """Return r''(sigma), shape (..., 2) [m a side squared]."""
        return self._power_sum(sigma, np.array([0.0, 0.0, 2.0, 6.0]), 2)

    def tangent(self, sigma: Array | float) -> Array:
        """Return the unit tangent r' / |r'|, shape (..., 2)."""
        derivative = self.derivative(sigma)
        return np.asarray(derivative / np.linalg.norm(derivative, axis=-1, keepdims=True))

    def length(self) -> float:
        """Return the length of a lap [m]."""
        nodes, weights = np.polynomial.legendre.leggauss(16)
        local = (nodes + 1) / 2
        sigma = np.arange(self.sides)[:, None] + local
        return float((np.linalg.norm(self.derivative(sigma), axis=-1) * weights / 2).sum())

    def nearest(self, points: Array, near: Array | None = None) -> Array:
        """Return the parameters of the points of the path nearest to ``points`` (N, 2), shape (N,).

        ``near`` (N,) searches half a side to both sides of these parameters; without it the whole path is searched.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        warm = np.full(len(points), np.nan) if near is None else np.asarray(near, dtype=np.float64)
        return np.asarray(_nearest_of(self.coefficients, points, warm))

    def back(self, sigma: Array, distance: float) -> Array:
        """Return the first parameters met going back from ``sigma`` (N,) whose points are ``distance`` [m] away.

        NaN where no point of the path is so far away.
        """
        return np.asarray(_back_of(self.coefficients, np.ascontiguousarray(sigma, dtype=np.float64), distance))

    def _power_sum(self, sigma: Array | float, factors: Array, order: int) -> Array:
        sigma = np.asarray(sigma, dtype=np.float64)
        side = np.floor(np.where(np.isfinite(sigma), sigma, 0.0)).astype(np.int64)  # NaN gives NaN
        local = (sigma - side)[..., None]
        c = self.coefficients[side % self.sides] * factors[:, None]
        result = np.zeros((*sigma.shape, 2))
        for j in range(3, order - 1, -1):
            result = result * local + c[..., j, :]
        return result


@kernel
def point(coefficients: Array, sigma: float) -> tuple[float, float]:
    """Return r(sigma) [m]."""
    side = int(np.floor(sigma))
    s = sigma - side
    c = coefficients[side % len(coefficients)]
    return (
        c[0, 0] + s * (c[1, 0] + s * (c[2, 0] + s * c[3, 0])),
        c[0, 1] + s * (c[1, 1] + s * (c[2, 1] + s * c[3, 1])),
    )


@kernel
def unit_tangent(coefficients: Array, sigma: float) -> tuple[float, float]:
    """Return r'(sigma) / |r'(sigma)|."""
    dx, dy = _derivative(coefficients, sigma)
    norm = np.hypot(dx, dy)
    return dx / norm, dy / norm


@kernel
def _derivative(coefficients: Array, sigma: float) -> tuple[float, float]:
    """Return r'(sigma) [m a side]."""
    side = int(np.floor(sigma))
    s = sigma - side
    c = coefficients[side % len(coefficients)]
    return c[1, 0] + s * (2 * c[2, 0] + s * 3 * c[3, 0]), c[1, 1] + s * (2 * c[2, 1] + s * 3 * c[3, 1])


@kernel
def nearest(coefficients: Array, x: float, y: float, near: float) -> float:
    """Return the parameter of the nearest point of the path, in [0, S).

    Searched within half a side of ``near`` (a path that crosses itself is not mistaken for its other branch), or on
    the whole path if ``near`` is NaN. Exact: every root of every side's quintic in the range is looked at, but for
    sides that are further away as a whole than what was found.
    """
    sides = len(coefficients)
    low, high = (0.0, float(sides)) if np.isnan(near) else (near - 0.5, near + 0.5)
    best, best_value = low, np.inf
    arrays = np.empty((10, 8))  # one: to allocate costs more than to find a root
    squared, slope, roots, room = arrays[0, :7], arrays[1, :6], arrays[2], arrays[3:, :7]
    first, searched = int(np.floor(low)), int(np.ceil(high)) - int(np.floor(low))
    own = 0 if np.isnan(near) else int(np.floor(near)) - first  # looked at first: then others may be too far away
    for turn in range(own, own + searched):
        side = first + turn % searched
        if _CLEARLY_NEARER * _box_distance(coefficients[side % sides], x, y) > best_value:
            continue
        start, end = max(low - side, 0.0), min(high - side, 1.0)
        _squared_distance(coefficients[side % sides], x, y, squared, slope)
        count = _real_roots(slope, start, end, near - side, roots, room)
        roots[count], roots[count + 1] = start, end
        for k in range(count + 2):
            s = roots[k]
            value = _horner(squared, s)
            if value < best_value:
                best, best_value = side + s, value
    return best % sides


@kernel
def back(coefficients: Array, sigma: float, distance: float) -> float:
    """Return the first parameter met going back from ``sigma`` whose point is ``distance`` from r(sigma), or NaN."""
    sides = len(coefficients)
    x, y = point(coefficients, sigma)
    last = int(np.floor(sigma))
    dx, dy = _derivative(coefficients, sigma)
    speed = np.hypot(dx, dy)
    expected = sigma - distance / speed if speed > 0.0 else np.nan
    arrays = np.empty((10, 8))
    excess, slope, roots, room = arrays[0, :7], arrays[1, :6], arrays[2], arrays[3:, :7]
    for side in range(last, last - sides - 1, -1):
        start = 0.0 if side > last - sides else sigma - last
        end = sigma - last if side == last else 1.0
        _squared_distance(coefficients[side % sides], x, y, excess, slope)
        excess[0] -= distance * distance
        count = _real_roots(slope, start, end, np.nan, roots, room)
        roots[count] = start
        upper = end
        for k in range(count - 1, -2, -1):
            lower = roots[k] if k >= 0 else start
            if _horner(excess, lower) >= 0.0:
                return (side + _solve(excess, lower, upper, expected - side)) % sides
            upper = lower
    return np.nan


@kernel
def _nearest_of(coefficients: Array, points: Array, near: Array) -> Array:
    found = np.empty(len(points))
    for k in range(len(points)):
        found[k] = nearest(coefficients, points[k, 0], points[k, 1], near[k])
    return found


@kernel
def _back_of(coefficients: Array, sigma: Array, distance: float) -> Array:
    found = np.empty(len(sigma))
    for k in range(len(sigma)):
        found[k] = back(coefficients, sigma[k], distance)
    return found


@kernel
def _box_distance(c: Array, x: float, y: float) -> float:
    """Return the squared distance of (x, y) from the box around the side's Bezier points, which holds the side."""
    squared = 0.0
    for axis in range(2):
        q = x if axis == 0 else y
        first, last = c[0, axis], c[0, axis] + c[1, axis] + c[2, axis] + c[3, axis]
        second, third = first + c[1, axis] / 3.0, first + (2.0 * c[1, axis] + c[2, axis]) / 3.0
        low, high = min(first, second, third, last), max(first, second, third, last)
        squared += max(low - q, q - high, 0.0) ** 2
    return squared


@kernel
def _squared_distance(c: Array, x: float, y: float, squared: Array, slope: Array) -> None:
    """Write the coefficients of |r(s) - (x, y)|^2 on one side (7,), and of its derivative (6,)."""
    for k in range(7):
        squared[k] = 0.0
    for axis in range(2):
        q = x if axis == 0 else y
        for i in range(4):
            a = c[i, axis] - (q if i == 0 else 0.0)
            for j in range(4):
                squared[i + j] += a * (c[j, axis] - (q if j == 0 else 0.0))
    for j in range(1, 7):
        slope[j - 1] = j * squared[j]


@kernel
def _horner(a: Array, s: float) -> float:
    value = 0.0
    for j in range(len(a) - 1, -1, -1):
        value = value * s + a[j]
    return value


@kernel
def _real_roots(a: Array, low: float, high: float, near: float, roots: Array, room: Array) -> int:
    """Write the roots of a quintic where it changes sign in (low, high), ascending; return how many.

    Descartes' rule, on the Bernstein coefficients, tells most cases: no root, or one. Else the derivatives tell: a
    polynomial is monotone between the roots of its derivative, so from the linear one upwards each level's roots
    bracket the next one's. ``near``: where the root is expected; ``room`` (7, 7) is overwritten.
    """
    degree, ladder = 5, room
    changes = _sign_changes(a, low, high, ladder[0])
    if changes == 0:
        return 0
    if changes == 1 and (_horner(a, low) < 0.0) != (_horner(a, high) < 0.0):
        roots[0] = _solve(a, low, high, near)
        return 1
    for j in range(degree + 1):
        ladder[0, j] = a[j]
    for k in range(1, degree):
        for j in range(1, degree + 2 - k):
            ladder[k, j - 1] = j * ladder[k - 1, j]
    breaks, count = ladder[degree + 1], 0
    for k in range(degree - 1, -1, -1):
        polynomial = ladder[k, : degree + 1 - k]
        for j in range(count):
            breaks[j] = roots[j]
        breaks[count] = high
        previous, found = low, 0
        value = _horner(polynomial, low)
        for j in range(count + 1):
            next_value = _horner(polynomial, breaks[j])
            if (value < 0.0) != (next_value < 0.0):
                roots[found] = _solve(polynomial, previous, breaks[j], np.nan)
                found += 1
            previous, value = breaks[j], next_value
        count = found
    return count


@kernel
def _sign_changes(a: Array, low: float, high: float, b: Array) -> int:
    """Return how often the Bernstein coefficients ``b`` (6,) of a quintic on [low, high] change their sign.

    It has so many roots there, or an even number less. What is nothing but rounding has no sign.
    """
    for k in range(6):
        b[k] = a[k]
    for k in range(5):  # around the low end
        for j in range(4, k - 1, -1):
            b[j] += low * b[j + 1]
    power, largest = 1.0, 0.0
    for k in range(1, 6):
        power *= high - low
        b[k] *= power / _CHOOSE_OF_5[k]
    for k in range(1, 6):  # sums with binomial weights, as a triangle of sums
        for j in range(5, k - 1, -1):
            b[j] += b[j - 1]
    for k in range(6):
        largest = max(largest, abs(b[k]))
    changes, before = 0, 0.0
    for k in range(6):
        if not abs(b[k]) <= _ROUNDING * largest:
            changes += b[k] * before < 0.0
            before = b[k]
    return changes if largest < np.inf else 6  # not finite: the derivatives tell


@kernel
def _solve(a: Array, low: float, high: float, near: float) -> float:
    """Return the root of a polynomial that changes sign once between low and high: Newton, kept in the bracket.

    It begins at ``near``, or in the middle where that is not in the bracket.
    """
    rising = _horner(a, low) < 0.0  # as the callers tell a change of sign
    s = near if low < near < high else 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        value, slope = 0.0, 0.0
        for j in range(len(a) - 1, -1, -1):
            slope = slope * s + value
            value = value * s + a[j]
        if value == 0.0:
            return s
        if (value > 0.0) == rising:
            high = s
        else:
            low = s
        step = s - value / slope if slope != 0.0 else low
        newton = low < step < high
        following = step if newton else 0.5 * (low + high)
        size = abs(following - s)
        if size <= 1e-15 or (newton and size < _LAST_STEP):
            return following
        s = following
    return s


KERNELS = (point, nearest)  # that are called from Python
