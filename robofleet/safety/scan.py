"""Finds at once of which robots something may be wrong, so that the monitor looks at these alone. Compiled.

It may name a robot of which nothing is wrong, and never misses one: ``tests/safety/test_scan.py`` holds that the
monitor tells the same with and without it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import kernel
from robofleet.safety import monitor, runaway
from robofleet.safety.distances import CLOSEST_M
from robofleet.safety.monitor import MonitorSettings, MonitorState, Suspects
from robofleet.safety.rows import ROBOT, Rows
from robofleet.safety.supervisor import MOVING, Phase
from robofleet.safety.view import NEVER, FleetView
from robofleet.vehicles.solids import away, outlines

_SILENT_NS, _LATE_NS, _LOWEST_BATTERY = monitor.SILENT_NS, monitor.LATE_NS, monitor.LOWEST_BATTERY
_CLOSEST_M, _STALLED_RAD_S, _TURNING_RAD_S = CLOSEST_M, monitor.STALLED_RAD_S, runaway.TURNING_RAD_S
_NEVER, _NOBODY = NEVER, np.uint64(0)
_S = 1e9
_MORE_M = 1e-9  # what rounding may hide: the monitor decides
_INFEASIBLE = 2
BODY = np.dtype([("radius", "<f8"), ("max_speed", "<f8")])


class Scan:
    """Scans the views of one fleet."""

    def __init__(self, settings: MonitorSettings) -> None:
        self._settings = settings
        bodies = zip(settings.body_radius, settings.max_speed, strict=True)
        self._bodies = np.array(list(bodies), BODY)
        self._floors = outlines(settings.floors)
        self._suspect = np.zeros(len(self._bodies), np.bool_)
        self._sessions: tuple[tuple[int, ...], NDArray[np.uint64]] = (), np.zeros(0, np.uint64)

    def suspects(self, memory: MonitorState, phase: Phase, view: FleetView) -> Suspects:
        """Return what the monitor must look at, of the newest view."""
        rows, before = Rows.of(view.robots).array, Rows.of((memory.view or view).robots).array
        if phase in (Phase.HOLD, *MOVING) and memory.sessions:
            if self._sessions[0] is not memory.sessions:
                self._sessions = memory.sessions, np.array(memory.sessions, np.uint64)
            sessions = self._sessions[1]
        else:
            sessions = np.ascontiguousarray(rows["session"])
        length, width = self._settings.arena
        found, infeasible, stalled, rolling = _scan(
            self._suspect, rows, before, sessions, self._bodies, self._settings.build, length / 2, width / 2,
            *self._floors, view.now_ns,
        )  # fmt: skip
        close = _close(rows, self._bodies)
        pairs = tuple(map(tuple, close.tolist())) if len(close) else ()
        infeasible = infeasible or any(memory.infeasible_ns)
        robots = tuple(np.flatnonzero(self._suspect).tolist()) if found else ()
        return Suspects(robots, pairs, infeasible=infeasible, stalled=stalled, rolling=rolling)


@kernel
def _scan(suspect, rows, before, sessions, bodies, build, half_length, half_width, edges, rings, now_ns):  # type: ignore[no-untyped-def]
    """Mark the robots (N,) of which something may be wrong; returns whether there are any, and three of their kinds."""
    found = infeasible = stalled = rolling = False
    for k in range(len(rows)):
        r, b, body = rows[k], before[k], bodies[k]
        wrong = r.faults != 0 or r.latch != 0 or r.filtered == _INFEASIBLE or r.blocked != 0 or r.failed != 0
        wrong = wrong or (r.battery >= 0.0 and r.battery < _LOWEST_BATTERY)
        if r.heard_ns != _NEVER:
            restarted = b.boot_id not in (_NOBODY, r.boot_id)
            silent = now_ns - r.heard_ns > _SILENT_NS
            wrong = wrong or silent or restarted or r.build != build or r.session != sessions[k]
        counts = r.left_angle != 0.0 or r.right_angle != 0.0 or r.left_speed != 0.0 or r.right_speed != 0.0
        left = abs(r.left_output) >= _STALLED_RAD_S and abs(r.left_speed) <= _TURNING_RAD_S
        right = abs(r.right_output) >= _STALLED_RAD_S and abs(r.right_speed) <= _TURNING_RAD_S
        if counts and (left or right):
            stalled = wrong = True
        if r.seen_ns != _NEVER:
            outside = abs(r.x) + body.radius > half_length - _MORE_M or abs(r.y) + body.radius > half_width - _MORE_M
            for ring in rings:
                outside = outside or away(edges, ring, r.x, r.y) < body.radius + _MORE_M
            wrong = wrong or r.unseen_ns >= _LATE_NS or r.lost != 0 or outside
            if not (counts or r.left_output != 0.0 or r.right_output != 0.0):
                rolling = True  # it has no encoders, and is told to stand
                wrong = True
        if b.seen_ns != _NEVER:
            jump = math.hypot(r.x - b.x, r.y - b.y)
            driven = body.max_speed * abs(r.seen_ns - b.seen_ns) / _S
            wrong = wrong or not jump <= body.radius + driven - _MORE_M
        suspect[k] = wrong
        found = found or wrong
        infeasible = infeasible or r.filtered == _INFEASIBLE
    return found, infeasible, stalled, rolling


@kernel
def _close(rows, bodies):  # type: ignore[no-untyped-def]
    """Return the pairs (K, 2) that may be too close, in the order of their rows: a sweep along x."""
    n = len(rows)
    x = np.empty(n)
    largest = 0.0
    for k in range(n):
        x[k] = rows[k].x if rows[k].seen_ns != _NEVER else math.inf
        largest = max(largest, bodies[k].radius)
    order = np.argsort(x)
    pairs = np.empty((4, 2), np.int64)
    count = 0
    for i in range(n):
        left_robot = order[i]
        if math.isinf(x[left_robot]):
            break
        j = i + 1
        while j < n and x[order[j]] - x[left_robot] < bodies[left_robot].radius + largest + _CLOSEST_M + _MORE_M:
            other = order[j]
            near = bodies[left_robot].radius + bodies[other].radius + _CLOSEST_M + _MORE_M
            if math.hypot(rows[left_robot].x - rows[other].x, rows[left_robot].y - rows[other].y) < near:
                if count == len(pairs):
                    longer = np.empty((2 * count, 2), np.int64)
                    longer[:count] = pairs
                    pairs = longer
                pairs[count, 0], pairs[count, 1] = min(left_robot, other), max(left_robot, other)
                count += 1
            j += 1
    pairs = pairs[:count]
    return pairs[np.argsort(pairs[:, 0] * n + pairs[:, 1])]


KERNELS = (_scan, _close)


def compile_kernels() -> None:
    """Compile, or load from the cache, by a look at one robot."""
    rows, bodies = np.zeros(1, ROBOT), np.zeros(1, BODY)
    _scan(np.zeros(1, np.bool_), rows, rows, np.zeros(1, np.uint64), bodies, 0, 1.0, 1.0, *outlines(()), 1)
    _close(rows, bodies)
