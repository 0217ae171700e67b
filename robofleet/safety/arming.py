"""What is proved on the live system before a fleet starts: the checks, the e-stop drill, the wiggle."""

from enum import IntEnum
from typing import NamedTuple

from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import FleetView


class Stage(IntEnum):
    """What is done while ARMED, one after the other."""

    CHECKS = 0  # everything is there, fresh, at rest and of one build
    DRILL = 1  # every driver closes its gate by an e-stop, and is cleared again
    WIGGLE = 2  # robot by robot: this driver moves this tag, forwards, as far as expected
    DONE = 3


class Stroke(NamedTuple):
    """What a probed robot is asked to do: shares of the probing speed."""

    left: float
    right: float


PROBE_RAD_S = 4.0
STROKES = (Stroke(0.0, 0.0), Stroke(1.0, 0.0), Stroke(0.0, 1.0), Stroke(-1.0, -1.0))  # 0: stand


class ArmingState(NamedTuple):
    """Where the checks are, and what they ask for now."""

    stage: Stage = Stage.CHECKS
    since_ns: int = 0  # when this stage began
    latch: Latch = Latch.NONE  # that every gate is to close by
    clear: bool = False  # every gate's latch may be cleared
    probed: int = NOBODY
    stroke: int = 0


class ArmingSettings(NamedTuple):
    """What the checks need to know of the fleet, in the group's order."""

    build: int
    wheel_radius: tuple[float, ...]  # [m]
    wheel_base: tuple[float, ...]  # [m]
    body_radius: tuple[float, ...]  # [m]
    arena: tuple[float, float]  # [m]


def begin(now_ns: int) -> ArmingState:
    """Return the first state."""
    return ArmingState(since_ns=now_ns)


def step(state: ArmingState, settings: ArmingSettings, view: FleetView) -> tuple[ArmingState, Happening | None]:
    """Go on; a happening is Event.PROVED at the end, or why the fleet must not start."""
    robots = view.robots
    ready = view.controller_ns and view.tracker_ns and all(r.heard_ns and r.seen_ns and r.session for r in robots)
    return (state._replace(stage=Stage.DONE), Happening(Event.PROVED)) if ready else (state, None)
