"""The wiggle: a short arc, forth and back, which proves that this driver moves this tag, and how far.

Many robots wiggle at once, in rounds (``rounds.py``): in a round some do one stroke, and all others must stand.
A stroke tells the wheels apart (``rolled.py``). It is short in time and room, and both end where the first began. A tag
that moves though its robot must stand stops everybody at once; who moved it is told by where all have come to rest.

Where some robot has no room for the arc, all turn on the spot instead: an exchange makes one robot do another one's
stroke. A healthy robot hardly leaves its place then; one of whose wheels is stuck or reversed leaves it slowly, and is
stopped. The slower and shorter stroke needs more images for the same certainty.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.safety.rolled import Leg, Pose, Wheels, gain_fault, mean_of, rolled, wiring_fault
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import FleetView, RobotView


class Stroke(NamedTuple):
    """What a robot that is tried is asked to do: shares of the probing speed."""

    left: float
    right: float

    @property
    def on_the_spot(self) -> bool:
        """Whether the wheels turn against each other."""
        return self.left * self.right < 0.0


PROBE_RAD_S = 6.0
STROKES = (
    Stroke(0.0, 0.0),
    Stroke(1.0, 0.6),
    Stroke(-1.0, -0.6),
    Stroke(-0.7, 1.0),
    Stroke(0.7, -1.0),
)  # stand; an arc forth, and back; a turn to the left, and back
STAND, FORTH, BACK, LEFT, RIGHT = range(5)

_STROKE_NS = 240_000_000  # six periods of the supervisor
_TURN_M, _TURN_M_S = 0.012, 0.016  # what a wheel rolls on the spot, and how fast: the barrier lets robots creep so
_TURN_NS = round(_TURN_M / _TURN_M_S * 1e9)
_IMAGES, _TURN_IMAGES = 3, 12  # of a robot that stands
_SETTLE_NS = 100_000_000  # after a stroke's end: no command of it is on its way any more
_COAST_NS = 400_000_000  # of a robot that cannot tell whether its wheels rest
_NO_START_NS = 1_000_000_000
_NO_REST_NS = 2_000_000_000
_NO_IMAGE_NS = 2_000_000_000
_MOVED_M, _MOVED_RAD = 0.006, 0.05  # of a robot that stands: ten sigmas of noise, a third of what a stroke gives
_STILL = 1.0 / 3.0  # a tag that rolled less of what its robot's wheels were told was not moved by them
_MOST = 1.5  # of what a stroke should take it: then the wiggle is stopped at once
_TURN_MOVED_M = 0.002  # and so much more on the spot: six sigmas of noise
_SILENT_RAD = 1e-3  # a wheel that counted less counted nothing


class Means(NamedTuple):
    """Poses of robots that stand, a row a robot: the mean of so many images."""

    images: NDArray[np.int64]  # (N,)
    poses: Array  # (N, 3): x, y [m], psi [rad]; world

    @classmethod
    def none(cls, robots: int) -> "Means":
        """Return the means of no image."""
        return cls(np.zeros(robots, dtype=np.int64), np.zeros((robots, 3)))

    def add(self, poses: Array, rows: NDArray[np.bool_]) -> "Means":
        """Return the means with one image more of some robots."""
        images = self.images + rows
        step = poses - self.poses
        step[:, 2] = _wrapped(step[:, 2])
        return Means(images, self.poses + step * (rows / np.maximum(images, 1))[:, None])

    def forget(self, rows: Sequence[int]) -> "Means":
        """Return the means without what was seen of some robots."""
        images = self.images.copy()
        images[rows] = 0
        return Means(images, self.poses)

    def moved(self, poses: Array) -> NDArray[np.bool_]:
        """Return which robots are seen elsewhere, of those whose mean is known."""
        step = poses - self.poses
        away = (np.hypot(step[:, 0], step[:, 1]) > _MOVED_M) | (np.abs(_wrapped(step[:, 2])) > _MOVED_RAD)
        return (self.images > 0) & away


class Start(NamedTuple):
    """A robot at the beginning of its stroke."""

    pose: Pose
    angles: Wheels  # as its encoders counted [rad]
    commanded: Wheels  # how far the wheels had been told to turn [rad]


@dataclass(frozen=True, eq=False)
class Wiggle:
    """Where the wiggle is. Instants on the supervisor's clock [ns]."""

    rounds: tuple[tuple[int, int], ...] = ()  # of each driven robot: when it goes forth, and when back
    on_the_spot: bool = False  # all turn instead of going along an arc
    round: int = -1  # below 0 all are looked at first
    strokes: tuple[int, ...] = ()  # of each driven robot: index in STROKES of what it must do now
    tried: Mapping[int, Start] = field(default_factory=dict)  # in this round
    means: Means = field(default_factory=lambda: Means.none(0))
    image: int = 0  # number of the newest that was looked at
    since_ns: int = 0  # when the round began to drive, to slow down or to stand
    rest_tick: int | None = None  # newest tick when all who are tried were seen at rest
    forth: Mapping[int, Leg] = field(default_factory=dict)  # of those that were tried once
    strange: int = NOBODY  # whose tag moved though it was to stand; then nobody goes on
    stood: Means | None = None  # where all were before that

    @property
    def done(self) -> bool:
        """Whether everybody has wiggled."""
        return self.round > max((back for _, back in self.rounds), default=-1)


def probe_speeds(stroke: int, wheel_radius: float) -> Wheels:
    """Return how fast a stroke asks the wheels of a robot to turn [rad/s]."""
    shares = STROKES[stroke]
    speed = min(PROBE_RAD_S, _TURN_M_S / wheel_radius) if shares.on_the_spot else PROBE_RAD_S
    return shares.left * speed, shares.right * speed


def travel_m(wheel_radius: float, stroke: int = FORTH) -> float:
    """Return how far a stroke takes a robot [m]."""
    return wheel_radius * abs(sum(probe_speeds(stroke, wheel_radius))) / 2.0 * _time_ns(stroke) * 1e-9


def room_m(wheel_radius: float, stroke: int = FORTH) -> float:
    """Return how far a robot may get before the wiggle is stopped [m]."""
    more = _TURN_MOVED_M if STROKES[stroke].on_the_spot else _MOVED_M
    return _MOST * travel_m(wheel_radius, stroke) + more


def _time_ns(stroke: int) -> int:
    return _TURN_NS if STROKES[stroke].on_the_spot else _STROKE_NS


def begin(view: FleetView, rounds: tuple[tuple[int, int], ...], *, on_the_spot: bool = False) -> Wiggle:
    """Return the first state: everybody stands and is looked at. ``rounds`` are those of each driven robot."""
    n = len(view.robots)
    return Wiggle(
        rounds, on_the_spot, strokes=(STAND,) * len(rounds), means=Means.none(n), since_ns=view.now_ns,
        rest_tick=view.tick,
    )  # fmt: skip


def step(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView
) -> tuple[Wiggle, Happening | None]:
    """Go on; a happening is why the fleet must not start."""
    if view.image != state.image:
        poses = _poses(view)
        bad = _bad_sign(state, wheel_radius, wheel_base, view, poses)
        if bad is not None:
            return state, bad
        state = _look(_watch(state, view, poses), view, poses)
    if any(state.strokes):
        return _drive(state, wheel_radius, view)
    if state.rest_tick is None:
        return _slow_down(state, wheel_radius, wheel_base, view)
    return _stand(state, wheel_radius, wheel_base, view)


def _poses(view: FleetView) -> Array:
    return np.array([robot.pose for robot in view.robots])


def _bad_sign(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView, poses: Array
) -> Happening | None:
    """Return what the newest image says against going on."""
    stroke = LEFT if state.on_the_spot else FORTH
    for row, start in state.tried.items():
        travelled = math.dist(poses[row, :2], start.pose[:2])
        if travelled > room_m(wheel_radius[row], stroke):
            wrong = Event.WRONG_GAIN, travelled / travel_m(wheel_radius[row], stroke)
            if state.on_the_spot:  # only a wheel that does not turn as it was told takes a robot far
                leg = _leg(start, view.robots[row], poses[row], wheel_radius[row], wheel_base[row])
                wrong = wiring_fault(leg) or wrong
            return Happening(wrong[0], row, wrong[1])
    if state.stood is not None:
        row = state.strange
        if math.dist(poses[row, :2], state.stood.poses[row, :2]) > room_m(wheel_radius[row], stroke):
            return _blamed(state, wheel_radius, wheel_base, view)
    if state.round < 0 and (moved := state.means.moved(poses)).any():
        return Happening(Event.NOT_AT_REST, int(moved.argmax()))
    return None


def _watch(state: Wiggle, view: FleetView, poses: Array) -> Wiggle:
    """Stop everybody if the tag of somebody moves who must stand."""
    if state.strange != NOBODY:
        return state
    moved = state.means.moved(poses)
    moved[list(state.tried)] = False
    if not moved.any():
        return state
    return replace(
        state, strange=int(moved.argmax()), stood=state.means, strokes=(STAND,) * len(state.strokes),
        since_ns=view.now_ns, rest_tick=None,
    )  # fmt: skip


def _look(state: Wiggle, view: FleetView, poses: Array) -> Wiggle:
    """Take the newest image's poses of all who stand: of those that are tried, only after they were seen at rest."""
    seen = np.array([robot.image == view.image for robot in view.robots])
    if state.rest_tick is None or view.image_tick <= state.rest_tick:
        some = state.tried and state.strange == NOBODY
        seen[list(state.tried) if some else slice(None)] = False
    return replace(state, means=state.means.add(poses, seen), image=view.image)


def _drive(state: Wiggle, wheel_radius: tuple[float, ...], view: FleetView) -> tuple[Wiggle, Happening | None]:
    """Until the stroke's time is over; whom commands reach late gets more of it."""
    driven_ns, stroke = view.now_ns - state.since_ns, LEFT if state.on_the_spot else FORTH
    if driven_ns < _time_ns(stroke):
        return state, None
    strokes = list(state.strokes)
    for row, start in state.tried.items():
        fastest = max(map(abs, probe_speeds(stroke, wheel_radius[row])))
        if max(map(abs, _asked(start, view.robots[row]))) >= 0.5 * fastest * _time_ns(stroke) * 1e-9:
            strokes[row] = STAND
    if any(strokes):
        late = next(row for row, stroke in enumerate(strokes) if stroke)
        fault = Happening(Event.LEASE_LOST, late) if driven_ns >= _NO_START_NS else None
        return replace(state, strokes=tuple(strokes)), fault
    return replace(state, strokes=tuple(strokes), since_ns=view.now_ns), None


def _slow_down(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView
) -> tuple[Wiggle, Happening | None]:
    """Until the wheels of all who are tried rest."""
    waited_ns, strange = view.now_ns - state.since_ns, state.strange != NOBODY
    turning = (row for row, start in state.tried.items() if not _rests(start, view.robots[row], waited_ns))
    row = next(turning, None)
    if row is None:
        stale = range(len(view.robots)) if strange else state.tried
        return replace(state, since_ns=view.now_ns, rest_tick=view.tick, means=state.means.forget(list(stale))), None
    if waited_ns < _NO_REST_NS:
        return state, None
    if strange:
        return state, _blamed(state, wheel_radius, wheel_base, view)
    return state, Happening(Event.NOT_AT_REST, row)


def _rests(start: Start, robot: RobotView, waited_ns: int) -> bool:
    needed_ns = _SETTLE_NS if any(_counted(start, robot)) else _COAST_NS
    return robot.at_rest and waited_ns >= needed_ns


def _stand(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView
) -> tuple[Wiggle, Happening | None]:
    """Until there are images enough; then judge, and go on with the next round."""
    few = state.means.images < (_TURN_IMAGES if state.on_the_spot else _IMAGES)
    late, strange = view.now_ns - state.since_ns >= _NO_IMAGE_NS, state.strange != NOBODY
    if strange and (late or not few.any()):
        return state, _blamed(state, wheel_radius, wheel_base, view)
    if few.any():
        return state, Happening(Event.TAG_LOST, int(few.argmax())) if late else None
    forth = dict(state.forth)
    for row, start in sorted(state.tried.items()):
        leg = _leg(start, view.robots[row], state.means.poses[row], wheel_radius[row], wheel_base[row])
        fault = wiring_fault(leg)
        if row in forth:
            fault = fault or gain_fault(mean_of(forth.pop(row), leg))
        else:
            forth[row] = leg
        if fault is not None:
            return state, Happening(fault[0], row, fault[1])
    return _next(replace(state, forth=forth), view), None


def _next(state: Wiggle, view: FleetView) -> Wiggle:
    """Begin the next round."""
    this = state.round + 1
    first, last = (LEFT, RIGHT) if state.on_the_spot else (FORTH, BACK)
    strokes = tuple(first if this == forth else last if this == back else STAND for forth, back in state.rounds)
    tried = {row: _start(state, row, view.robots[row]) for row, stroke in enumerate(strokes) if stroke}
    return replace(state, round=this, strokes=strokes, tried=tried, since_ns=view.now_ns, rest_tick=None)


def _start(state: Wiggle, row: int, robot: RobotView) -> Start:
    x, y, psi = state.means.poses[row].tolist()
    return Start((x, y, psi), (robot.left_angle, robot.right_angle), (robot.left_told, robot.right_told))


def _leg(start: Start, robot: RobotView, pose: Array, radius: float, base: float) -> Leg:
    x, y, psi = pose.tolist()
    return Leg(_asked(start, robot), _counted(start, robot), rolled(start.pose, (x, y, psi), radius, base))


def _asked(start: Start, robot: RobotView) -> Wheels:
    return robot.left_told - start.commanded[0], robot.right_told - start.commanded[1]


def _counted(start: Start, robot: RobotView) -> Wheels:
    left, right = robot.left_angle - start.angles[0], robot.right_angle - start.angles[1]
    return (left, right) if max(abs(left), abs(right)) > _SILENT_RAD else (0.0, 0.0)


def _blamed(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView
) -> Happening:
    """Return who moves the tag that was to stand; where that is not sure, whose tag it is.

    Robots whose tags are exchanged did the same in every round before, or they had been found out then. So had a robot
    that follows another one's commands, unless it was tried in every round in which that one was.
    """
    assert state.stood is not None
    known = (state.means.images > 0) & (state.rest_tick is not None)
    seen = np.where(known[:, None], state.means.poses, _poses(view))
    moved = state.stood.moved(seen)
    moved[list(state.tried)] = False
    still = [
        row for row, start in state.tried.items()
        if _still(start, view.robots[row], seen[row], wheel_radius[row], wheel_base[row])
    ]  # fmt: skip
    for tag in (state.strange, *np.flatnonzero(moved).tolist()):
        before = _before(state, tag)
        if still:
            who = [row for row in still if _before(state, row) == before]
        else:
            who = [row for row in state.tried if _before(state, row) <= before]
        if len(who) == 1:
            return Happening(Event.WRONG_TAG_MOVED, who[0], tag)
    return Happening(Event.MOVED_UNASKED, state.strange)


def _still(start: Start, robot: RobotView, pose: Array, radius: float, base: float) -> bool:
    """Return whether a robot's tag stood although its wheels were told to turn, whichever turned, and which way."""
    commanded = max(map(abs, _asked(start, robot)))
    x, y, psi = pose.tolist()
    return (
        commanded * radius > _MOVED_M
        and max(map(abs, rolled(start.pose, (x, y, psi), radius, base))) < _STILL * commanded
    )


def _before(state: Wiggle, row: int) -> frozenset[int]:
    """Return in which rounds before this one a robot was tried."""
    own = state.rounds[row] if row < len(state.rounds) else ()  # a bystander in none
    return frozenset(candidate for candidate in own if candidate < state.round)


def _wrapped(angles: Array) -> Array:
    """Return angles in [-pi, pi) [rad]."""
    return np.asarray((angles + math.pi) % math.tau - math.pi)
