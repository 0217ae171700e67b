"""References by arc length: the closed track of Table 1 (ours) and the lane change of eq. 26.

A reference is sampled at equal arc lengths; between samples the position is a Hermite cubic and the tangent's
heading is linear. World frame: x = z1, y = z2 [m]; headings counter-clockwise + [rad], continuous along the curve.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

_SAMPLE_SPACING_M = 0.05  # the cubics are then exact to 1e-8 m
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_NEAREST_STEPS = 20  # each shrinks the distance along the curve by |curvature * lateral error|, about 1e-2


@dataclass(frozen=True)
class Reference:
    """A curve r(s), s in [0, length] [m]: ``positions`` (N, 2) [m], ``headings`` (N,) [rad], every ``spacing`` [m]."""

    positions: Array
    headings: Array
    spacing: float
    closed: bool

    @property
    def length(self) -> float:
        """Length of the curve, of one lap if it is closed [m]."""
        return self.spacing * (len(self.headings) - 1)

    def position(self, s: Array) -> Array:
        """Return r(s), shape (K, 2) [m]; s (K,) wraps on a closed curve.

        Raises:
            ValueError: an open curve is too short for the largest s.
        """
        s = np.asarray(s, dtype=np.float64)
        if not self.closed and (s.min() < 0.0 or s.max() > self.length):
            raise ValueError(f"reference: {self.length:.1f} m long, but asked for {s.min():.1f} to {s.max():.1f} m")
        return _positions(self.positions, self.headings, self.spacing, self.closed, s)

    def errors(self, z: Array, psi: Array, start: float = 0.0) -> tuple[Array, Array, Array]:
        """Return, for centres z (K, 2) [m] and headings psi (K,) [rad] along a drive that begins near s = ``start``:

        the distance from the curve, + to its left [m]; the heading minus the tangent's at the nearest point, in
        (-pi, pi] [rad]; that point's s [m], which goes on growing from lap to lap.
        """
        return _errors(self.positions, self.headings, self.spacing, self.closed, np.ascontiguousarray(z), psi, start)

    @classmethod
    def rounded_rectangle(cls, straights: tuple[float, float], radius: float, ramp: float) -> Self:
        """Return a counterclockwise track that starts in the middle of its first, lower straight, at (0, 0).

        ``straights`` (along x, along y), corner ``radius``, and the length ``ramp`` over which the curvature grows
        linearly to 1/radius and falls again [m]. Four equal corners of 90 degrees: it closes exactly.
        """
        top, (along_x, along_y) = 1.0 / radius, straights
        corner = [(ramp, 0.0, top), (radius * np.pi / 2.0 - ramp, top, top), (ramp, top, 0.0)]
        half = [(along_x / 2.0, 0.0, 0.0), *corner, (along_y, 0.0, 0.0), *corner, (along_x / 2.0, 0.0, 0.0)]
        lengths, begins, ends = np.array(half + half).T
        return cls._from_curvature(lengths, begins, ends)

    @classmethod
    def _from_curvature(cls, lengths: Array, begins: Array, ends: Array) -> Self:
        """Return the closed curve whose curvature is linear on each piece, from ``begins`` to ``ends`` [1/m]."""
        breaks = np.concatenate([[0.0], np.cumsum(lengths)])
        turned = np.concatenate([[0.0], np.cumsum(lengths * (begins + ends) / 2.0)])

        def heading(s: Array) -> Array:
            i = np.clip(np.searchsorted(breaks, s, side="right") - 1, 0, len(lengths) - 1)
            along = s - breaks[i]
            return np.asarray(turned[i] + along * (begins[i] + along * (ends - begins)[i] / lengths[i] / 2.0))

        count = round(breaks[-1] / _SAMPLE_SPACING_M)
        samples = np.linspace(0.0, breaks[-1], count + 1)
        fine = np.union1d(samples, breaks)  # no step of the quadrature crosses a kink of the curvature
        x = _integral(lambda s: np.cos(heading(s)), fine)
        y = _integral(lambda s: np.sin(heading(s)), fine)
        chosen = np.searchsorted(fine, samples)
        return cls(np.stack([x, y], axis=1)[chosen], heading(samples), float(samples[1]), closed=True)

    @classmethod
    def graph(cls, f: Callable[[Array], Array], slope: Callable[[Array], Array], length: float) -> Self:
        """Return y = f(x) from x = 0 on, by arc length; ``slope`` is f'. ``length`` [m]."""
        s = np.linspace(0.0, length, round(length / _SAMPLE_SPACING_M) + 1)

        def speed(x: Array) -> Array:
            return np.asarray(np.sqrt(1.0 + slope(x) ** 2))

        nodes = np.linspace(0.0, length, len(s))  # x never gets further than s
        reached = _integral(speed, nodes)
        i = np.searchsorted(reached, s, side="right") - 1
        x = nodes[i] + (s - reached[i]) / speed(nodes[i])
        for _ in range(3):  # Newton's method on s(x) = s
            middle, half = (x + nodes[i]) / 2.0, (x - nodes[i]) / 2.0
            length_to_x = reached[i] + half * (speed(middle[:, None] + half[:, None] * _NODES) @ _WEIGHTS)
            x = x - (length_to_x - s) / speed(x)
        return cls(np.stack([x, f(x)], axis=1), np.arctan(slope(x)), float(s[1]), closed=False)


def lane_change(sign: float, length: float) -> Reference:
    """Return eq. 26; ``sign`` is +1.0 as printed, -1.0 with a minus before its second term. ``length`` [m]."""
    first, second = 2.4 / 25.0, 2.4 / 21.95

    def tanhs(x: Array) -> tuple[Array, Array]:
        return np.tanh(first * (x - 27.19) - 1.2), np.tanh(second * (x - 56.46) - 1.2)

    def height(x: Array) -> Array:
        tanh_first, two = tanhs(x)
        return np.asarray(2.025 * (1.0 + tanh_first) + sign * 2.85 * (1.0 + two))

    def slope(x: Array) -> Array:
        tanh_first, two = tanhs(x)
        return np.asarray(2.025 * first * (1.0 - tanh_first**2) + sign * 2.85 * second * (1.0 - two**2))

    return Reference.graph(height, slope, length)


def _integral(f: Callable[[Array], Array], nodes: Array) -> Array:
    """Return the integral of f from the first node to each, by Gauss's rule between neighbours."""
    half = np.diff(nodes) / 2.0
    at = (nodes[:-1] + half)[:, None] + half[:, None] * _NODES
    return np.concatenate([[0.0], np.cumsum(half * (f(at) @ _WEIGHTS))])


@kernel
def _sample(positions: Array, headings: Array, spacing: float, closed: bool, s: float) -> tuple[float, float, float]:
    """Return r(s) [m] and its tangent's heading [rad]; s [m] wraps on a closed curve."""
    samples = len(headings) - 1
    u = s / spacing
    if closed:
        u %= samples
    i = min(max(int(u), 0), samples - 1)
    t = u - i
    a, b = headings[i], headings[i + 1]
    h1 = t * t * (3.0 - 2.0 * t)
    d0, d1 = t * (1.0 - t) ** 2 * spacing, -t * t * (1.0 - t) * spacing
    x = positions[i, 0] * (1.0 - h1) + positions[i + 1, 0] * h1 + d0 * np.cos(a) + d1 * np.cos(b)
    y = positions[i, 1] * (1.0 - h1) + positions[i + 1, 1] * h1 + d0 * np.sin(a) + d1 * np.sin(b)
    return x, y, a + t * (b - a)


@kernel
def _positions(positions: Array, headings: Array, spacing: float, closed: bool, s: Array) -> Array:
    r = np.empty((len(s), 2))
    for k in range(len(s)):
        r[k, 0], r[k, 1], _ = _sample(positions, headings, spacing, closed, s[k])
    return r


@kernel
def _errors(
    positions: Array, headings: Array, spacing: float, closed: bool, z: Array, psi: Array, start: float
) -> tuple[Array, Array, Array]:
    lateral, heading, nearest = np.empty(len(z)), np.empty(len(z)), np.empty(len(z))
    s = start
    for k in range(len(z)):
        for _ in range(_NEAREST_STEPS):
            x, y, tangent = _sample(positions, headings, spacing, closed, s)
            ahead = (z[k, 0] - x) * np.cos(tangent) + (z[k, 1] - y) * np.sin(tangent)
            s += ahead
            if abs(ahead) < 1e-9:
                break
        x, y, tangent = _sample(positions, headings, spacing, closed, s)
        lateral[k] = (z[k, 1] - y) * np.cos(tangent) - (z[k, 0] - x) * np.sin(tangent)
        turned = psi[k] - tangent
        heading[k] = turned - 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
        nearest[k] = s
    return lateral, heading, nearest
