"""What may be wrong before a start, and what arming must say of it: by whom it is named, and when."""

from collections.abc import Callable
from dataclasses import dataclass

from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import NOBODY, Event
from robofleet.safety.view import NEVER, FleetView
from robofleet.safety.wiggle import BACK
from robofleet.vehicles.interface import RobotFault
from tests.safety.arming_lab import BODY_M, MS, SESSION, Alter, Lab, one

_AT_ONCE, _AFTER_5_S, _ANY = (0.0, 0.1), (5.0, 5.0), (0.0, 100.0)


@dataclass(frozen=True)
class Scenario:
    """How the laboratory is prepared, and the verdict."""

    prepare: Callable[[Lab], None]
    event: Event
    robot: int = NOBODY
    detail: float | None = 0.0  # None: any
    between_s: tuple[float, float] = _ANY


def seen(alter: Alter) -> Callable[[Lab], None]:
    return lambda lab: setattr(lab, "alter", alter)


def lab_with(**attributes: object) -> Callable[[Lab], None]:
    return lambda lab: [setattr(lab, name, value) for name, value in attributes.items()] and None


def settings(**fields: object) -> Callable[[Lab], None]:
    return lambda lab: setattr(lab, "settings", lab.settings._replace(**fields))


def in_round(number: int, alter: Alter) -> Callable[[Lab], None]:
    """Alter the view in a round of the wiggle; -1: while all are looked at first."""

    def prepare(lab: Lab) -> None:
        lab.alter = lambda view: alter(view) if lab.state.wiggle.round == number and lab.state.wiggle.image else view

    return prepare


def while_tried(row: int, alter: Alter) -> Callable[[Lab], None]:
    def prepare(lab: Lab) -> None:
        lab.alter = lambda view: alter(view) if row in lab.state.wiggle.tried else view

    return prepare


def older(row: int, field: str, ns: int) -> Callable[[Lab], None]:
    return seen(lambda view: one(row, **{field: view.now_ns - ns})(view))


def until(ns: int, alter: Alter) -> Callable[[Lab], None]:
    return seen(lambda view: alter(view) if view.now_ns < ns else view)


def shifted(row: int, x: float = 0.0, psi: float = 0.0) -> Alter:
    def alter(view: FleetView) -> FleetView:
        px, py, ppsi = view.robots[row].pose
        return one(row, pose=(px + x, py, ppsi + psi))(view)

    return alter


def left_latched(lab: Lab) -> None:
    lab.view = one(1, latch=Latch.DRILL)(lab.view)


def left_latched_for_good(lab: Lab) -> None:
    left_latched(lab)
    lab.stubborn = {1}


def never(process: str) -> Callable[[Lab], None]:
    return seen(lambda view: view._replace(**{f"{process}_ns": NEVER, f"{process}_build": 0}))


def narrow(x_m: float, y_m: float) -> Callable[[Lab], None]:
    """Leave so much beside the outermost bodies."""
    return settings(arena=(2 * (0.3 + BODY_M + x_m), 2 * (BODY_M + y_m)))


HEALTHY = {
    "nothing is wrong": lambda _: None,
    "the battery is unknown": seen(one(1, battery=-1.0)),
    "the battery has a fifth": seen(one(1, battery=0.2)),
    "the disk has 200 MB": seen(lambda view: view._replace(free_bytes=200_000_000)),
    "a tag was seen 149 ms ago": older(1, "seen_ns", 149 * MS),
    "a driver was heard 499 ms ago, at first": until(1100 * MS, lambda v: one(1, heard_ns=v.now_ns - 499 * MS)(v)),
    "a lease comes after 4 s": until(5000 * MS, one(1, session=0)),
    "another tag is seen after 4 s": until(5000 * MS, one(2, seen_ns=NEVER)),
    "a robot is at rest after 4 s": until(5000 * MS, one(2, left_speed=1.0)),
    "a start was broken off in its drill": left_latched,
    "there is just room between two": settings(body_radius=(BODY_M, 0.191, BODY_M)),
    "there is just room at the walls": narrow(0.054, 0.054),
    "there is room between two to turn on the spot": settings(body_radius=(BODY_M, 0.233, BODY_M)),
    "there is room at the walls to turn on the spot": narrow(0.012, 0.012),
    "no robot has encoders": lab_with(silent_encoders=True),
    "the supervisor looks more often than there are images": lab_with(period_ns=10 * MS),
    "poses are twice as noisy": lab_with(noise=(0.0006, 0.0006, 0.008)),
}

_WRONG = {
    "controller of another build": (seen(lambda v: v._replace(controller_build=1)), Event.OTHER_BUILD),
    "tracker of another build": (seen(lambda v: v._replace(tracker_build=1)), Event.OTHER_BUILD),
    "driver of another build": (seen(one(1, build=1)), Event.OTHER_BUILD, 1),
    "wired stop pressed": (seen(one(1, faults=3)), Event.WIRED_STOP, 1),
    "robot's own fault": (seen(one(1, faults=RobotFault.OWN)), Event.ROBOT_FAULT, 1, 65536.0),
    "robot's bumper and more": (seen(one(1, faults=RobotFault.BUMPED | RobotFault.OWN)), Event.BUMPED, 1),
    "latched by an e-stop": (seen(one(1, latch=Latch.EMERGENCY_STOP)), Event.GATE_LATCHED, 1, 2.0),
    "battery low": (seen(one(1, battery=0.19)), Event.BATTERY_LOW, 1, 0.19),
    "battery empty": (seen(one(1, battery=0.0)), Event.BATTERY_LOW, 1, 0.0),
    "disk full": (seen(lambda v: v._replace(free_bytes=199_999_999)), Event.DISK_FULL),
    "two too close": (settings(body_radius=(BODY_M, 0.238, BODY_M)), Event.TOO_CLOSE, 0, 1.0),
    "too close to the wall ahead": (narrow(0.009, 1.0), Event.TOO_CLOSE, 0, NOBODY),
    "too close to the wall beside": (narrow(1.0, 0.009), Event.TOO_CLOSE, 0, NOBODY),
    "outside, ahead": (narrow(-0.005, 1.0), Event.OUTSIDE_ARENA, 0),
    "outside, beside": (narrow(1.0, -0.005), Event.OUTSIDE_ARENA, 0),
    "outside, left": (seen(one(1, pose=(0.0, 0.47, 0.0))), Event.OUTSIDE_ARENA, 1),
    "outside, right": (seen(one(1, pose=(0.0, -0.47, 0.0))), Event.OUTSIDE_ARENA, 1),
}  # fmt: skip

_MISSING = {
    "no controller": (never("controller"), Event.CONTROLLER_SILENT),
    "no tracker": (never("tracker"), Event.TRACKER_SILENT),
    "controller silent": (seen(lambda v: v._replace(controller_ns=v.now_ns - 500 * MS)), Event.CONTROLLER_SILENT),
    "tracker silent": (seen(lambda v: v._replace(tracker_ns=v.now_ns - 500 * MS)), Event.TRACKER_SILENT),
    "no driver": (seen(one(1, heard_ns=NEVER, build=0)), Event.DRIVER_SILENT, 1),
    "driver silent": (older(1, "heard_ns", 500 * MS), Event.DRIVER_SILENT, 1),
    "tag never seen": (seen(one(1, seen_ns=NEVER)), Event.TAG_LOST, 1),
    "tag late": (older(1, "seen_ns", 150 * MS), Event.TAG_LOST, 1),
    "tag not in the newest images": (seen(one(1, unseen_ns=150 * MS)), Event.TAG_LOST, 1),
    "no lease": (seen(one(1, session=0)), Event.LEASE_LOST, 1),
    "nobody's lease": (seen(lambda v: one(0, session=0)(one(1, session=0)(one(2, session=0)(v)))), Event.LEASE_LOST, 0),
    "another controller's lease": (seen(one(1, session=SESSION + 1)), Event.LEASE_LOST, 1),
    "wheel turns": (seen(one(1, left_speed=0.1)), Event.NOT_AT_REST, 1),
    "wheel is driven": (seen(one(1, right_output=-0.1)), Event.NOT_AT_REST, 1),
    "drill never cleared": (left_latched_for_good, Event.GATE_LATCHED, 1),
}


def _no_rest(lab: Lab) -> None:
    still_turning = one(1, left_speed=1.0)
    lab.alter = lambda view: still_turning(view) if 1 in lab.state.wiggle.tried and not lab.state.stroke(1) else view


def _stands_on_its_way_back(lab: Lab) -> None:
    def alter(view: FleetView) -> FleetView:
        lab.stuck = {1} if lab.state.stroke(1) == BACK else set()
        return view

    lab.alter = alter


def _exchanged_runaway(lab: Lab) -> None:
    lab.tags, lab.runaway = [1, 0, 2], {0}


REFUSED = {
    **{name: Scenario(*row, between_s=_AT_ONCE) for name, row in _WRONG.items()},  # type: ignore[misc, arg-type]
    **{name: Scenario(*row, between_s=_AFTER_5_S) for name, row in _MISSING.items()},  # type: ignore[misc, arg-type]
    "e-stop not answered": Scenario(lab_with(deaf={1}), Event.ESTOP_UNANSWERED, 1, between_s=(0.2, 0.3)),
    "drill not cleared": Scenario(lab_with(stubborn={1}), Event.GATE_LATCHED, 1, Latch.DRILL, (1.0, 1.2)),
    "latched in the wiggle": Scenario(while_tried(1, one(2, latch=3)), Event.GATE_LATCHED, 2, 3.0),
    "moved by hand before": Scenario(in_round(-1, shifted(2, x=0.01)), Event.NOT_AT_REST, 2),
    "turned by hand before": Scenario(in_round(-1, shifted(2, psi=0.1)), Event.NOT_AT_REST, 2),
    "never in an image": Scenario(seen(one(2, image=-1)), Event.TAG_LOST, 2, between_s=(2.0, 2.3)),
    "images from before": Scenario(seen(lambda v: v._replace(image_tick=0)), Event.TAG_LOST, 0, between_s=(2.0, 2.3)),
    "tags exchanged": Scenario(lab_with(tags=[1, 0, 2]), Event.WRONG_TAG_MOVED, 0, 1, (0.2, 1.3)),
    "tags exchanged, the last two": Scenario(lab_with(tags=[0, 2, 1]), Event.WRONG_TAG_MOVED, 2, 1),
    "drivers exchanged": Scenario(lab_with(bodies=[1, 0, 2]), Event.WRONG_TAG_MOVED, 0, 1),
    "tags exchanged, and wheels go on": Scenario(_exchanged_runaway, Event.WRONG_TAG_MOVED, 0, 1, (0.2, 1.1)),
    "three tags in a ring are taken for two": Scenario(lab_with(tags=[1, 2, 0]), Event.WRONG_TAG_MOVED, 0, 1),
    "another one turns": Scenario(in_round(0, shifted(1, psi=0.1)), Event.MOVED_UNASKED, 1),
    "another one goes too": Scenario(lab_with(twins={1: 0}), Event.MOVED_UNASKED, 1),
    "motors stand": Scenario(lab_with(stuck={1}), Event.DID_NOT_MOVE, 1),
    "motors stand on the way back": Scenario(_stands_on_its_way_back, Event.DID_NOT_MOVE, 1),
    "encoder reversed": Scenario(lab_with(encoders={1: lambda angle: -angle}), Event.ENCODER_WRONG, 1, None),
    "encoder counts half": Scenario(lab_with(encoders={1: lambda angle: 0.5 * angle}), Event.ENCODER_WRONG, 1, None),
    "wheels go on": Scenario(lab_with(runaway={1}), Event.WRONG_GAIN, 1, None),
    "no command comes": Scenario(lab_with(obeys=False), Event.LEASE_LOST, 0, between_s=(1.2, 1.5)),
    "no rest": Scenario(_no_rest, Event.NOT_AT_REST, 1),
    "tried, and in no image": Scenario(while_tried(1, one(1, image=0)), Event.TAG_LOST, 1),
}
