"""A reference in time r(t): cubics between instants, from a closed path, from samples, or through way points.

Positions are in metres in the world frame, times in seconds. A closed trajectory repeats itself. An open one stays at
its first point before it begins, and at its last point after its end.
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from robofleet.control.path import HERMITE, Path
from robofleet.core.arrays import Array, Flags

_STANDING_M_S = 1e-3  # a slower reference has no direction
_SPLINE_SAMPLES = 64  # between two way points
_SHARPEST_CURVATURE = 1e6  # of a way that turns back [1/m]
_CLOSED_ROUNDS = 2  # until the speeds of a closed way agree with themselves


@dataclass(frozen=True)
class Trajectory:
    """``coefficients[k, j]`` multiplies (t - breaks[k])**j between two of the ``breaks``, shape (K, 4, 2).

    ``breaks`` (K + 1,) [s]. ``begin``: where on its lap a closed trajectory is at t = 0 [s].
    """

    breaks: Array
    coefficients: Array
    closed: bool
    begin: float = 0.0

    @classmethod
    def hermite(cls, times: Array, points: Array, velocities: Array, *, closed: bool) -> Self:
        """Return the cubics through ``points`` (K + 1, 2) [m] at ``times`` (K + 1,) with ``velocities`` [m/s]."""
        took = np.diff(times)[:, None, None]
        ends = np.stack([points[:-1], points[1:], velocities[:-1] * took[:, 0], velocities[1:] * took[:, 0]], axis=1)
        return cls(times, (HERMITE @ ends) / took ** np.arange(4)[:, None], closed)

    @classmethod
    def path(cls, path: Path, rate: float, begin: float) -> Self:
        """Return a closed path that is driven at ``rate`` [sides/s], from its parameter ``begin`` on."""
        breaks = np.arange(path.sides + 1) / rate
        return cls(breaks, path.coefficients * rate ** np.arange(4.0)[:, None], True, begin / rate)

    @classmethod
    def samples(cls, times: Array, points: Array, *, smooth: bool) -> Self:
        """Return what leads through ``points`` (K, 2) at ``times`` (K,): straight, or smooth, at rest at both ends.

        The velocity at a sample of a smooth one is that of the parabola through it and its neighbours.
        """
        took = np.diff(times)
        slopes = np.diff(points, axis=0) / took[:, None]
        if not smooth:
            nothing = np.zeros_like(slopes)
            return cls(times, np.stack([points[:-1], slopes, nothing, nothing], axis=1), False)
        share = (took[:-1] / (took[:-1] + took[1:]))[:, None]
        velocities = np.zeros_like(points)
        velocities[1:-1] = (1 - share) * slopes[:-1] + share * slopes[1:]
        return cls.hermite(times, points, velocities, closed=False)

    @classmethod
    def waypoints(
        cls, points: Array, *, closed: bool, speed: float, acceleration: float, most: Callable[[Array], Array]
    ) -> Self:
        """Return the spline through way points (K, 2), driven as fast as allowed.

        That is at most ``speed`` [m/s], in bends at most what ``most`` returns for their curvatures (M,) [1/m], with at
        most ``acceleration`` [m/s^2] along the way. An open way begins and ends at rest.
        """
        bend = spline(points, closed=closed)
        steps = np.hypot(*np.diff(bend.points, axis=0).T)
        fastest = np.minimum(speed, most(bend.curvature))
        if not closed:
            fastest[[0, -1]] = 0.0
        speeds = _accelerated(fastest, steps, acceleration, closed=closed)
        times = np.concatenate([[0.0], np.cumsum(2.0 * steps / (speeds[:-1] + speeds[1:]))])
        return cls.hermite(times, bend.points, speeds[:, None] * bend.tangents, closed=closed)

    @property
    def end(self) -> float:
        """When it ends, or how long a lap of a closed one takes [s]."""
        return float(self.breaks[-1])

    def position(self, t: Array) -> Array:
        """Return r(t), shape (..., 2) [m]."""
        s, c, _ = self._pieces(t)
        return np.asarray(c[..., 0, :] + s * (c[..., 1, :] + s * (c[..., 2, :] + s * c[..., 3, :])))

    def at(self, t: float) -> tuple[float, float]:
        """Return r(t) of one instant [m], as ``position`` does, at a tenth of its cost."""
        t = (t + self.begin) % self.end if self.closed else t + self.begin
        t = min(max(t, float(self.breaks[0])), self.end)
        piece = min(max(bisect_right(self.breaks, t) - 1, 0), len(self.coefficients) - 1)
        s, (a, b, c, d) = t - float(self.breaks[piece]), self.coefficients[piece].tolist()
        return a[0] + s * (b[0] + s * (c[0] + s * d[0])), a[1] + s * (b[1] + s * (c[1] + s * d[1]))

    def velocity(self, t: Array) -> Array:
        """Return r'(t), shape (..., 2) [m/s]; at rest before an open one begins and after its end."""
        s, c, inside = self._pieces(t)
        return np.where(inside, c[..., 1, :] + s * (2.0 * c[..., 2, :] + s * 3.0 * c[..., 3, :]), 0.0)

    def instants(self, step: float, most: int = 20_000) -> Array:
        """Return instants (M,) at about equal steps [s] in the middle of which it is looked at; at most so many."""
        begin, took = self.breaks[0], self.breaks[-1] - self.breaks[0]
        count = max(2, min(most, math.ceil(took / step)))
        return np.asarray(begin + took * (np.arange(count) + 0.5) / count - self.begin)

    def heading(self) -> float:
        """Return the direction in which it begins to move [rad]."""
        velocity = self.velocity(np.concatenate([[0.0], self.instants(0.02)]))
        moving = np.hypot(velocity[:, 0], velocity[:, 1]) > _STANDING_M_S
        x, y = velocity[int(moving.argmax())]
        return math.atan2(y, x)

    def _pieces(self, t: Array) -> tuple[Array, Array, Flags]:
        """Return the time into each piece (..., 1), its coefficients (..., 4, 2), and what is inside (..., 1)."""
        t = np.asarray(t, dtype=np.float64) + self.begin
        if self.closed:
            t = t % self.end
        first, last = self.breaks[0], self.breaks[-1]
        inside = (t >= first) & (t <= last)
        t = np.clip(t, first, last)
        piece = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.coefficients) - 1)
        return (t - self.breaks[piece])[..., None], self.coefficients[piece], inside[..., None]


class Spline(NamedTuple):
    """Points (M, 2) [m] along a smooth way, its unit tangents (M, 2) and curvatures (M,) [1/m; 0 or more]."""

    points: Array
    tangents: Array
    curvature: Array


def spline(points: Array, *, closed: bool) -> Spline:
    """Return the cubic spline through way points (K, 2): tangent and curvature have no jump (de Boor, 1978).

    Its parameter is the length of the chords. A closed one leads back to its first point; an open one is straight at
    its ends.
    """
    knots = np.vstack([points, points[:1]]) if closed else points
    chords = np.hypot(*np.diff(knots, axis=0).T)
    derivatives = _derivatives(knots, chords, closed=closed)
    path = Trajectory.hermite(np.concatenate([[0.0], np.cumsum(chords)]), knots, derivatives, closed=False)
    inner = path.breaks[:-1, None] + chords[:, None] * np.arange(_SPLINE_SAMPLES) / _SPLINE_SAMPLES
    at = np.append(inner.ravel(), path.end)
    s, c, _ = path._pieces(at)
    first, second = path.velocity(at), 2.0 * c[:, 2] + 6.0 * s * c[:, 3]
    speed = np.maximum(np.hypot(first[:, 0], first[:, 1]), np.finfo(np.float64).tiny ** 0.25)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    steps = np.hypot(*np.diff(points := path.position(at), axis=0).T)
    turned = np.abs((np.diff(np.arctan2(first[:, 1], first[:, 0])) + math.pi) % math.tau - math.pi)
    sharp = np.append(turned / np.maximum(steps, np.finfo(np.float64).tiny), 0.0)  # where it stands and turns back
    return Spline(points, first / speed[:, None], np.minimum(np.maximum(np.abs(curvature), sharp), _SHARPEST_CURVATURE))


def _derivatives(knots: Array, chords: Array, *, closed: bool) -> Array:
    """Return the derivatives at the knots (K + 1, 2) by which the second derivative has no jump."""
    count = len(knots)
    matrix, right = np.zeros((count, count)), np.zeros((count, 2))
    slopes = np.diff(knots, axis=0) / chords[:, None]
    for k in range(count):
        if not closed and k in (0, count - 1):
            matrix[k, k], matrix[k, abs(k - 1)], right[k] = 2.0, 1.0, 3.0 * slopes[min(k, count - 2)]
            continue
        before, after = (k - 1) % (count - 1), k % (count - 1)  # sides; of a closed one the last knot is the first
        b, a = chords[before], chords[after]
        matrix[k, (k - 1) if k else count - 2] += 1.0 / b
        matrix[k, k] += 2.0 / b + 2.0 / a
        matrix[k, (k + 1) if k < count - 1 else 1] += 1.0 / a
        right[k] = 3.0 * (slopes[before] / b + slopes[after] / a)
    return np.asarray(np.linalg.solve(matrix, right))


def _accelerated(fastest: Array, steps: Array, acceleration: float, *, closed: bool) -> Array:
    """Return the highest speeds (M,) [m/s] that are reached, and left, with no more than an acceleration [m/s^2]."""
    squared, gains = (fastest**2).tolist(), (2.0 * acceleration * steps).tolist()
    for _ in range(_CLOSED_ROUNDS if closed else 1):
        for k, gain in enumerate(gains):
            squared[k + 1] = min(squared[k + 1], squared[k] + gain)
        for k in range(len(gains) - 1, -1, -1):
            squared[k] = min(squared[k], squared[k + 1] + gains[k])
        if closed:
            squared[0] = squared[-1] = min(squared[0], squared[-1])
    return np.asarray(np.sqrt(squared))


def demanded(trajectory: Trajectory, ahead: float, step: float) -> tuple[Array, Array, Array, Array]:
    """Return what a robot does that follows a trajectory without error, every ``step`` [s] or more.

    The followed point is ``ahead`` [m] in front of the axle; 0: it is the centre. Returns instants (M,) [s], the
    body's v (M,) [m/s] and omega (M,) [rad/s], and the centre (M, 2) [m].

    A point that moves with r' turns the heading by psi' = (-sin psi r_x' + cos psi r_y') / ahead. That is solved
    exactly with r' held over a step, which is stable for every ``ahead``; the first of two laps forgets the start.
    """
    t = trajectory.instants(step)
    took, velocity, at = (t[-1] - t[0]) / (len(t) - 1), trajectory.velocity(t), trajectory.position(t)
    speed, direction = np.hypot(velocity[:, 0], velocity[:, 1]), np.arctan2(velocity[:, 1], velocity[:, 0])
    if ahead == 0.0:
        turned = np.diff(direction, append=direction[:1] if trajectory.closed else direction[-1:])
        moving = (speed > _STANDING_M_S) & (np.roll(speed, -1) > _STANDING_M_S)
        return t, speed, np.where(moving, (turned + math.pi) % math.tau - math.pi, 0.0) / took, at
    psi = trajectory.heading()
    lags: list[tuple[float, float]] = []  # from r' to the heading, before and after each step [rad]
    decays, towards = np.exp(-speed * took / ahead).tolist(), direction.tolist()
    for _ in range(2 if trajectory.closed else 1):
        lags = []
        for way, decay in zip(towards, decays, strict=True):
            before = math.remainder(psi - way, math.tau)
            after = 2.0 * math.atan(math.tan(before / 2.0) * decay)
            psi += after - before
            lags.append((before, after))
    lag = np.array(lags)
    heading = direction + lag.mean(axis=1)
    centre = at - ahead * np.column_stack([np.cos(heading), np.sin(heading)])
    return t, speed * np.cos(lag.mean(axis=1)), (lag[:, 1] - lag[:, 0]) / took, centre
