"""What the supervisor makes of what it sees: a fleet's view becomes events of the run. No I/O.

An event is told again as long as what it tells of lasts, so a run cannot be resumed into it. Only changes are told
once: a restart, ticks that were overrun, the tracker's news.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import combinations
from math import hypot
from typing import NamedTuple

import numpy as np

from robofleet.safety import runaway
from robofleet.safety.distances import CLOSEST_M
from robofleet.safety.gate import Latch
from robofleet.safety.runaway import Rolling
from robofleet.safety.supervisor import MOVING, NOBODY, Event, Happening, Phase
from robofleet.safety.view import NEVER, FleetView, RobotView
from robofleet.vehicles.interface import RobotFault
from robofleet.vehicles.solids import Solid, distances

_MS = 1_000_000
_S = 1_000_000_000

SILENT_NS = 500 * _MS  # 25 statuses or 15 ticks: a process or its network; the gates closed after 120 ms
TRACKER_SILENT_NS = 250 * _MS  # 7 images: every robot is driven by its wheels' word alone, some 50 mm by now
STALE_TICKS = 15  # an image that knows no newer tick was held back: the controller does not use it
_ARRIVALS = {
    Phase.POSITIONING: Event.AT_START,
    Phase.PARKING: Event.PARKED,
    Phase.RUNNING: Event.ACCOMPLISHED,
}
UNDER_WAY_NS = 300 * _S  # a robot crosses any shipped arena in 20 s; many of them wait for each other
OVERRUNS = 3  # in a row: 132 ms without a command, more than a gate waits; so the wheels did stop
LATE_NS = 100 * _MS  # 3 images: a hand or a cable over one tag; its robot has gone some 20 mm unseen
LOST_NS = 2 * _S  # not a hand that passes: somebody must look
LOWEST_BATTERY = 0.10  # of the charge: motors grow weak, and soon the driver's computer goes off
STALLED_RAD_S = 2.0  # of a command: three times what a wheel of the worst shipped robot needs to start from rest
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


class MonitorSettings(NamedTuple):
    """What is known of the fleet beforehand; the group's robots in its order, then the bystanders."""

    build: int  # of every process
    body_radius: tuple[float, ...]  # [m]
    arena: tuple[float, float]  # sides [m]; its centre is the origin
    max_speed: tuple[float, ...]  # [m/s]
    attended: bool  # the operator's terminal must give signs of life
    elsewhere: frozenset[int] = frozenset()  # rows of robots whose drivers run on computers of their own
    floors: tuple[Solid, ...] = ()  # what lies outside a floor that is a polygon


class MonitorState(NamedTuple):
    """What one view does not tell."""

    view: FleetView | None = None  # the one before
    phase: Phase = Phase.IDLE
    since_ns: int = 0  # when it began
    sessions: tuple[int, ...] = ()  # that held the robots' leases when they were proved
    infeasible_ns: tuple[int, ...] = ()  # since when the filter finds no answer; NEVER: it does
    stalled_ns: tuple[int, ...] = ()  # since when a wheel stands that is told to turn; NEVER: none does
    rolling: tuple[Rolling, ...] = ()  # of robots that are told to stand


class Suspects(NamedTuple):
    """Where something may be wrong in a view. Who is not named here is well."""

    robots: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]  # that may be too close, in the order of their rows
    infeasible: bool  # the filter finds no answer for some robot, or found none before
    stalled: bool  # a wheel of some robot stands that is told to turn
    rolling: bool  # some robot without encoders is told to stand


def watch(
    memory: MonitorState, settings: MonitorSettings, phase: Phase, view: FleetView, *, proved: bool = False,
    suspects: Suspects | None = None,
) -> tuple[MonitorState, tuple[Happening, ...]]:  # fmt: skip
    """Return what happened since the last view and what still stands; processes first, then robot by robot.

    ``proved``: the checks of a fleet that is armed are passed, and it waits for its start. ``suspects``: where to look;
    None: everywhere.
    """
    now_ns, before, count = view.now_ns, memory.view or view, len(view.robots)
    running, checking = phase in MOVING, phase is Phase.ARMED and not proved
    infeasible_ns: tuple[int, ...] = ()
    stalled_ns: tuple[int, ...] = ()
    if running and (suspects is None or suspects.infeasible):
        infeasible_ns = _since(memory.infeasible_ns, view, lambda robot: robot.filtered == 2)
    if running and (suspects is None or suspects.stalled):
        stalled_ns = _since(memory.stalled_ns, view, _stalled)
    started = phase in (Phase.HOLD, *MOVING)
    sessions = memory.sessions if started and memory.sessions else tuple(robot.session for robot in view.robots)
    rolling: tuple[Rolling, ...] = ()
    if suspects is None or suspects.rolling:
        radii = settings.body_radius
        rolling = tuple(map(runaway.watch, memory.rolling or (Rolling(),) * count, view.robots, radii))
    since_ns = memory.since_ns if phase is memory.phase else now_ns
    memory = MonitorState(view, phase, since_ns, sessions, infeasible_ns, stalled_ns, rolling)
    happenings = [
        *_host(before, memory, settings, view, checking=checking),
        *_controller(before, settings, phase, view),
        *_tracker(before, settings, view, checking=checking),
        *(_told(happening, view) for happening in view.news),
    ]
    for row in range(count) if suspects is None else suspects.robots:
        robot = view.robots[row]
        if not robot.driven:
            happenings += _bystander(row, before.robots[row], robot, settings, phase)
            continue
        driver_events = _driver(row, before.robots[row], sessions[row], settings.build, robot, now_ns)
        happenings += _over_the_network(driver_events, robot) if row in settings.elsewhere else driver_events
        happenings += _body(row, robot, phase, runs=bool(rolling) and rolling[row].runs)
        happenings += _jump(row, before.robots[row], robot, settings)
        happenings += _place(row, robot, settings)
        if infeasible_ns and infeasible_ns[row] and now_ns - infeasible_ns[row] >= INFEASIBLE_NS:
            happenings.append(Happening(Event.FILTER_INFEASIBLE, row))
        if stalled_ns and stalled_ns[row] and now_ns - stalled_ns[row] >= STALLED_NS:
            happenings.append(Happening(Event.WHEEL_STALLED, row))
        if running and robot.blocked:
            happenings.append(Happening(Event.DEADLOCKED, row))
        if running and robot.failed:
            happenings.append(Happening(Event(robot.failed), row))
    return memory, (*happenings, *_neighbours(settings, view, None if suspects is None else suspects.pairs))


def _since(before_ns: tuple[int, ...], view: FleetView, lasts: Callable[[RobotView], bool]) -> tuple[int, ...]:
    """Return since when something lasts, of each robot; NEVER: it does not."""
    known = zip(before_ns or (NEVER,) * len(view.robots), view.robots, strict=True)
    return tuple((at_ns or view.now_ns) if lasts(robot) else NEVER for at_ns, robot in known)


def _stalled(robot: RobotView) -> bool:
    """Return whether a wheel stands that is told to turn; of a robot that counts nothing nobody knows it."""
    counts = robot.left_angle or robot.right_angle or robot.left_speed or robot.right_speed
    wheels = (robot.left_output, robot.left_speed), (robot.right_output, robot.right_speed)
    stands = any(abs(commanded) >= STALLED_RAD_S and abs(seen) <= runaway.TURNING_RAD_S for commanded, seen in wheels)
    return bool(counts) and stands


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
    stale = view.image_tick != 0 and view.tick - view.image_tick > STALE_TICKS
    silent = view.now_ns - view.tracker_ns > TRACKER_SILENT_NS or stale
    if silent and not checking:  # the checks wait for images, and a probed robot stands without
        yield Happening(Event.TRACKER_SILENT)
    if before.tracker_epoch not in (0, view.tracker_epoch):
        yield Happening(Event.TRACKER_RESTARTED)
    if view.tracker_build != settings.build:
        yield Happening(Event.OTHER_BUILD)


def _driver(
    row: int, before: RobotView, session: int, build: int, robot: RobotView, now_ns: int
) -> Iterator[Happening]:
    if robot.heard_ns == NEVER:
        return
    if now_ns - robot.heard_ns > SILENT_NS:
        yield Happening(Event.DRIVER_SILENT, row)
    if before.boot_id not in (0, robot.boot_id):
        yield Happening(Event.DRIVER_RESTARTED, row)
    if robot.build != build:
        yield Happening(Event.OTHER_BUILD, row)
    if robot.session != session:
        yield Happening(Event.LEASE_LOST, row)


def _over_the_network(happenings: Iterable[Happening], robot: RobotView) -> Iterator[Happening]:
    """Take silence of a computer of its own for what it is: a radio comes back, and then the run goes on."""
    for happening in happenings:
        nobody = happening.event is Event.LEASE_LOST and robot.session == 0
        away = nobody or happening.event in (Event.DRIVER_SILENT, Event.DRIVER_RESTARTED)
        yield happening._replace(event=Event.LINK_LOST) if away else happening


def _body(row: int, robot: RobotView, phase: Phase, *, runs: bool) -> Iterator[Happening]:
    """Look at what a robot says of itself; ``runs``: by its poses it rolls though it is told to stand."""
    pressed = _pressed(robot, phase)
    if pressed:
        yield Happening(Event.WIRED_STOP, row)
    turns = _turns(robot, phase)
    if turns or runs:
        yield Happening(Event.RUNAWAY, row)
    causes = faults_told(robot.faults)
    yield from (Happening(event, row, detail) for event, detail in causes)
    if robot.latch and not (pressed or turns or causes or (robot.latch == Latch.DRILL and phase is Phase.ARMED)):
        # before a start a latch waits for its reset, and in an emergency stop it is what was asked for
        past = robot.latch == Latch.EMERGENCY_STOP and phase not in (Phase.IDLE, Phase.ESTOP)
        yield Happening(Event.STOPPED_AT_GATE if past else Event.GATE_LATCHED, row, robot.latch)
    if 0.0 <= robot.battery < LOWEST_BATTERY:
        yield Happening(Event.BATTERY_LOW, row, robot.battery)


def _pressed(robot: RobotView, phase: Phase) -> bool:
    """Return whether a robot's own e-stop is pressed."""
    # What was short is over when the status comes, but its latch stays. In IDLE the latch is what a reset clears.
    return bool(robot.faults & _PRESSED) or (robot.latch == Latch.WIRED_STOP and phase is not Phase.IDLE)


def _turns(robot: RobotView, phase: Phase) -> bool:
    """Return whether a robot's gate has latched as a wheel turned by itself."""
    return robot.latch == Latch.RUNAWAY and (phase is not Phase.IDLE or not robot.at_rest)


def _told(happening: Happening, view: FleetView) -> Happening:
    """Return the tracker's word: one of a bystander that was carried ends no run."""
    moved = happening.event is Event.POSE_JUMPED and happening.robot < len(view.robots)
    bystander = moved and not view.robots[happening.robot].driven
    return happening._replace(event=Event.BYSTANDER_MOVED) if bystander else happening


def _bystander(
    row: int, before: RobotView, robot: RobotView, settings: MonitorSettings, phase: Phase
) -> Iterator[Happening]:
    """Look at a robot that only stands there. Its e-stop stops the run as everybody's, and so do wheels that turn by
    themselves; what else it says of itself, its driver and the arena's edge concern nobody."""
    if _pressed(robot, phase):
        yield Happening(Event.WIRED_STOP, row)
    if _turns(robot, phase):
        yield Happening(Event.RUNAWAY, row)
    for jumped in _jump(row, before, robot, settings):
        yield jumped._replace(event=Event.BYSTANDER_MOVED)
    if robot.unseen_ns >= LOST_NS and not robot.camera_out:
        yield Happening(Event.BYSTANDER_LOST, row)


def faults_told(faults: int) -> tuple[tuple[Event, float], ...]:
    """Return a robot's fault bits as events with their details; not its e-stop, which is no fault."""
    if not faults:
        return ()
    fault_events = tuple((event, 0.0) for fault, event in _FAULTS.items() if faults & fault)
    own = faults & ~_NAMED
    return (*fault_events, (Event.ROBOT_FAULT, own)) if own else fault_events


def _jump(row: int, before: RobotView, robot: RobotView, settings: MonitorSettings) -> Iterator[Happening]:
    """Notice a place where it cannot have driven, off by its own body: exchanged tags are further apart than that."""
    if before.seen_ns == NEVER:
        return
    (x, y, _), (x_before, y_before, _) = robot.pose, before.pose
    jump = hypot(x - x_before, y - y_before)
    driven = settings.max_speed[row] * abs(robot.seen_ns - before.seen_ns) / _S
    if jump > settings.body_radius[row] + driven:
        yield Happening(Event.POSE_JUMPED, row, jump)


def _place(row: int, robot: RobotView, settings: MonitorSettings) -> Iterator[Happening]:
    """Look at where a robot is; where it was seen long ago says nothing of the walls."""
    if robot.seen_ns == NEVER:
        return
    if robot.unseen_ns >= LOST_NS:
        out = robot.camera_out  # where only that one looks it is not lost: it stands, and the others drive
        yield Happening(Event.CAMERA_OUT, row, out - 1) if out else Happening(Event.TAG_LOST, row)
    elif robot.unseen_ns >= LATE_NS or robot.lost:
        yield Happening(Event.TAG_LATE, row)
    else:
        (x, y, _), (length, width), radius = robot.pose, settings.arena, settings.body_radius[row]
        off = bool(settings.floors) and distances(settings.floors, np.array([(x, y)])).min() < radius
        if abs(x) + radius > length / 2 or abs(y) + radius > width / 2 or off:
            yield Happening(Event.OUTSIDE_ARENA, row)


def _neighbours(
    settings: MonitorSettings, view: FleetView, pairs: Iterable[tuple[int, int]] | None
) -> Iterator[Happening]:
    """Look at every two robots but two bystanders; one that is not seen now may still stand where it was last."""
    if pairs is None:
        pairs = combinations((row for row, robot in enumerate(view.robots) if robot.seen_ns != NEVER), 2)
    for first, other in pairs:
        if not view.robots[first].driven:
            break  # it and all who follow are bystanders
        (x, y, _), (other_x, other_y, _) = view.robots[first].pose, view.robots[other].pose
        bodies = settings.body_radius[first] + settings.body_radius[other]
        if hypot(x - other_x, y - other_y) - bodies < CLOSEST_M:
            yield Happening(Event.TOO_CLOSE, first, other)
