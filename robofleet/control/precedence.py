"""Precedence between robots: shortens a joint plan, and executes it by dependencies instead of by a clock.

A plan (A + 1, N, 2) says where robots are at each step. Its execution keeps the order in which two robots pass a
place, and nothing else of its time (an action dependency graph): robot i may drive to step a as soon as every other
robot j has come so far that nothing which is left of its way up to step a comes near i's place at a. A robot that is
late or stands is waited for.

Nobody waits for ever: in a plan of ``planning`` a place is clear of where others were one step before. So who waits
for step a waits for robots that have not come to step a - 1, and the robot that is behind all others waits for nobody.
"""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.control import planning, solid_ways
from robofleet.control.planning import Problem
from robofleet.control.solid_ways import SolidWays
from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

_rho, _clear_way = planning.rho, solid_ways.clear_way
_EPSILON = 1e-9
_LEAST_SAVING_M = 1e-3  # what saves less is not taken
_ROUNDS = 3
_LONGEST_STEP_CELLS = 1.42


class Plan(NamedTuple):
    """A plan to be executed. Steps count from 0, where all robots begin, to A."""

    places: Array  # (N, A + 1, 2) [m]
    length: Array  # (N, A + 1): of the way up to each step [m]
    needed: NDArray[np.int32]  # (N, A + 1, N): the step that j must have come to before i drives to a


def plan(problem: Problem, rng: np.random.Generator) -> Generator[None, None, Plan | None]:
    """Return a plan, None where none was found. It yields after each part of its work."""
    steps = yield from planning.search(problem, rng)
    if steps is None:
        return None
    places = np.ascontiguousarray(steps.transpose(1, 0, 2))
    rho, standing = planning.clearance(problem), planning.kept(problem)
    radii = np.empty(places.shape[:2])
    for i in range(len(places)):
        _radii(places[i], rho.places[i], rho.radii[i], rho.most, radii[i])
    for _ in range(_ROUNDS):
        shorter = False
        for i in range(len(places)):
            shorter |= _shorten(
                places, radii, i, rho.places[i], rho.radii[i], rho.most, problem.obstacles, standing,
                _LONGEST_STEP_CELLS * problem.cell,
            )  # fmt: skip
            yield
        if not shorter:
            break
    needed = np.zeros((len(places), places.shape[1], len(places)), dtype=np.int32)
    for i in range(len(places)):
        _needs(places, radii, i, needed[i])
        yield
    steps_taken = np.linalg.norm(np.diff(places, axis=1), axis=2)
    return Plan(places, np.concatenate([np.zeros((len(places), 1)), np.cumsum(steps_taken, axis=1)], axis=1), needed)


@kernel
def _radii(places: Array, ends: Array, end_radii: Array, most: float, out: Array) -> None:
    for a in range(len(places)):
        out[a] = _rho(places[a, 0], places[a, 1], ends, end_radii, most)


@kernel
def _shorten(
    places: Array, radii: Array, i: int, ends: Array, end_radii: Array, most: float, obstacles: Array,
    standing: SolidWays, step: float,
) -> bool:  # fmt: skip
    """Replace pieces of robot i's way by straight ones, long pieces first; returns whether any was.

    Along a straight piece it drives at once and then waits, or else it drives all the time.
    """
    last, shorter = places.shape[1] - 1, False
    new, new_radii = np.empty((last + 1, 2)), np.empty(last + 1)
    span = last
    while span >= 2:
        for begin in range(0, last - 1, max(1, span // 4)):
            end = min(last, begin + span)
            way = 0.0
            for a in range(begin, end):
                way += np.hypot(places[i, a + 1, 0] - places[i, a, 0], places[i, a + 1, 1] - places[i, a, 1])
            straight_x, straight_y = places[i, end, 0] - places[i, begin, 0], places[i, end, 1] - places[i, begin, 1]
            straight = np.hypot(straight_x, straight_y)
            if way < straight + _LEAST_SAVING_M:
                continue
            if not _clear_way(places[i, begin, 0], places[i, begin, 1], places[i, end, 0], places[i, end, 1], standing):
                continue
            for slow in range(2):
                share = 1.0 / (end - begin)
                if slow == 0:
                    share = max(share, step / max(straight, _EPSILON))
                possible = True
                for a in range(begin + 1, end):
                    part = min(1.0, share * (a - begin))
                    new[a, 0] = places[i, begin, 0] + part * straight_x
                    new[a, 1] = places[i, begin, 1] + part * straight_y
                    new_radii[a] = _rho(new[a, 0], new[a, 1], ends, end_radii, most)
                    if not _possible(places, radii, i, a, new[a], new_radii[a], obstacles):
                        possible = False
                        break
                if possible:
                    for a in range(begin + 1, end):
                        places[i, a, 0], places[i, a, 1] = new[a, 0], new[a, 1]
                        radii[i, a] = new_radii[a]
                    shorter = True
                    break
        span = span * 2 // 3
    return shorter


@kernel
def _possible(places: Array, radii: Array, i: int, a: int, at: Array, radius: float, obstacles: Array) -> bool:
    """Whether robot i can be ``at`` a place in step a: clear of obstacles, and of others a step before and after."""
    for k in range(len(obstacles)):
        if np.hypot(at[0] - obstacles[k, 0], at[1] - obstacles[k, 1]) < obstacles[k, 2]:
            return False
    for j in range(len(places)):
        if j == i:
            continue
        for b in range(a - 1, a + 2):
            x, y, apart = at[0] - places[j, b, 0], at[1] - places[j, b, 1], radius + radii[j, b]
            if x * x + y * y < apart * apart - _EPSILON:
                return False
    return True


@kernel
def _needs(places: Array, radii: Array, i: int, needed: NDArray[np.int32]) -> None:
    """Write what robot i waits for (A + 1, N)."""
    for a in range(1, places.shape[1]):
        for j in range(len(places)):
            if j == i:
                continue
            for b in range(a - 1, -1, -1):
                x, y = places[i, a, 0] - places[j, b, 0], places[i, a, 1] - places[j, b, 1]
                apart = radii[i, a] + radii[j, b]
                if x * x + y * y < apart * apart - 1e-6:
                    needed[a, j] = b + 1
                    break


KERNELS = (_radii, _shorten, _needs)  # that are called from Python
