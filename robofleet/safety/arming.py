"""What is proved on the live system before a fleet starts: the checks, the e-stop drill, the wiggle."""

from enum import IntEnum
from typing import NamedTuple


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
