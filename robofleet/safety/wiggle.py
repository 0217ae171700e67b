"""The wiggle: robot by robot a short arc, forth and back, which proves that this driver moves this tag, and how far.

One arc tells the wheels apart (``rolled.py``). It is short in time and room, and ends where it began.
"""

import math
from typing import NamedTuple

from robofleet.safety.rolled import Leg, Pose, Wheels, gain_fault, mean_of, rolled, wiring_fault
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import FleetView, RobotView


class Stroke(NamedTuple):
    """What a probed robot is asked to do: shares of the probing speed."""

    left: float
    right: float


PROBE_RAD_S = 6.0
STROKES = (Stroke(0.0, 0.0), Stroke(1.0, 0.6), Stroke(-1.0, -0.6))  # stand, forth, back
FORTH, BACK = 1, 2

_STROKE_NS = 240_000_000  # six periods of the supervisor
_IMAGES = 3  # of a robot that stands
_SETTLE_NS = 100_000_000  # after a stroke's end: no command of it is on its way any more
_COAST_NS = 400_000_000  # of a robot that cannot tell whether its wheels rest
_NO_START_NS = 1_000_000_000
_NO_REST_NS = 2_000_000_000
_NO_IMAGE_NS = 2_000_000_000
_MOVED_M, _MOVED_RAD = 0.006, 0.05  # of a robot that stands: ten sigmas of noise, a third of what a stroke gives
_MOST = 1.5  # of what a stroke should take it: then the wiggle is stopped at once
_SILENT_RAD = 1e-3  # a wheel that counted less counted nothing


class Mean(NamedTuple):
    """Poses of a robot that stands."""

    images: int = 0
    pose: Pose = (0.0, 0.0, 0.0)

    def add(self, pose: Pose) -> "Mean":
        """Return the mean with one more."""
        x, y, psi = self.pose
        k = 1.0 / (self.images + 1)
        turn = math.remainder(pose[2] - psi, math.tau)
        return Mean(self.images + 1, (x + k * (pose[0] - x), y + k * (pose[1] - y), psi + k * turn))


class Wiggle(NamedTuple):
    """Where the wiggle is. Instants on the supervisor's clock [ns]; wheels [rad], forward +."""

    means: tuple[Mean, ...] = ()
    image: int = 0  # number of the newest that was looked at
    robot: int = NOBODY  # that is tried; NOBODY while all are looked at first; their number at the end
    stroke: int = 0  # index in STROKES of what it must do now
    since_ns: int = 0  # when it began to drive, to slow down or to stand
    rest_tick: int | None = None  # newest tick when it was seen at rest
    before: Pose = (0.0, 0.0, 0.0)  # where the leg began
    angles: Wheels = (0.0, 0.0)  # and what the encoders said
    told: Wheels = (0.0, 0.0)  # and how far they had been told to turn
    forth: Leg | None = None


def travel_m(wheel_radius: float) -> float:
    """Return how far a stroke takes a robot [m]."""
    left, right = STROKES[FORTH]
    return wheel_radius * (left + right) / 2.0 * PROBE_RAD_S * _STROKE_NS * 1e-9


def room_m(wheel_radius: float) -> float:
    """Return how far a robot may get before the wiggle is stopped [m]."""
    return _MOST * travel_m(wheel_radius) + _MOVED_M


def begin(view: FleetView) -> Wiggle:
    """Return the first state: everybody stands and is looked at."""
    return Wiggle((Mean(),) * len(view.robots), since_ns=view.now_ns, rest_tick=view.tick)


def step(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView
) -> tuple[Wiggle, Happening | None]:
    """Go on; a happening is why the fleet must not start. ``state.robot`` is the number of driven robots at the end."""
    if view.image != state.image:
        bad = _bad_sign(state, wheel_radius, view)
        if bad is not None:
            return state, bad
        state = _look(state, view)
    if state.robot != NOBODY:
        if state.stroke:
            return _drive(state, view)
        if state.rest_tick is None:
            return _slow_down(state, view)
    return _stand(state, wheel_radius, wheel_base, view)


def _bad_sign(state: Wiggle, wheel_radius: tuple[float, ...], view: FleetView) -> Happening | None:
    """Return what the newest image says against going on."""
    for row, (robot, mean) in enumerate(zip(view.robots, state.means, strict=True)):
        if row == state.robot:
            x, y, _ = state.before
            travelled = math.hypot(robot.pose[0] - x, robot.pose[1] - y)
            if travelled > room_m(wheel_radius[row]):
                return Happening(Event.WRONG_GAIN, row, travelled / travel_m(wheel_radius[row]))
        elif mean.images and _moved(mean.pose, robot.pose):
            if state.robot == NOBODY:
                return Happening(Event.NOT_AT_REST, row)
            return Happening(Event.WRONG_TAG_MOVED, state.robot, row)
    return None


def _moved(before: Pose, after: Pose) -> bool:
    return (
        math.hypot(after[0] - before[0], after[1] - before[1]) > _MOVED_M
        or abs(math.remainder(after[2] - before[2], math.tau)) > _MOVED_RAD
    )


def _look(state: Wiggle, view: FleetView) -> Wiggle:
    """Take the newest image's poses of all who stand: of the one that is tried, only after it was seen at rest."""
    settled = state.rest_tick is not None and view.image_tick > state.rest_tick
    means = tuple(
        mean.add(robot.pose) if robot.image == view.image and (settled or state.robot not in (NOBODY, row)) else mean
        for row, (robot, mean) in enumerate(zip(view.robots, state.means, strict=True))
    )
    return state._replace(means=means, image=view.image)


def _drive(state: Wiggle, view: FleetView) -> tuple[Wiggle, Happening | None]:
    """Until the stroke's time is over; commands that come late get more of it."""
    driven_ns = view.now_ns - state.since_ns
    enough = max(map(abs, _asked(state, view.robots[state.robot]))) >= 0.5 * PROBE_RAD_S * _STROKE_NS * 1e-9
    if driven_ns >= _STROKE_NS and enough:
        return state._replace(stroke=0, since_ns=view.now_ns), None
    return state, Happening(Event.LEASE_LOST, state.robot) if driven_ns >= _NO_START_NS else None


def _slow_down(state: Wiggle, view: FleetView) -> tuple[Wiggle, Happening | None]:
    """Until the wheels rest."""
    robot, waited_ns = view.robots[state.robot], view.now_ns - state.since_ns
    needed_ns = _SETTLE_NS if any(_counted(state, robot)) else _COAST_NS
    if robot.at_rest and waited_ns >= needed_ns:
        return state._replace(since_ns=view.now_ns, rest_tick=view.tick, means=_fresh(state)), None
    return state, Happening(Event.NOT_AT_REST, state.robot) if waited_ns >= _NO_REST_NS else None


def _fresh(state: Wiggle) -> tuple[Mean, ...]:
    return tuple(Mean() if row == state.robot else mean for row, mean in enumerate(state.means))


def _stand(
    state: Wiggle, wheel_radius: tuple[float, ...], wheel_base: tuple[float, ...], view: FleetView
) -> tuple[Wiggle, Happening | None]:
    """Until there are images enough; then judge, and go on with the next leg or robot."""
    unseen = [row for row, mean in enumerate(state.means) if mean.images < _IMAGES]
    if unseen:
        late = view.now_ns - state.since_ns >= _NO_IMAGE_NS
        return state, Happening(Event.TAG_LOST, unseen[0]) if late else None
    row = state.robot
    if row == NOBODY:
        return _next(state, 0, view), None
    pose = state.means[row].pose
    counted = _counted(state, view.robots[row])
    leg = Leg(_asked(state, view.robots[row]), counted, rolled(state.before, pose, wheel_radius[row], wheel_base[row]))
    fault = wiring_fault(leg)
    if state.forth is None:
        following = _start(state._replace(forth=leg), BACK, view)
    else:
        following = _next(state, row + 1, view)
        fault = fault or gain_fault(mean_of(state.forth, leg))
    return (following, None) if fault is None else (state, Happening(fault[0], row, fault[1]))


def _next(state: Wiggle, row: int, view: FleetView) -> Wiggle:
    state = state._replace(robot=row, forth=None)
    return _start(state, FORTH, view) if row < view.driven else state


def _start(state: Wiggle, stroke: int, view: FleetView) -> Wiggle:
    robot = view.robots[state.robot]
    return state._replace(
        stroke=stroke, since_ns=view.now_ns, rest_tick=None, before=state.means[state.robot].pose,
        angles=(robot.left_angle, robot.right_angle), told=(robot.left_told, robot.right_told),
    )  # fmt: skip


def _asked(state: Wiggle, robot: RobotView) -> Wheels:
    return robot.left_told - state.told[0], robot.right_told - state.told[1]


def _counted(state: Wiggle, robot: RobotView) -> Wheels:
    left, right = robot.left_angle - state.angles[0], robot.right_angle - state.angles[1]
    return (left, right) if max(abs(left), abs(right)) > _SILENT_RAD else (0.0, 0.0)
