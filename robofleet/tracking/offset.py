"""Between a tag's pose and its robot's: what the camera sees is the tag, what drives is the middle of the axle."""

import math

from robofleet.config.calibrated import TagOffset


def centre_from_tag(x: float, y: float, psi: float, offset: TagOffset) -> tuple[float, float, float]:
    """Return the pose of a robot's centre (world; psi in (-pi, pi]) from the pose of its tag [m, rad]."""
    heading = math.remainder(psi - math.radians(offset.heading_deg), math.tau)
    c, s = math.cos(heading), math.sin(heading)
    return x - c * offset.forward_m + s * offset.left_m, y - s * offset.forward_m - c * offset.left_m, heading


def tag_from_centre(x: float, y: float, psi: float, offset: TagOffset) -> tuple[float, float, float]:
    """Return the pose of a robot's tag from the pose of its centre: the other way round."""
    c, s = math.cos(psi), math.sin(psi)
    heading = math.remainder(psi + math.radians(offset.heading_deg), math.tau)
    return x + c * offset.forward_m - s * offset.left_m, y + s * offset.forward_m + c * offset.left_m, heading
