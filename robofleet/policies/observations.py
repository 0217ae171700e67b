"""What tasks observe: goals, neighbours, distances, in each robot's own frame. Arrays (A, N, ...) over arenas.

A robot's frame: x along its heading, y to its left, origin at its centre.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from robofleet.behaviours.interface import Team
from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel
from robofleet.safety.distances import apart, from_edge
from robofleet.vehicles.solids import FIRST, LAST, RADIUS, Solid, distances, outlines

if TYPE_CHECKING:
    from robofleet.policies.interface import TaskView

NEIGHBOUR = 5  # numbers of a neighbour
NEAR_M = 0.1  # of other bodies, obstacles and edges: nearer is too near
_TRIES = 200  # draws of a pose with free way; then the arena is too small
_MARGIN_M = 0.05  # of drawn poses, beyond what the barrier keeps of robots under way


def in_frames(poses: Array, points: Array) -> Array:
    """Return points (A, N, 2) [m; world] in the frames of robots at ``poses`` (A, N, 3) [m]."""
    found = np.empty((*poses.shape[:2], 2))
    _in_frames(poses, np.broadcast_to(points, found.shape), found)
    return found


def away(poses: Array, points: Array) -> Array:
    """Return how far robots at ``poses`` (A, N, 3) are from points (A, N, 2) or from one for all (A, 1, 2) [m]."""
    x, y = points[..., 0] - poses[..., 0], points[..., 1] - poses[..., 1]
    return np.asarray(np.sqrt(x * x + y * y))


def nearness(gaps: Array) -> Array:
    """Return 0 where a body has more than ``NEAR_M`` around it, and up to 1 where it touches something."""
    return np.clip(1.0 - gaps / NEAR_M, 0.0, 1.0)


def neighbours(view: "TaskView", count: int, reach: float) -> Array:
    """Return the nearest bodies within reach, the nearest first.

    Args:
        view: The robots, which are each other's neighbours, and the other bodies.
        count: How many are observed, n.
        reach: Of centre from centre [m].

    Returns:
        x, y [m; robot's frame], velocity along both [m/s] (0 of bodies that are not the group's), and 1.0 of each
        (A, N, 5 n); zeros where there is none.
    """
    found = np.zeros((*view.poses.shape[:2], NEIGHBOUR * count))
    _neighbours(view.poses, view.velocities, view.others, count, reach, found)
    return found


def rays(poses: Array, others: Array, team: Team, bearings: Array, reach: float) -> Array:
    """Return what distance sensors would show at the robots' centres, without noise.

    Args:
        poses: Poses (A, N, 3) of the robots, which see each other's bodies.
        others: Other bodies (A, M, 3): x, y [m; world], radius [m].
        team: Its bodies, arena and obstacles.
        bearings: Directions (R,) [rad; robot's frame].
        reach: What is farther away is not seen [m].

    Returns:
        Distance along each ray (A, N, R) [m], at most ``reach``.
    """
    found = np.empty((*poses.shape[:2], len(bearings)))
    radii = np.array([body.radius for body in team.bodies])
    edges, rings = outlines(team.keepout.solids)
    _rays(poses, others, radii, np.array(team.arena) / 2.0, edges, rings, np.asarray(bearings), reach, found)
    return found


def gaps(poses: Array, others: Array, radii: Array, arena: tuple[float, float], solids: Sequence[Solid]) -> Array:
    """Return how far each body (A, N) is from the nearest other body, obstacle or edge [m]; below 0: they overlap."""
    found = np.empty(poses.shape[:2])
    _gaps(poses, others, radii, np.array(arena) / 2.0, found)
    if solids:
        points = np.ascontiguousarray(poses[..., :2]).reshape(-1, 2)
        clear = distances(solids, points).min(axis=0).reshape(found.shape) - radii
        np.minimum(found, clear, out=found)
    return found


def drawn_poses(team: Team, count: int, rng: "np.random.Generator") -> Array:
    """Draw poses for the robots with free way around each, in ``count`` arenas.

    Args:
        team: The robots, their bodies, the arena with its obstacles, the bystanders.
        count: K.
        rng: Random numbers.

    Returns:
        Poses (K, N, 3): x, y [m], psi [rad; world].

    Raises:
        ValueError: The arena has no room for these robots.
    """
    n, keepout, kinds = len(team), team.keepout, set(team.bodies)
    away = 2.0 * keepout.ahead + _MARGIN_M + max(apart(keepout, a, b) for a in kinds for b in kinds)
    edge = _MARGIN_M + keepout.ahead + max(from_edge(keepout, body) for body in kinds)
    half = np.array(team.arena) / 2.0 - edge
    still = [pose[:2] for _, _, pose in team.bystanders if pose is not None]
    bodies = np.broadcast_to(np.array(still).reshape(-1, 2), (count, len(still), 2))
    poses = np.full((count, n, 3), np.nan)
    poses[..., 2] = rng.uniform(-np.pi, np.pi, (count, n))
    for robot in range(n):
        waiting = np.arange(count)
        for _ in range(_TRIES):
            points = rng.uniform(-1.0, 1.0, (len(waiting), 2)) * half
            before = np.concatenate([bodies[waiting], poses[waiting, :robot, :2]], axis=1)
            off = before - points[:, None]
            free = (off[..., 0] ** 2 + off[..., 1] ** 2 > away * away).all(axis=1)
            if keepout.solids:
                free &= (distances(keepout.solids, points) > edge).all(axis=0)
            poses[waiting[free], robot, :2] = points[free]
            waiting = waiting[~free]
            if not len(waiting):
                break
        else:
            raise ValueError(
                f"no room for {n} robots in an arena of {team.arena[0]:g} x {team.arena[1]:g} m: they need "
                f"{away:g} m from each other and {edge:g} m from edges and obstacles"
            )
    return poses


@kernel
def _in_frames(poses: Array, points: Array, found: Array) -> None:
    for a in range(poses.shape[0]):
        for i in range(poses.shape[1]):
            c, s = np.cos(poses[a, i, 2]), np.sin(poses[a, i, 2])
            x, y = points[a, i, 0] - poses[a, i, 0], points[a, i, 1] - poses[a, i, 1]
            found[a, i, 0], found[a, i, 1] = c * x + s * y, c * y - s * x


@kernel
def _neighbours(poses: Array, velocities: Array, others: Array, count: int, reach: float, found: Array) -> None:
    n, m = poses.shape[1], others.shape[1]
    squares, rows, axes = np.empty(count), np.empty(count, np.int64), np.empty((n, 2))
    for a in range(poses.shape[0]):
        for i in range(n):
            axes[i, 0], axes[i, 1] = np.cos(poses[a, i, 2]), np.sin(poses[a, i, 2])
        for i in range(n):
            seen = 0
            for j in range(n + m):
                if j == i:
                    continue
                x, y = _other(poses, others, a, j)
                x, y = x - poses[a, i, 0], y - poses[a, i, 1]
                square = x * x + y * y
                if square > reach * reach or (seen == count and square >= squares[count - 1]):
                    continue
                k = min(seen, count - 1)
                while k > 0 and squares[k - 1] > square:
                    squares[k], rows[k] = squares[k - 1], rows[k - 1]
                    k -= 1
                squares[k], rows[k] = square, j
                seen = min(seen + 1, count)
            c, s = axes[i, 0], axes[i, 1]
            for k in range(seen):
                j, column = rows[k], NEIGHBOUR * k
                x, y = _other(poses, others, a, j)
                x, y = x - poses[a, i, 0], y - poses[a, i, 1]
                found[a, i, column], found[a, i, column + 1] = c * x + s * y, c * y - s * x
                if j < n:
                    v = velocities[a, j, 0]
                    found[a, i, column + 2] = v * (c * axes[j, 0] + s * axes[j, 1])
                    found[a, i, column + 3] = v * (c * axes[j, 1] - s * axes[j, 0])
                found[a, i, column + 4] = 1.0


@kernel
def _other(poses: Array, others: Array, a: int, j: int) -> tuple[float, float]:
    """Return where the j-th body of an arena is: a robot, or one of the others."""
    n = poses.shape[1]
    return (poses[a, j, 0], poses[a, j, 1]) if j < n else (others[a, j - n, 0], others[a, j - n, 1])


@kernel
def _gaps(poses: Array, others: Array, radii: Array, half: Array, found: Array) -> None:
    n, m = poses.shape[1], others.shape[1]
    for a in range(poses.shape[0]):
        for i in range(n):
            x, y = poses[a, i, 0], poses[a, i, 1]
            found[a, i] = min(half[0] - abs(x), half[1] - abs(y)) - radii[i]
        for i in range(n):
            for j in range(i + 1, n + m):
                if j < n:
                    x, y, radius = poses[a, j, 0], poses[a, j, 1], radii[j]
                else:
                    x, y, radius = others[a, j - n, 0], others[a, j - n, 1], others[a, j - n, 2]
                x, y = x - poses[a, i, 0], y - poses[a, i, 1]
                gap = np.sqrt(x * x + y * y) - radii[i] - radius
                found[a, i] = min(found[a, i], gap)
                if j < n:
                    found[a, j] = min(found[a, j], gap)


@kernel
def _rays(
    poses: Array, others: Array, radii: Array, half: Array, edges: Array, rings: Array, bearings: Array, reach: float,
    found: Array,
) -> None:  # fmt: skip
    n, m = poses.shape[1], others.shape[1]
    for a in range(poses.shape[0]):
        for i in range(n):
            x, y = poses[a, i, 0], poses[a, i, 1]
            for r in range(len(bearings)):
                dx, dy = np.cos(poses[a, i, 2] + bearings[r]), np.sin(poses[a, i, 2] + bearings[r])
                nearest = reach
                if dx != 0.0:
                    nearest = min(nearest, max(0.0, (np.copysign(half[0], dx) - x) / dx))
                if dy != 0.0:
                    nearest = min(nearest, max(0.0, (np.copysign(half[1], dy) - y) / dy))
                for j in range(n + m):
                    if j == i:
                        continue
                    if j < n:
                        nearest = min(nearest, _to_disc(x, y, dx, dy, poses[a, j, 0], poses[a, j, 1], radii[j]))
                    else:
                        other = others[a, j - n]
                        nearest = min(nearest, _to_disc(x, y, dx, dy, other[0], other[1], other[2]))
                found[a, i, r] = min(nearest, _to_solids(x, y, dx, dy, edges, rings))


@kernel
def _to_solids(x: float, y: float, dx: float, dy: float, edges: Array, rings: Array) -> float:
    nearest = np.inf
    for k in range(len(rings)):
        for e in range(int(rings[k, FIRST]), int(rings[k, LAST])):
            if rings[k, RADIUS] > 0.0:
                nearest = min(nearest, _to_disc(x, y, dx, dy, edges[e, 0], edges[e, 1], rings[k, RADIUS]))
            else:
                nearest = min(nearest, _to_edge(x, y, dx, dy, edges[e]))
    return nearest


@kernel
def _to_disc(x: float, y: float, dx: float, dy: float, at_x: float, at_y: float, radius: float) -> float:
    """Return how far along a ray of unit length (dx, dy) a disc begins [m]; infinite: it misses."""
    x, y = at_x - x, at_y - y
    along = x * dx + y * dy
    square = radius * radius - (x * x + y * y - along * along)
    if square < 0.0 or along + np.sqrt(square) < 0.0:
        return np.inf
    return float(max(0.0, along - np.sqrt(square)))


@kernel
def _to_edge(x: float, y: float, dx: float, dy: float, edge: Array) -> float:
    """Return how far along a ray an edge is crossed [m]; infinite: nowhere."""
    ex, ey = edge[2] - edge[0], edge[3] - edge[1]
    across = dx * ey - dy * ex
    if across == 0.0:
        return np.inf
    x, y = edge[0] - x, edge[1] - y
    along, share = (x * ey - y * ex) / across, (x * dy - y * dx) / across
    return float(along) if along >= 0.0 and 0.0 <= share <= 1.0 else np.inf


KERNELS = (_in_frames, _neighbours, _gaps, _rays)  # that are called from Python
