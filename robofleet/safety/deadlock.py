"""Deadlocks of robots that the barrier holds: the right-hand rule, and who is blocked.

The turn (right-hand rule) changes only what is asked for, and every row is kept. A robot that was held for half a
second asks for the same speed 80 degrees to the right. All who press each other do so: they form a roundabout. If it
does not get on for half a second, it asks for the straight way again. But if one of those who hold it stands (it is
asked for nothing, or it stalls: it moves less than a fifth of what it was commanded), it first turns by 110 and then by
140 degrees, to go round that one. An obstacle stands; at one it then tries the left.

A robot is blocked that stands for three seconds, or turns and goes round for eighteen without getting on, because of
somebody who does not wait: one that stands, or stalls. Robots that press each other and all wait are blocked, too,
where they stay in one place for forty seconds.
"""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Instants
from robofleet.core.kernels import kernel
from robofleet.safety.nearest import TOLERANCE, nearest

OBSTACLE = -1  # in a robot's place: what holds another one
MEMORY, TOLD = 10, 7  # of a robot: whole numbers; pose at a window's start, what was commanded since, where it stayed

_WANTED = 0.5  # of its top speed: who asks for less waits, as behind a robot that stalls, and is not held
_GRANTED = 0.1  # of what was wanted; with less a robot does not get on
_ASKS = 0.05  # of its top speed: who asks for less stands
_TURNS = tuple(
    (math.cos(a), math.sin(a)) for a in map(math.radians, (80.0, 110.0, 140.0, -80.0, -110.0, -140.0))
)  # 80: less does not pass a crowd
_RIGHT = 3  # of them are to the right, as in a roundabout; to the left a robot turns for an obstacle alone
_AROUND_S = 0.5  # held for so long, a robot turns; in vain for so long, it turns further, or asks for the straight way
_CLEAR_S = 0.16  # not held for so long, it asks for the straight way
_WAITED_S = 2.0  # who was held within this time waits
_BLOCKED_S = 3.0
_STAYED_S, _STAYED_M = 40.0, 0.15  # held so long within this distance, a robot is blocked, whoever waits for whom
_STALL_S, _STALL_M, _STALL_MOVED = 1.0, 0.04, 0.2  # told to go so far in this time, and moved less than this share
_ROUND = 6  # a tick that a robot stands counts as so many in which it goes round without getting on
# of a robot's memory: ticks; _TURN: which of _TURNS, from 1; _STALLS and _PRESSING: 0 or 1
_HELD, _TURN, _VAIN, _CLEAR, _BLOCKED, _WAITED, _STALLS, _WATCHED, _PRESSING, _STAYED = range(10)


def in_ticks(tick: float) -> tuple[int, int, int, int]:
    """Return the times that ``answer`` and ``watch`` (the last one) count by [ticks]."""
    around, clear, waited, stall = (round(s / tick) for s in (_AROUND_S, _CLEAR_S, _WAITED_S, _STALL_S))
    return around, clear, waited, stall


def patience(tick: float) -> tuple[int, int]:
    """Return after how long a robot is blocked: that stands, or that stays in one place [ticks]."""
    return _ROUND * round(_BLOCKED_S / tick), round(_STAYED_S / tick)


@kernel
def watch(pose: Array, along: float, across: float, l: float, window: int, record: Array, mine: Instants) -> None:
    """Remember whether a robot stalls: over a window, it moves far less than it was commanded to (along, across); and
    for how long it was held near one place."""
    if mine[_WATCHED] == 0:
        record[0], record[1], record[2], record[3], record[4] = pose[0], pose[1], pose[2], 0.0, 0.0
    elif mine[_WATCHED] >= window:
        turned = l * ((pose[2] - record[2] + np.pi) % (2.0 * np.pi) - np.pi)
        moved = np.hypot(np.hypot(pose[0] - record[0], pose[1] - record[1]), turned)
        commanded = np.hypot(record[3], record[4])
        if moved >= _STALL_MOVED * _STALL_M:
            mine[_STALLS] = 0
        if commanded >= _STALL_M and moved < _STALL_MOVED * commanded:
            mine[_STALLS] = 1
        mine[_WATCHED] = -1
    if np.hypot(pose[0] - record[5], pose[1] - record[6]) > _STAYED_M:
        record[5], record[6], mine[_STAYED] = pose[0], pose[1], 0
    mine[_STAYED] = mine[_STAYED] + 1 if mine[_PRESSING] else max(0, mine[_STAYED] - 1)
    record[3] += along
    record[4] += across
    mine[_WATCHED] += 1


@kernel
def asks(along: float, across: float, driving: bool, top: float, mine: Instants) -> bool:
    """Return whether a robot is asked to go somewhere and does not stall; who does not, stands."""
    return bool(driving and np.hypot(along, across) > _ASKS * top and mine[_STALLS] == 0)


@kernel
def answer(
    x: float, y: float, rows: Array, first: int, whose: Instants, top: float, asking: NDArray[np.bool_],
    times: tuple[int, int, int, int], i: int, memory: Instants,
) -> tuple[float, float]:  # fmt: skip
    """Return what robot i gets for (x, y), and remember whether it gets on; rows from ``first`` on are the others'.

    ``whose``: who each row keeps it off; ``asking``: which bodies ``asks`` tells; ``times``: those of ``in_ticks``.
    """
    mine, (met, stands, idle, walled) = memory[i], _held_by(x, y, rows, first, whose, asking, memory)
    wanted = np.hypot(x, y)
    pressing = met and wanted > _WANTED * top
    mine[_CLEAR] = 0 if met else mine[_CLEAR] + 1
    if mine[_CLEAR] >= times[1]:
        mine[_TURN] = 0
    if pressing and mine[_TURN] == 0 and mine[_HELD] >= times[0]:
        mine[_TURN], mine[_HELD], mine[_VAIN] = 1, 0, 0
    turned, turn_x, turn_y = pressing and mine[_TURN] > 0, x, y
    if turned:
        c, s = _TURNS[mine[_TURN] - 1]
        turn_x, turn_y = c * x + s * y, c * y - s * x
    along, across = nearest(turn_x, turn_y, rows)
    stuck = met and np.hypot(along, across) < _GRANTED * wanted
    gets_on = x * along + y * across >= _GRANTED * wanted * wanted
    if turned:
        vain, last = stuck, _RIGHT
        if walled:  # at its corners a robot may creep for long, and get nowhere
            vain, last = turn_x * along + turn_y * across < _GRANTED * wanted * wanted, len(_TURNS)
        mine[_VAIN] = mine[_VAIN] + 1 if vain else max(0, mine[_VAIN] - 1)
        if mine[_VAIN] >= times[0]:
            mine[_VAIN], mine[_TURN] = 0, mine[_TURN] + 1 if stands and mine[_TURN] < last else 0
    elif not met:
        mine[_HELD] = max(0, mine[_HELD] - 1)
    elif pressing and not gets_on:
        mine[_HELD] += 1
    if not pressing or gets_on:
        mine[_BLOCKED] = max(0, mine[_BLOCKED] - _ROUND)
    elif idle:
        mine[_BLOCKED] += _ROUND if stuck else 1
    mine[_PRESSING] = int(pressing)
    if not asking[i]:
        mine[_WAITED] = 0
    else:
        mine[_WAITED] = max(0, mine[_WAITED] - 1) if not met or gets_on else times[2]
    return along, across


@kernel
def _held_by(
    x: float, y: float, rows: Array, first: int, whose: Instants, asking: NDArray[np.bool_], memory: Instants
) -> tuple[bool, bool, bool, bool]:  # fmt: skip
    """Return whether others hold a robot that asks for (x, y); one of them stands, has not waited, is an obstacle."""
    met, stands, idle, walled = False, False, False, False
    for k in range(first, len(rows)):
        if rows[k, 0] * x + rows[k, 1] * y > rows[k, 2] + TOLERANCE:
            j, met = whose[k], True
            if j == OBSTACLE:
                stands, idle, walled = True, True, True
                continue
            stands |= not asking[j]
            idle |= memory[j, _WAITED] == 0
    return met, stands, idle, walled


@kernel
def is_blocked(mine: Instants, patience: tuple[int, int]) -> bool:
    """Return whether a robot will not get on by itself."""
    return bool(mine[_BLOCKED] >= patience[0] or mine[_STAYED] >= patience[1])
