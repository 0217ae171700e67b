"""Multi-agent path finding for discs: a joint plan of N robots from where they stand to their goals.

The search is LaCAM (lazy constraints addition): a depth-first search over configurations, places of all robots, whose
successors a PIBT (priority inheritance with backtracking) proposes. A robot moves over a grid that is finer than its
body, and from its exact start and to its exact goal, which are vertices of its own.

Two robots at x and y are *clear* of each other where |x - y| >= rho_i(x) + rho_j(y). rho is half of the distance that
is kept between robots under way; near a robot's start and goal it shrinks, so far that starts and goals are clear.

Solids, obstacles with an outline and a floor that is no rectangle, do not move. A robot's centre keeps ``beside`` from
them under way, also between two places of the grid; near a start or a goal that is nearer to a solid it keeps less.

In a step, a robot takes only a place that is clear of where all others are, beside where they will be. So nobody moves
into a place that is left at the same time: a plan's waiting never runs in a circle (see ``precedence``), and standing
is always possible, so that the generator needs no backtracking.
"""

import math
from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robofleet.control import solid_ways
from robofleet.control.solid_ways import SolidWays
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.kernels import kernel
from robofleet.vehicles.solids import Solid

_REACH_CELLS = 1.5  # from a start or to a goal
_SLOPE = solid_ways.SLOPE  # by which rho grows with the distance from a start or goal
_EPSILON = 1e-9
_clear_way = solid_ways.clear_way
_MOST_NEIGHBOURS = 16  # of a vertex
_CANDIDATES = _MOST_NEIGHBOURS + 2
_EXPANSIONS = 8  # in one part of the work
_FIRST_TRY = 1500  # expansions; each further one from the beginning, with other ties, may take twice as many
_TRIES = 6


@dataclass(frozen=True)
class Problem:
    """Where robots are, where they are to be, and what they keep."""

    starts: Array  # (N, 2) [m]
    goals: Array  # (N, 2) [m]
    obstacles: Array  # (M, 3): x, y, and the distance that a centre keeps [m]
    half: tuple[float, float]  # |x| and |y| of a centre under way, at most [m]
    distance: float  # between two centres under way [m]
    cell: float  # [m]
    solids: tuple[Solid, ...] = ()
    beside: float = 0.0  # of a centre from a solid under way [m]


class Clearance(NamedTuple):
    """What rho needs: of robot i, min(half the distance, near its start, near its goal)."""

    places: Array  # (N, 2, 2): start and goal [m]
    radii: Array  # (N, 2): rho there [m]
    most: float  # half of the distance under way [m]


class _Grid(NamedTuple):
    """Places, and who is next to whom, as in ``_World``."""

    at: Array
    near: Indices
    reach: Array
    standing: SolidWays


class _World(NamedTuple):
    """What the kernels read. Vertices are the V places of the grid, then the N starts, then the N goals."""

    at: Array  # (V + 2 N, 2) [m]
    near: Indices  # (V + 2 N, _NEAR): places of the grid that are one step away, then -1
    reach: Array  # (2 N,): of starts and goals, how far a step to or from them goes [m]
    direct: Flags  # (N,) who can go from its start to its goal at once
    radii: Array  # (N, V + 2 N): rho
    cost: Array  # (N, V + 2 N): way to the goal [m]


def clearance(problem: Problem) -> Clearance:
    """Return rho of all robots: starts are clear of each other, and goals are."""
    both = np.stack([problem.starts, problem.goals], axis=1)
    radii = np.full((len(both), 2), problem.distance / 2)
    for end in range(2):
        gaps = np.linalg.norm(both[:, None, end] - both[None, :, end], axis=2)
        np.fill_diagonal(gaps, np.inf)
        radii[:, end] = np.minimum(radii[:, end], gaps.min(axis=1, initial=np.inf) / 2 - _EPSILON)
    return Clearance(both, radii, problem.distance / 2)


def kept(problem: Problem) -> SolidWays:
    """Return what ways keep from solids."""
    return solid_ways.kept(problem.solids, problem.beside, np.concatenate([problem.starts, problem.goals]))


def unreachable(problem: Problem) -> list[int]:
    """Return the robots to whose goals no way leads past what does not move."""
    n, work = len(problem.starts), _world(problem)
    try:
        while True:
            next(work)
    except StopIteration as done:
        world = done.value
    if isinstance(world, _World):
        return []
    return list(range(n)) if world is None else world


def ways(problem: Problem) -> Generator[None, None, Array]:
    """Return the way of each robot (row) to each goal (column) over the grid [m], infinite where there is none."""
    n = len(problem.starts)
    found, grid = np.full((n, n), np.inf), (yield from _grid(problem))
    if grid is not None:
        cost, first = np.empty(len(grid.at)), len(grid.at) - 2 * n
        for goal in range(n):
            yield
            _costs(grid.at, grid.near, first + n + goal, 0.0, n, goal, False, cost)
            found[:, goal] = cost[first : first + n]
    return found


def search(problem: Problem, rng: np.random.Generator) -> Generator[None, None, Array | None]:
    """Return places (A + 1, N, 2) [m] of all robots in steps, None where no plan was found.

    It yields after each part of its work; a part takes less than a millisecond for 20 robots.
    """
    world = yield from _world(problem)
    if not isinstance(world, _World):
        return None
    for attempt in range(_TRIES):
        found = yield from _lacam(world, len(problem.starts), _FIRST_TRY << attempt, rng)
        if found is not None:
            return world.at[found]
    return None


def _grid(problem: Problem) -> Generator[None, None, _Grid | None]:
    """Return the grid that is free of what does not move; None: nobody has any place there."""
    n, cell = len(problem.starts), problem.cell
    nx, ny = (max(1, math.floor(2 * half / cell) + 1) for half in problem.half)
    x, y = (cell * (np.arange(count) - (count - 1) / 2) for count in (nx, ny))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    away = np.linalg.norm(grid[:, None] - problem.obstacles[None, :, :2], axis=2) - problem.obstacles[:, 2]
    free, standing = np.asarray((away >= 0).all(axis=1)), kept(problem)
    left = np.empty(len(grid) + 2 * n)
    solid_ways.left(np.concatenate([grid, problem.starts, problem.goals]), standing, left)
    free &= left[: len(grid)] >= 0.0
    if not free.any():
        return None
    at = np.concatenate([grid, problem.starts, problem.goals])
    near, reach = np.full((len(at), _MOST_NEIGHBOURS), -1), np.full(2 * n, np.inf)
    yield
    _neighbours(at, free, nx, ny, cell, left, standing, near, reach)
    return _Grid(at, near, reach, standing)


def _world(problem: Problem) -> Generator[None, None, _World | list[int] | None]:
    """Return what the search reads; else who cannot come to its goal; None: nobody has any place on the grid."""
    grid = yield from _grid(problem)
    if grid is None:
        return None
    at, near, reach, standing = grid
    n = len(problem.starts)
    first = len(at) - 2 * n
    direct = np.empty(n, dtype=np.bool_)
    _direct(at, n, reach, standing, direct)
    rho = clearance(problem)
    radii, cost = np.empty((n, len(at))), np.empty((n, len(at)))
    for i in range(n):
        yield
        _radii(at, rho.places[i], rho.radii[i], rho.most, radii[i])
        _costs(at, near, first + n + i, reach[n + i], n, i, direct[i], cost[i])
    cut_off = [i for i in range(n) if not np.isfinite(cost[i, first + i])]
    return cut_off or _World(at, near, reach, direct, radii, cost)


class _Node:
    """A configuration that was reached, and what was tried from there: constraints (robot, vertex), breadth first."""

    __slots__ = ("constraints", "order", "parent", "q", "waited")

    def __init__(self, q: Indices, waited: Array, parent: "_Node | None") -> None:
        self.q, self.waited, self.parent = q, waited, parent
        self.order = np.argsort(-waited, kind="stable")
        self.constraints: deque[tuple[tuple[int, int], ...]] = deque([()])


def _lacam(
    world: _World, n: int, expansions: int, rng: np.random.Generator
) -> Generator[None, None, Indices | None]:  # fmt: skip
    first = len(world.at) - 2 * n
    goals = first + n + np.arange(n)
    start, ties = first + np.arange(n), rng.random(n)
    root = _Node(start, world.cost[np.arange(n), start] * 1e-3 + 1e-3 * ties, None)
    known, open_ = {root.q.tobytes(): root}, [root]
    forced, following, choices = np.full(n, -1), np.empty(n, dtype=np.int64), np.empty(_CANDIDATES, dtype=np.int64)
    for k in range(expansions):
        if k % _EXPANSIONS == _EXPANSIONS - 1:
            yield
        if not open_:
            return None
        node = open_[-1]
        if np.array_equal(node.q, goals):
            return _back(node)
        if not node.constraints:
            open_.pop()
            continue
        constraint = node.constraints.popleft()
        if len(constraint) < n:
            i = int(node.order[len(constraint)])
            count = _choices(i, node.q[i], n, world.at, world.near, world.reach, world.direct, choices)
            node.constraints.extend((*constraint, (i, int(c))) for c in rng.permutation(choices[:count]))
        forced[:] = -1
        for i, vertex in constraint:
            forced[i] = vertex
        noise = rng.random((n, _CANDIDATES))
        if not _configuration(node.q, node.order, forced, *world, noise, following):
            continue
        old = known.get(following.tobytes())
        if old is not None:
            if old is not node:
                open_.append(old)
            continue
        at_goal = following == goals
        waited = np.where(at_goal, 1e-3 * ties, np.floor(node.waited) + 1 + 1e-3 * ties)
        new = _Node(following.copy(), waited, node)
        known[new.q.tobytes()] = new
        open_.append(new)
    return None


def _back(node: _Node) -> Indices:
    return np.array([step.q for step in reversed(list(_ancestors(node)))])


def _ancestors(node: _Node | None) -> Iterator[_Node]:
    while node is not None:
        yield node
        node = node.parent


@kernel
def _radii(at: Array, places: Array, radii: Array, most: float, out: Array) -> None:
    for v in range(len(at)):
        out[v] = rho(at[v, 0], at[v, 1], places, radii, most)


@kernel
def rho(x: float, y: float, places: Array, radii: Array, most: float) -> float:
    """Return rho of a robot at (x, y); places (2, 2) and radii (2,) are its own of ``Clearance``."""
    least = most
    for k in range(2):
        least = min(least, radii[k] + _SLOPE * np.hypot(x - places[k, 0], y - places[k, 1]))
    return least


@kernel
def _direct(at: Array, n: int, reach: Array, standing: SolidWays, direct: Flags) -> None:
    first = len(at) - 2 * n
    for i in range(n):
        start, goal = at[first + i], at[first + n + i]
        direct[i] = _clear_way(start[0], start[1], goal[0], goal[1], standing)


@kernel
def _neighbours(
    at: Array, free: Flags, nx: int, ny: int, cell: float, left: Array, standing: SolidWays, near: Indices,
    reach: Array,
) -> None:  # fmt: skip
    """Write which free places of the grid are next to each vertex; a start or goal off the grid reaches the nearest."""
    first = nx * ny
    for v in range(len(at)):
        limit = _REACH_CELLS * cell
        if v >= first:
            for w in range(first):
                if free[w]:
                    reach[v - first] = min(reach[v - first], np.hypot(at[w, 0] - at[v, 0], at[w, 1] - at[v, 1]))
            limit = max(limit, 1.001 * reach[v - first])
            reach[v - first] = limit
        span = math.ceil(limit / cell)
        middle_x, middle_y = round((at[v, 0] - at[0, 0]) / cell), round((at[v, 1] - at[0, 1]) / cell)
        count = 0
        for jx in range(max(0, middle_x - span), min(nx, middle_x + span + 1)):
            for jy in range(max(0, middle_y - span), min(ny, middle_y + span + 1)):
                w = jx * ny + jy
                away = np.hypot(at[w, 0] - at[v, 0], at[w, 1] - at[v, 1])
                if w == v or not free[w] or away > limit or count == _MOST_NEIGHBOURS:
                    continue
                far_enough = left[v] + left[w] > (1.0 + _SLOPE) * away
                if far_enough or _clear_way(at[v, 0], at[v, 1], at[w, 0], at[w, 1], standing):
                    near[v, count] = w
                    count += 1


@kernel
def _costs(at: Array, near: Indices, goal: int, reach: float, n: int, i: int, direct: bool, cost: Array) -> None:
    """Write each vertex's way to a goal over the grid [m], infinite where there is none: sweeps, until none changes."""
    first = len(at) - 2 * n
    cost[:] = np.inf
    for w in near[goal]:
        if w >= 0:
            cost[w] = np.hypot(at[w, 0] - at[goal, 0], at[w, 1] - at[goal, 1])
    changed, sweep = True, 0
    while changed or sweep < 2:
        changed = False
        for k in range(first):
            v = k if sweep % 2 == 0 else first - 1 - k
            changed |= _lower(v, at, near, cost)
        sweep += 1
    for v in range(first, len(at)):
        _lower(v, at, near, cost)
        straight = np.hypot(at[v, 0] - at[goal, 0], at[v, 1] - at[goal, 1])
        if straight <= reach and (direct or v != first + i):
            cost[v] = straight


@kernel
def _lower(v: int, at: Array, near: Indices, cost: Array) -> bool:
    best = cost[v]
    for w in near[v]:
        if w >= 0:
            best = min(best, cost[w] + np.hypot(at[w, 0] - at[v, 0], at[w, 1] - at[v, 1]))
    lower = bool(best < cost[v] - _EPSILON)
    if lower:
        cost[v] = best
    return lower


@kernel
def _choices(
    i: int, v: int, n: int, at: Array, near: Indices, reach: Array, direct: Flags, out: Indices
) -> int:  # fmt: skip
    """Write where robot i at vertex v can be a step later, beginning with v itself; returns how many."""
    out[0], count = v, 1
    for w in near[v]:
        if w >= 0:
            out[count] = w
            count += 1
    goal = len(at) - n + i
    if v != goal and np.hypot(at[goal, 0] - at[v, 0], at[goal, 1] - at[v, 1]) <= reach[n + i]:
        out[count] = goal
        count += _leads(v, goal, len(at) - 2 * n, near, direct[i])
    return count


@kernel
def _leads(v: int, goal: int, first: int, near: Indices, direct: bool) -> bool:
    """Whether a vertex within a goal's reach has a way to it: its own start, or a place that is next to it."""
    if v >= first:
        return direct
    return bool((near[goal] == v).any())


@kernel
def _clear(i: int, u: int, j: int, v: int, at: Array, radii: Array) -> bool:
    x, y, apart = at[u, 0] - at[v, 0], at[u, 1] - at[v, 1], radii[i, u] + radii[j, v]
    return bool(x * x + y * y >= apart * apart)


@kernel
def _configuration(
    q: Indices, order: Indices, forced: Indices, at: Array, near: Indices, reach: Array, direct: Flags,
    radii: Array, cost: Array, noise: Array, out: Indices,
) -> bool:  # fmt: skip
    """Write where all robots are a step after ``q``; False where what is forced (-1: nothing) cannot be.

    A robot takes the best place that is free. Where it gets no nearer, it stands, and the robots that keep it from its
    best place inherit its priority: they are asked next, and leave its way to the side.
    """
    n = len(q)
    if not _forced(q, forced, at, radii, out):
        return False
    waiting, asker, wish = np.empty(n * n + 1, dtype=np.int64), np.full(n, -1), np.zeros((n, 2))
    choices, scores = np.empty(_CANDIDATES, dtype=np.int64), np.empty(_CANDIDATES)
    for highest in order:
        waiting[0], depth = highest, 1
        while depth > 0:
            depth -= 1
            i = waiting[depth]
            if out[i] >= 0:
                continue
            count = _choices(i, q[i], n, at, near, reach, direct, choices)
            for c in range(count):
                scores[c] = cost[i, choices[c]] + 1e-3 * noise[i, c] * reach[0]
                if asker[i] >= 0:
                    scores[c] = 0.1 * scores[c] - _aside(choices[c], q[asker[i]], wish[asker[i]], at)
            out[i], wanted = _best(i, q, choices[:count], scores, out, at, radii)
            if wanted < 0 or out[i] != q[i]:
                continue
            x, y = at[wanted, 0] - at[q[i], 0], at[wanted, 1] - at[q[i], 1]
            wish[i, 0], wish[i, 1] = x / np.hypot(x, y), y / np.hypot(x, y)
            for j in range(n):
                if j != i and out[j] < 0 and not _clear(i, wanted, j, q[j], at, radii):
                    asker[j], waiting[depth] = i, j
                    depth += 1
    return True


@kernel
def _forced(q: Indices, forced: Indices, at: Array, radii: Array, out: Indices) -> bool:
    """Write what is forced; False where it is not clear."""
    for i in range(len(q)):
        out[i] = forced[i]  # not out[:] = forced: the message of that line's check compiles for a second
    for i in range(len(q)):
        if forced[i] < 0:
            continue
        for j in range(len(q)):
            if j != i and not _clear(i, forced[i], j, q[j], at, radii):
                return False
            if j < i and forced[j] >= 0 and not _clear(i, forced[i], j, forced[j], at, radii):
                return False
    return True


@kernel
def _aside(u: int, other: int, direction: Array, at: Array) -> float:
    """Return how much a vertex is out of the way of a robot that goes in a direction."""
    x, y = at[u, 0] - at[other, 0], at[u, 1] - at[other, 1]
    return float(abs(x * direction[1] - y * direction[0]) + 0.05 * (x * direction[0] + y * direction[1]))


@kernel
def _best(
    i: int, q: Indices, choices: Indices, scores: Array, out: Indices, at: Array, radii: Array
) -> tuple[int, int]:  # fmt: skip
    """Return the place of the lowest score that is free, and one that is better but for robots not yet asked (or -1).

    The first of the choices, where robot i is, always is free.
    """
    best, wanted = 0, -1
    for c in range(1, len(choices)):
        if scores[c] >= scores[best]:
            continue
        possible, free = True, True
        for j in range(len(q)):
            if j == i:
                continue
            left = _clear(i, choices[c], j, q[j], at, radii)
            free &= left
            if out[j] >= 0 and not (left and _clear(i, choices[c], j, out[j], at, radii)):
                possible = False
                break
        if possible and free:
            best = c
        elif possible and (wanted < 0 or scores[c] < scores[wanted]):
            wanted = c
    if wanted < 0 or scores[wanted] >= scores[best]:
        return choices[best], -1
    return choices[best], choices[wanted]


def assign(distances: Array) -> Indices:
    """Return for each row (robot) its column (goal): the largest distance least, and then the sum of them.

    distances (N, N) [m]. Hungarian method with shortest augmenting paths, once for each bound that is tried.
    """
    bounds = np.unique(distances)
    low, high = 0, len(bounds) - 1
    best = np.empty(len(distances), dtype=np.int64)
    forbidden = 1.0 + 2 * len(distances) * float(bounds[-1])
    while low < high:
        middle = (low + high) // 2
        _hungarian(np.where(distances <= bounds[middle], 0.0, 1.0), best)
        allowed = bool((distances[np.arange(len(best)), best] <= bounds[middle]).all())
        low, high = (low, middle) if allowed else (middle + 1, high)
    _hungarian(np.where(distances <= bounds[high], distances, forbidden), best)
    return best


@kernel
def _hungarian(cost: Array, column_of: Indices) -> None:
    """Write the assignment of least summed cost (N, N)."""
    n = len(cost)
    row_of = np.full(n + 1, -1)
    rows, columns = np.zeros(n), np.zeros(n + 1)
    for i in range(n):
        row_of[n], current = i, n
        slack, came = np.full(n + 1, np.inf), np.full(n + 1, n)
        used = np.zeros(n + 1, dtype=np.bool_)
        while row_of[current] >= 0:
            used[current] = True
            row, delta, following = row_of[current], np.inf, n
            for j in range(n):
                if used[j]:
                    continue
                reduced = cost[row, j] - rows[row] - columns[j]
                if reduced < slack[j]:
                    slack[j], came[j] = reduced, current
                if slack[j] < delta:
                    delta, following = slack[j], j
            for j in range(n + 1):
                if used[j]:
                    rows[row_of[j]] += delta
                    columns[j] -= delta
                else:
                    slack[j] -= delta
            current = following
        while current != n:
            row_of[current], current = row_of[came[current]], came[current]
    for j in range(n):
        column_of[row_of[j]] = j


KERNELS = (_radii, _direct, _neighbours, _costs, _choices, _configuration, _hungarian, *solid_ways.KERNELS)
