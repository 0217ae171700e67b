"""Where the tag sits on its robot, the wheels' radius and base: the part of a robot's model that ``offsets`` keeps."""

import math
from dataclasses import dataclass

import numpy as np

from robofleet.calibration.robots.identification import Identification
from robofleet.calibration.robots.information import PARAMETERS as MODEL
from robofleet.calibration.robots.shooting import Shots, Wheels
from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import TagOffset
from robofleet.core.arrays import Array

PARAMETERS = ("forward_m", "left_m", "heading_deg", "wheel_radius_m", "wheel_base_m")

_DEG = math.degrees(1.0)
_OF_MODEL = {  # each as a sum of parameters of the model
    "forward_m": {"tag_forward_m": 1.0}, "left_m": {"tag_left_m": 1.0}, "heading_deg": {"tag_heading_rad": _DEG},
    "wheel_radius_m": {"left_radius_m": 0.5, "right_radius_m": 0.5}, "wheel_base_m": {"wheel_base_m": 1.0},
}  # fmt: skip
_LEAST_TURN = 1.5 * math.pi  # each way [rad]
_LEAST_WAY = 0.05  # [m]
_WORST_PLACE, _WORST_HEADING_DEG = 0.0005, 0.3  # sigma that is refused [m, deg]


@dataclass(frozen=True)
class Offsets:
    """What was found for one robot. ``values`` (5,) and ``covariance`` (5, 5): rows as PARAMETERS."""

    robot: str
    values: Array
    covariance: Array
    found: Identification

    @property
    def tag_offset(self) -> TagOffset:
        return TagOffset(forward_m=self.values[0], left_m=self.values[1], heading_deg=self.values[2])

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


def refuse_unusable(shots: Shots, believed: Wheels) -> None:
    """Raise a CalibrationError where a drive has too few turns or straights, as far as its commands say."""
    robot, motion = shots.drive.robot, shots.motion(believed).steps
    turn, forward = motion[:, 2], float(np.abs(motion[:, 0]).sum())
    ways = float(turn[turn > 0].sum()), -float(turn[turn < 0].sum())
    if min(ways) < _LEAST_TURN:
        raise CalibrationError(
            f"{robot}: it turned {math.degrees(ways[0]):.0f} deg to the left and {math.degrees(ways[1]):.0f} to the "
            f"right, {math.degrees(_LEAST_TURN):.0f} each way are needed to place its tag: let it spin both ways"
        )
    if forward < _LEAST_WAY:
        raise CalibrationError(
            f"{robot}: it drove {100 * forward:.1f} cm straight, {100 * _LEAST_WAY:.0f} are needed for its tag's "
            "heading: give it room"
        )


def of(found: Identification) -> Offsets:
    """Return a robot's offsets.

    Raises:
        CalibrationError: the drive does not determine them.
    """
    derivative = np.array([[parts.get(name, 0.0) for name in MODEL] for parts in _OF_MODEL.values()])
    values = derivative @ [getattr(found.wheels, name) for name in MODEL]
    values[2] = math.remainder(values[2], 360.0)
    offsets = Offsets(found.robot, values, derivative @ found.covariance @ derivative.T, found)
    sigma = offsets.sigma
    if max(sigma[:2]) > _WORST_PLACE or sigma[2] > _WORST_HEADING_DEG:
        raise CalibrationError(
            f"{found.robot}: its tag is placed to {1e3 * max(sigma[:2]):.2f} mm and {sigma[2]:.2f} deg only, "
            f"{1e3 * _WORST_PLACE:.1f} and {_WORST_HEADING_DEG:.1f} are allowed: longer drives, or a better camera"
        )
    return offsets
