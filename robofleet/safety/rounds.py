"""In which rounds each robot wiggles: forth in one, back in a later one. Pure.

Many wiggle at once, and a round proves who moves whose tag only by who moves in it and who stands. So no two robots
have the same two rounds: of any two there is a round in which the one moves and the other stands. That takes about the
root of twice as many rounds as there are robots. Two robots without room for both are never away from where they
stood at once: one of them is back before the other one goes.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Rounds = NDArray[np.int64]


def within(points: NDArray[np.float64], reach: float) -> Rounds:
    """Return the pairs of points (N, 2) that are no further apart than ``reach``: indices (K, 2), the lower first."""
    order = np.argsort(points[:, 0])
    at, found = points[order], [np.empty((0, 2), dtype=np.int64)]
    for k in range(1, len(points)):  # who comes k places later along x
        step = at[k:] - at[:-k]
        ahead = step[:, 0] <= reach
        if not ahead.any():
            break
        near = np.flatnonzero(ahead & (np.hypot(step[:, 0], step[:, 1]) <= reach))
        found.append(np.stack([order[near], order[near + k]], axis=1))
    pairs = np.sort(np.concatenate(found))
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def rounds(robots: int, close: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return each robot's two rounds, counted from 0; ``close`` are pairs without room for both.

    Who has the most neighbours chooses first: the earliest rounds that are left, and of these the shortest way out.
    """
    near: list[list[int]] = [[] for _ in range(robots)]
    for first, other in close:
        near[first].append(other)
        near[other].append(first)
    given: dict[int, tuple[int, int]] = {}
    forth, back = np.empty((2, 0), dtype=np.int64)
    left = np.empty(0, dtype=np.bool_)
    for row in sorted(range(robots), key=lambda row: -len(near[row])):
        others = [given[other] for other in near[row] if other in given]
        while not (fits := left & _apart(forth, back, others)).any():
            last = int(back[-1]) + 1 if len(back) else 1
            forth = np.concatenate([forth, np.arange(last - 1, -1, -1)])
            back = np.concatenate([back, np.full(last, last)])
            left = np.concatenate([left, np.ones(last, dtype=np.bool_)])
        chosen = int(fits.argmax())
        left[chosen] = False
        given[row] = int(forth[chosen]), int(back[chosen])
    return tuple(given[row] for row in range(robots))


def _apart(forth: Rounds, back: Rounds, others: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return which pairs of rounds begin after, or end before, all of the others."""
    apart = np.ones(len(forth), dtype=np.bool_)
    for first, last in others:
        apart &= (back < first) | (forth > last)
    return apart
