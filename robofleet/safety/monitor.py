"""The rules: what of a fleet's view is an event of the run. No I/O.

A rule is one condition, with its threshold, that yields its event; it stands here and nowhere else. Rules about
processes look at the view, rules about robots at its rows, compiled. Where a condition of a robot holds, Python adds
what it needs beyond one view: for how long it has held, and each fault by its name.

An event is told again as long as what it tells of lasts, so a run cannot be resumed into it. Only changes are told
once: a restart, ticks that were overrun, the tracker's news.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import kernel
from robofleet.safety import runaway
from robofleet.safety.distances import CLOSEST_M
from robofleet.safety.latches import Latch
from robofleet.safety.runaway import Rolling
from robofleet.safety.supervisor import MOVING, NOBODY, Event, Happening, Phase
from robofleet.safety.view import NEVER, ROBOT, FleetView, Rows, rests
from robofleet.vehicles.interface import RobotFault
from robofleet.vehicles.solids import Outlines, Solid, away, outlines

_MS = 1_000_000
_S = 1_000_000_000

SILENT_NS = 500 * _MS  # 25 statuses or 15 ticks: a process or its network; the gates closed after 120 ms
TRACKER_SILENT_NS = 250 * _MS  # 7 images: every robot is driven by its wheels' word alone, some 50 mm by now
_ARRIVALS = {
    Phase.POSITIONING: Event.AT_START,
    Phase.PARKING: Event.PARKED,
    Phase.RUNNING: Event.ACCOMPLISHED,
}
UNDER_WAY_NS = 300 * _S  # a robot crosses any shipped arena in 20 s; many of them wait for each other
OVERRUNS = 3  # in a row: 132 ms without a command, more than a gate waits; so the wheels did stop
UNSEEN_NS = 100 * _MS  # 3 images: a hand or a cable over one tag; its robot has gone some 20 mm unseen
LOST_NS = 2 * _S  # not a hand that passes: somebody must look
LOWEST_BATTERY = 0.10  # of the charge: motors grow weak, and soon the driver's computer goes off
STALLED_NS = _S  # a motor's lag (0.25 s), and a reading as old as one may be (0.5 s)
INFEASIBLE_NS = 500 * _MS  # the filter finds answers again after some ticks, or something must be moved by hand
LEAST_FREE_BYTES = 200_000_000  # minutes of recording, and what drivers must keep
OPERATOR_NS = _S  # 5 signs of life: the terminal is gone, or its machine sleeps
ARMED_NS, ARMED_ROBOT_NS = 30 * _S, 3 * _S  # twice what the slowest checks take, and each robot's trial
HELD_NS = 120 * _S  # whoever held the run has forgotten it: it must not be resumed by chance later

_FAULTS = {
    RobotFault.UNREACHABLE: Event.UNREACHABLE,  # first: all else was true when it was lost
    RobotFault.BUMPED: Event.BUMPED,
    RobotFault.CLIFF: Event.CLIFF,
    RobotFault.WHEEL_DROPPED: Event.WHEEL_DROPPED,
    RobotFault.OVERCURRENT: Event.OVERCURRENT,
    RobotFault.CHARGING: Event.CHARGING,
}
_PRESSED = int(RobotFault.WIRED_STOP)  # a plain number: a flag's own `&` costs fifty times as much
_NAMED = sum(_FAULTS) + _PRESSED
_NOBODY = np.uint64(0)  # as a session, or as the boot of a driver
_INFEASIBLE = 2  # of RobotView.filtered
_ROUNDING_M = 1e-9
_MOST = 32  # conditions of one robot: more than its rules


BODY = np.dtype((np.record, [("radius", "<f8"), ("max_speed", "<f8"), ("elsewhere", "?")]))
_LASTING_NS = {Event.FILTER_INFEASIBLE: INFEASIBLE_NS, Event.WHEEL_STALLED: STALLED_NS}  # before they are told


@dataclass(frozen=True, kw_only=True)
class MonitorSettings:
    """What is known of the fleet beforehand; the group's robots in its order, then the bystanders."""

    build: int  # of every process
    body_radius: tuple[float, ...]  # [m]
    wheel_radius: tuple[float, ...]  # [m]
    wheel_base: tuple[float, ...]  # [m]
    arena: tuple[float, float]  # sides [m]; its centre is the origin
    max_speed: tuple[float, ...]  # [m/s]
    attended: bool  # the operator's terminal must give signs of life
    stale_ticks: int  # by the wheels' word alone from an image's exposure on: its poses are as good as none
    elsewhere: frozenset[int] = frozenset()  # rows of robots whose drivers run on computers of their own
    floors: tuple[Solid, ...] = ()  # what lies outside a floor that is a polygon

    @cached_property
    def bodies(self) -> NDArray[Any]:
        """The robots as the compiled rules read them (N,)."""
        elsewhere = [row in self.elsewhere for row in range(len(self.body_radius))]
        return np.array([*zip(self.body_radius, self.max_speed, elsewhere, strict=True)], BODY)

    @cached_property
    def outlines(self) -> Outlines:
        """The floors as the compiled rules read them."""
        return outlines(self.floors)


class MonitorState(NamedTuple):
    """What one view does not tell."""

    view: FleetView | None = None  # the one before
    phase: Phase = Phase.IDLE
    since_ns: int = 0  # when it began
    sessions: NDArray[np.uint64] = np.zeros(0, np.uint64)  # that held the robots' leases when they were proved
    lasting_ns: Mapping[tuple[Event, int], int] = MappingProxyType({})  # since when a condition holds of a robot
    rolling: Mapping[int, Rolling] = MappingProxyType({})  # of robots that are judged by their poses


def watch(
    memory: MonitorState, settings: MonitorSettings, phase: Phase, view: FleetView, *, proved: bool = False
) -> tuple[MonitorState, tuple[Happening, ...]]:
    """Return what happened since the last view and what still stands; processes first, then robot by robot.

    ``proved``: the checks of a fleet that is armed are passed, and it waits for its start.
    """
    now_ns, before = view.now_ns, memory.view or view
    rows, checking = Rows.of(view.robots).array, phase is Phase.ARMED and not proved
    started = phase in (Phase.HOLD, *MOVING) and len(memory.sessions) > 0
    sessions = memory.sessions if started else np.ascontiguousarray(rows["session"])
    since_ns = memory.since_ns if phase is memory.phase else now_ns
    (length, width), bodies = settings.arena, settings.bodies
    found = np.empty((_MOST * len(rows), 3))  # conditions: event, robot, detail
    count = _of_robots(
        found, rows, Rows.of(before.robots).array, sessions, bodies, *settings.outlines, length / 2.0, width / 2.0,
        settings.build, now_ns, int(phase), phase in MOVING,
    )  # fmt: skip
    conditions = ((Event(int(event)), int(robot), detail) for event, robot, detail in found[:count].tolist())
    lasting_ns, rolling, robots = _over_time(conditions, memory, settings, view)
    memory = MonitorState(view, phase, since_ns, sessions, lasting_ns, rolling)
    return memory, (
        *_host(before, memory, settings, view, checking=checking),
        *_controller(before, settings, phase, view),
        *_tracker(before, settings, view, checking=checking),
        *(_of_bystanders(happening, view) for happening in view.news),
        *robots,
        *sorted(Happening(*pair) for pair in _of_pairs(rows, bodies)),
    )


def _over_time(
    conditions: Iterable[tuple[Event, int, float]],
    memory: MonitorState,
    settings: MonitorSettings,
    view: FleetView,
) -> tuple[dict[tuple[Event, int], int], dict[int, Rolling], list[Happening]]:
    """Return since when conditions hold, how robots roll, and the events of what has held for long enough."""
    happenings: list[Happening] = []
    lasting_ns: dict[tuple[Event, int], int] = {}
    rolling: dict[int, Rolling] = {}
    for event, row, detail in conditions:
        if event is Event.WHEEL_STALLED and not detail:
            if row in rolling and rolling[row].stands:
                happenings.append(Happening(event, row))
        elif event in _LASTING_NS:
            lasting_ns[event, row] = since_ns = memory.lasting_ns.get((event, row), view.now_ns)
            if view.now_ns - since_ns >= _LASTING_NS[event]:
                happenings.append(Happening(event, row))
        elif event is Event.RUNAWAY:
            radius, base = settings.wheel_radius[row], settings.wheel_base[row]
            rolling[row] = runaway.watch(memory.rolling.get(row, Rolling()), view.robots[row], radius, base)
            if detail or rolling[row].runs:
                happenings.append(Happening(event, row))
        elif event is Event.ROBOT_FAULT:
            happenings += (Happening(fault, row, own) for fault, own in faults_told(int(detail)))
        elif event is Event.BEHAVIOUR_RAISED:
            happenings.append(Happening(Event(int(detail)), row))
        else:
            happenings.append(Happening(event, row, detail))
    return lasting_ns, rolling, happenings


def _host(
    before: FleetView, memory: MonitorState, settings: MonitorSettings, view: FleetView, *, checking: bool
) -> Iterator[Happening]:
    """Look at this process itself, its disk and its operator."""
    if abs(view.now_ns - before.now_ns) > SILENT_NS:
        yield Happening(Event.SUPERVISOR_STALLED)
    if settings.attended and view.now_ns - view.operator_ns > OPERATOR_NS:
        yield Happening(Event.OPERATOR_LOST)
    if view.free_bytes < LEAST_FREE_BYTES:
        yield Happening(Event.DISK_FULL)
    lasted_ns = view.now_ns - memory.since_ns
    if checking and lasted_ns > ARMED_NS + ARMED_ROBOT_NS * len(view.robots):
        yield Happening(Event.ARMED_TOO_LONG)
    if memory.phase is Phase.HOLD and lasted_ns > HELD_NS:
        yield Happening(Event.HELD_TOO_LONG)
    if memory.phase in _ARRIVALS and view.arrived == memory.phase:
        yield Happening(_ARRIVALS[memory.phase])
    elif memory.phase in (Phase.POSITIONING, Phase.PARKING) and lasted_ns > UNDER_WAY_NS:
        yield Happening(Event.UNDER_WAY_TOO_LONG)


def _controller(before: FleetView, settings: MonitorSettings, phase: Phase, view: FleetView) -> Iterator[Happening]:
    if view.controller_ns == NEVER:
        return
    if view.now_ns - view.controller_ns > SILENT_NS:
        yield Happening(Event.CONTROLLER_SILENT)
    if before.controller_epoch not in (0, view.controller_epoch):
        yield Happening(Event.CONTROLLER_RESTARTED)
    if view.controller_build != settings.build:
        yield Happening(Event.OTHER_BUILD)
    # Two single ones cannot be taken for three in a row: a view lies between them.
    if phase in MOVING and view.overruns - before.overruns >= OVERRUNS:
        yield Happening(Event.TICKS_OVERRUN, NOBODY, view.overruns - before.overruns)


def _tracker(before: FleetView, settings: MonitorSettings, view: FleetView, *, checking: bool) -> Iterator[Happening]:
    if view.tracker_ns == NEVER:
        return
    stale = view.image_tick != 0 and view.tick - view.image_tick > settings.stale_ticks
    silent = view.now_ns - view.tracker_ns > TRACKER_SILENT_NS or stale
    if silent and not checking:  # the checks wait for images, and a probed robot stands without
        yield Happening(Event.TRACKER_SILENT)
    if before.tracker_epoch not in (0, view.tracker_epoch):
        yield Happening(Event.TRACKER_RESTARTED)
    if view.tracker_build != settings.build:
        yield Happening(Event.OTHER_BUILD)


def _of_bystanders(happening: Happening, view: FleetView) -> Happening:
    """Return the tracker's news: one of a bystander that was carried ends no run."""
    moved = happening.event is Event.POSE_JUMPED and happening.robot < len(view.robots)
    bystander = moved and not view.robots[happening.robot].driven
    return happening._replace(event=Event.BYSTANDER_MOVED) if bystander else happening


def faults_told(faults: int) -> tuple[tuple[Event, float], ...]:
    """Return a robot's fault bits as events with their details; not its e-stop, which is no fault."""
    if not faults:
        return ()
    fault_events = tuple((event, 0.0) for fault, event in _FAULTS.items() if faults & fault)
    own = faults & ~_NAMED
    return (*fault_events, (Event.ROBOT_FAULT, own)) if own else fault_events


_rests, _counts, _stalls = kernel(rests), kernel(runaway.counts), kernel(runaway.stalls)


@kernel
def _of_robots(  # type: ignore[no-untyped-def] # noqa: PLR0912 - one for each rule
    found, rows, before, sessions, bodies, edges, rings, half_length, half_width, build, now_ns, phase, moving
):
    """Fill ``found`` with the conditions that hold, in the order in which they are told of a robot; return how many.

    A bystander only stands there. Its e-stop stops the run as everybody's, and so do wheels that turn by themselves;
    what else it says of itself, its driver and the arena's edge concern nobody.
    """
    n = 0
    for k in range(len(rows)):
        r, b, body = rows[k], before[k], bodies[k]
        driven, idle, counts = r.driven != 0, phase == Phase.IDLE, _counts(r)

        # its driver; a radio comes back, and then the run goes on
        reports = driven and r.heard_ns != NEVER
        if reports and now_ns - r.heard_ns > SILENT_NS:
            n = _add(found, n, Event.LINK_LOST if body.elsewhere else Event.DRIVER_SILENT, k, 0.0)
        if reports and b.boot_id not in (_NOBODY, r.boot_id):
            n = _add(found, n, Event.LINK_LOST if body.elsewhere else Event.DRIVER_RESTARTED, k, 0.0)
        if reports and r.build != build:
            n = _add(found, n, Event.OTHER_BUILD, k, 0.0)
        if reports and r.session != sessions[k]:
            gone = body.elsewhere and r.session == _NOBODY
            n = _add(found, n, Event.LINK_LOST if gone else Event.LEASE_LOST, k, 0.0)

        # what it says of itself
        # What was short is over when the status comes, but its latch stays. In IDLE the latch is what a reset clears.
        pressed = r.faults & _PRESSED != 0 or (r.latch == Latch.WIRED_STOP and not idle)
        if pressed:
            n = _add(found, n, Event.WIRED_STOP, k, 0.0)
        turns = r.latch == Latch.RUNAWAY and not (idle and _rests(r))
        if turns or (driven and not counts and r.seen_ns != NEVER):  # its poses are judged
            n = _add(found, n, Event.RUNAWAY, k, 1.0 if turns else 0.0)
        faulty = driven and r.faults & ~_PRESSED != 0
        if faulty:
            n = _add(found, n, Event.ROBOT_FAULT, k, float(r.faults))
        drilled = r.latch == Latch.DRILL and phase == Phase.ARMED
        if driven and r.latch != Latch.NONE and not (pressed or turns or faulty or drilled):
            # before a start a latch waits for its reset, and in an emergency stop it is what was asked for
            past = r.latch == Latch.EMERGENCY_STOP and not idle and phase != Phase.ESTOP
            n = _add(found, n, Event.STOPPED_AT_GATE if past else Event.GATE_LATCHED, k, float(r.latch))
        if driven and 0.0 <= r.battery < LOWEST_BATTERY:
            n = _add(found, n, Event.BATTERY_LOW, k, r.battery)

        # a pose where it cannot have driven, off by its own body: exchanged tags are further apart than that
        jump = math.hypot(r.x - b.x, r.y - b.y)
        if b.seen_ns != NEVER and jump > body.radius + body.max_speed * abs(r.seen_ns - b.seen_ns) / _S:
            n = _add(found, n, Event.POSE_JUMPED if driven else Event.BYSTANDER_MOVED, k, jump)

        # where it is; where it was seen long ago says nothing of the walls
        lost, seen = r.unseen_ns >= LOST_NS, driven and r.seen_ns != NEVER
        late = seen and not lost and (r.unseen_ns >= UNSEEN_NS or r.lost != 0)
        if seen and lost and r.camera_out != 0:  # where only that camera looks it stands, and the others drive
            n = _add(found, n, Event.CAMERA_OUT, k, r.camera_out - 1.0)
        if lost and r.camera_out == 0 and (seen or not driven):
            n = _add(found, n, Event.TAG_LOST if driven else Event.BYSTANDER_LOST, k, 0.0)
        if late:
            n = _add(found, n, Event.TAG_LATE, k, 0.0)
        if seen and not lost and not late and _is_outside(r, body, edges, rings, half_length, half_width):
            n = _add(found, n, Event.OUTSIDE_ARENA, k, 0.0)

        # what becomes of its commands
        if driven and moving and r.filtered == _INFEASIBLE:
            n = _add(found, n, Event.FILTER_INFEASIBLE, k, 0.0)
        if driven and moving and not (counts and _obeys(r)):  # of one that counts nothing the poses are judged
            n = _add(found, n, Event.WHEEL_STALLED, k, 1.0 if counts else 0.0)
        if driven and moving and r.blocked != 0:
            n = _add(found, n, Event.DEADLOCKED, k, 0.0)
        if driven and moving and r.failed != 0:
            n = _add(found, n, Event.BEHAVIOUR_RAISED, k, float(r.failed))
    return n


@kernel
def _add(found, n, event, robot, detail):  # type: ignore[no-untyped-def]
    if n >= len(found):
        raise IndexError("a robot has more conditions than there are rows")
    found[n, 0], found[n, 1], found[n, 2] = event.value, robot, detail
    return n + 1


@kernel
def _obeys(r):  # type: ignore[no-untyped-def]
    return not (_stalls(r.left_output, r.left_speed) or _stalls(r.right_output, r.right_speed))


@kernel
def _is_outside(r, body, edges, rings, half_length, half_width):  # type: ignore[no-untyped-def]
    """Whether a robot's body is beyond the arena's sides or off a floor that is a polygon."""
    off = abs(r.x) + body.radius > half_length or abs(r.y) + body.radius > half_width
    for ring in rings:
        off = off or away(edges, ring, r.x, r.y) < body.radius
    return off


@kernel
def _of_pairs(rows, bodies):  # type: ignore[no-untyped-def]
    """Yield the robots that are too close, by a sweep along x: two bystanders may be; one that is not seen now may
    still stand where it was last."""
    n, widest = len(rows), 0.0
    x = np.empty(n)
    for k in range(n):
        x[k] = rows[k].x if rows[k].seen_ns != NEVER else math.inf
        widest = max(widest, bodies[k].radius)
    order = np.empty(n, np.int64)
    for k in range(n):
        at = k
        while at > 0 and x[order[at - 1]] > x[k]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = k
    for i in range(n):
        if math.isinf(x[order[i]]):
            break
        j = i + 1
        while j < n and x[order[j]] - x[order[i]] - bodies[order[i]].radius - widest < CLOSEST_M + _ROUNDING_M:
            first, other = min(order[i], order[j]), max(order[i], order[j])
            gap = math.hypot(rows[first].x - rows[other].x, rows[first].y - rows[other].y)
            if gap - (bodies[first].radius + bodies[other].radius) < CLOSEST_M and rows[first].driven != 0:
                yield Event.TOO_CLOSE, first, float(other)
            j += 1


KERNELS = (_of_robots, _of_pairs)


def compile_kernels() -> None:
    """Compile, or load from the cache, by a look at one robot."""
    rows, bodies = np.zeros(1, ROBOT), np.zeros(1, BODY)
    _of_robots(
        np.empty((_MOST, 3)), rows, rows, np.zeros(1, np.uint64), bodies, *outlines(()), 1.0, 1.0, 0, 1, 0, False
    )
    [*_of_pairs(rows, bodies)]
