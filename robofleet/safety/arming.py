"""What is proved on the live system before a fleet starts: the checks, the e-stop drill, the wiggle.

What is missing is waited for; what is wrong for good refuses the start at once. Either way the robot is named.
A fleet that is proved waits for its start, and not for long: what was proved must still be so.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.safety import wiggle
from robofleet.safety.distances import least_room_m, room_m
from robofleet.safety.latches import Latch
from robofleet.safety.monitor import LEAST_FREE_BYTES, SILENT_NS, faults_told
from robofleet.safety.rounds import rounds, within
from robofleet.safety.starts import Reason
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import NEVER, FleetView, RobotView
from robofleet.safety.wiggle import Wiggle
from robofleet.vehicles.interface import WIRED_STOP
from robofleet.vehicles.solids import Solid, distances

_PATIENCE_NS = 5_000_000_000  # for what may still come: a lease, a tag, rest
_FRESH_NS = 150_000_000  # four images of a 30 Hz camera
_ANSWER_NS = 200_000_000  # from the e-stop to its acknowledgement
_CLEAR_NS = 1_000_000_000
_PROOF_NS = 60_000_000_000  # a minute: longer, and somebody may have carried a robot away and brought another one
_CHARGE = 0.2


class Stage(IntEnum):
    """What is done while ARMED, one after the other."""

    CHECKS = 0  # everything is there, fresh, at rest and of one build
    DRILL = 1  # every driver closes its gate by an e-stop, and is cleared again
    WIGGLE = 2  # round by round: each driver moves its own tag, forwards, as far as expected
    DONE = 3  # it waits for the start


class ArmingState(NamedTuple):
    """Where the checks are, and what they ask for now."""

    stage: Stage = Stage.CHECKS
    since_ns: int = 0  # when this stage began
    latch: Latch = Latch.NONE  # that every gate is to close by
    clear: bool = False  # every gate's drill may be cleared
    wiggle: Wiggle = Wiggle()

    def stroke(self, row: int) -> int:
        """Return the index in STROKES of what a robot must do now; 0: stand."""
        return self.wiggle.strokes[row] if row < len(self.wiggle.strokes) else wiggle.STAND


Room = Callable[[float], float]  # of a robot's wiggle, by its wheel radius [m]
Jam = Callable[[tuple[tuple[float, float, float], ...]], Reason | None]


class ArmingSettings(NamedTuple):
    """What the checks need to know of the fleet: the group's robots in its order, then the bystanders."""

    build: int
    wheel_radius: tuple[float, ...]  # [m]
    wheel_base: tuple[float, ...]  # [m]
    body_radius: tuple[float, ...]  # [m]
    arena: tuple[float, float]  # [m]
    solids: tuple[Solid, ...] = ()  # obstacles, and what lies outside the floor
    jam: Jam = lambda _: None  # who of the members, at these poses, would not get past whom; None: everybody would


def begin(now_ns: int) -> ArmingState:
    return ArmingState(since_ns=now_ns)


def step(
    state: ArmingState, settings: ArmingSettings, view: FleetView, start: bool
) -> tuple[ArmingState, Happening | None]:
    """Go on; a happening is Event.PROVED at the end, or why the fleet must not start.

    ``start``: it is to go on from the checks to the run; else it waits for that.
    """
    wrong = _wrong(settings, view)
    if wrong is not None:
        return state, wrong
    if state.stage is Stage.CHECKS:
        return _check(state, settings, view)
    if state.stage is Stage.DRILL:
        return _drill(state, settings, view)
    if state.stage is Stage.WIGGLE:
        going, happening = wiggle.step(state.wiggle, settings.wheel_radius, settings.wheel_base, view)
        if happening is not None or not going.done:
            return state._replace(wiggle=going), happening
        state = ArmingState(Stage.DONE, view.now_ns)
    if start:
        return state, Happening(Event.PROVED)
    return state, Happening(Event.NOT_STARTED) if view.now_ns - state.since_ns >= _PROOF_NS else None


def unready(settings: ArmingSettings, view: FleetView) -> Happening | None:
    """Return what keeps a fleet that waits for its start from starting now."""
    return missing(view) or _cramped(settings, view) or _jammed(settings, view)


def _wrong(settings: ArmingSettings, view: FleetView) -> Happening | None:
    """Return what waiting does not mend."""
    for heard_ns, build in ((view.controller_ns, view.controller_build), (view.tracker_ns, view.tracker_build)):
        if heard_ns != NEVER and build != settings.build:
            return Happening(Event.OTHER_BUILD)
    for row, robot in enumerate(view.robots):
        if robot.heard_ns != NEVER and (unfit := _unfit(robot, settings.build)):
            return Happening(unfit[0], row, unfit[1])
    return Happening(Event.DISK_FULL) if view.free_bytes < LEAST_FREE_BYTES else None


def _unfit(robot: RobotView, build: int) -> tuple[Event, float] | None:
    if robot.driven and robot.build != build:
        fault: tuple[Event, float] | None = (Event.OTHER_BUILD, 0.0)
    elif robot.faults & WIRED_STOP:
        fault = Event.WIRED_STOP, 0.0
    elif robot.driven and (fault_events := faults_told(robot.faults)):
        fault = fault_events[0]
    elif robot.latch > Latch.DRILL:
        fault = Event.GATE_LATCHED, robot.latch
    elif robot.driven and 0.0 <= robot.battery < _CHARGE:
        fault = Event.BATTERY_LOW, robot.battery
    else:
        fault = None
    return fault


def _check(state: ArmingState, settings: ArmingSettings, view: FleetView) -> tuple[ArmingState, Happening | None]:
    absent = missing(view)
    if absent is not None:
        drilled = any(robot.latch for robot in view.robots)  # by a start that was broken off
        waited = view.now_ns - state.since_ns >= _PATIENCE_NS
        return state._replace(clear=drilled), absent if waited else None
    misplaced = _cramped(settings, view) or _jammed(settings, view)
    if misplaced is not None:
        return state, misplaced
    return ArmingState(Stage.DRILL, view.now_ns, Latch.DRILL), None


def missing(view: FleetView) -> Happening | None:
    """Return who is not heard, not seen, not ours, latched or not at rest: what may still come, the gravest first."""
    now_ns = view.now_ns
    if _silent(now_ns, view.controller_ns):
        return Happening(Event.CONTROLLER_SILENT)
    if _silent(now_ns, view.tracker_ns):
        return Happening(Event.TRACKER_SILENT)
    if view.cameras_out:
        return view.cameras_out[0]._replace(event=Event.CAMERA_OUT)
    rows = list(enumerate(view.robots))
    checks = (
        (Event.DRIVER_SILENT, lambda r: r.driven and now_ns - r.heard_ns >= SILENT_NS),
        (Event.TAG_LOST, lambda r: max(now_ns - r.seen_ns, r.unseen_ns) >= _FRESH_NS),
        (Event.LEASE_LOST, lambda r: r.driven and (not r.session or r.session != view.robots[0].session)),
        (Event.GATE_LATCHED, lambda r: r.latch != Latch.NONE),
        (Event.NOT_AT_REST, lambda r: not r.at_rest),
    )
    return next((Happening(event, row) for event, fails in checks for row, robot in rows if fails(robot)), None)


def _silent(now_ns: int, heard_ns: int) -> bool:
    return now_ns - heard_ns >= SILENT_NS


def _cramped(settings: ArmingSettings, view: FleetView, room: Room = least_room_m) -> Happening | None:
    """Return who stands outside, or where a wiggle that goes wrong may end at somebody, at a wall or at an obstacle.

    A bystander does not wiggle: it may stand at the wall, beyond it, and beside another one.
    """
    at, free = np.array([robot.pose[:2] for robot in view.robots]), _free(settings, view, room)
    bodies, floor = np.array(settings.body_radius), [solid.floor for solid in settings.solids]
    away = distances(settings.solids, at) - bodies
    walls = (np.array(settings.arena) / 2.0 - np.abs(at)).min(axis=1) - bodies
    edges = np.vstack([walls, away[floor]]).min(axis=0)
    beside = (np.vstack([edges, away]).min(axis=0) < free)[: view.driven]
    if beside.any():
        row = int(beside.argmax())
        return Happening(Event.OUTSIDE_ARENA, row) if edges[row] < 0.0 else Happening(Event.TOO_CLOSE, row, NOBODY)
    pairs, gaps = _gaps(settings, view, free)
    close = (gaps < free[pairs].max(axis=1)) & (pairs[:, 0] < view.driven)
    return Happening(Event.TOO_CLOSE, *map(int, pairs[close.argmax()])) if close.any() else None


def _begin_wiggle(settings: ArmingSettings, view: FleetView) -> Wiggle:
    """Return its first state: along an arc where all have the room, else on the spot."""
    on_the_spot = _cramped(settings, view, room_m) is not None
    apart = _rounds(settings, view, least_room_m if on_the_spot else room_m)
    return wiggle.begin(view, apart, on_the_spot=on_the_spot)


def _rounds(settings: ArmingSettings, view: FleetView, room: Room) -> tuple[tuple[int, int], ...]:
    """Return in which rounds each robot wiggles: two that have no room for both never at once."""
    free = _free(settings, view, room)
    pairs, gaps = _gaps(settings, view, free)
    close = (gaps < free[pairs].sum(axis=1)) & (pairs[:, 1] < view.driven)
    return rounds(view.driven, pairs[close].tolist())


def _free(settings: ArmingSettings, view: FleetView, room: Room) -> NDArray[np.float64]:
    """Return the room that each robot's wiggle must have: none, where it does not wiggle [m]."""
    driven = view.driven
    return np.array([room(radius) if row < driven else 0.0 for row, radius in enumerate(settings.wheel_radius)])


def _gaps(
    settings: ArmingSettings, view: FleetView, free: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the pairs of robots (K, 2) that may have no room for both, and the gaps between their bodies (K,) [m]."""
    at, bodies = np.array([robot.pose[:2] for robot in view.robots]), np.array(settings.body_radius)
    pairs = within(at, 2.0 * float(bodies.max() + free.max()))
    return pairs, np.hypot(*(at[pairs[:, 0]] - at[pairs[:, 1]]).T) - bodies[pairs].sum(axis=1)


def _jammed(settings: ArmingSettings, view: FleetView) -> Happening | None:
    """Return who would not get past whom on the way to their places."""
    why = settings.jam(tuple(robot.pose for robot in view.robots[: view.driven]))
    if why is None:
        return None
    if why.order is None:
        return Happening(Event.WAYS_CROSS, why.other, why.behind)
    return Happening(Event.WRONG_ORDER, why.behind, why.other)


def _drill(state: ArmingState, settings: ArmingSettings, view: FleetView) -> tuple[ArmingState, Happening | None]:
    """The e-stop, tried on all at once: every gate shows it, then none does."""
    waited_ns = view.now_ns - state.since_ns
    latched = [bool(robot.latch) for robot in view.robots[: view.driven]]
    if state.latch:
        if all(latched):
            return ArmingState(Stage.DRILL, view.now_ns, clear=True), None
        late = waited_ns >= _ANSWER_NS
        return state, Happening(Event.ESTOP_UNANSWERED, latched.index(False)) if late else None
    if not any(latched):
        return ArmingState(Stage.WIGGLE, view.now_ns, wiggle=_begin_wiggle(settings, view)), None
    late = waited_ns >= _CLEAR_NS
    return state, Happening(Event.GATE_LATCHED, latched.index(True), Latch.DRILL) if late else None
