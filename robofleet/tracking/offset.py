"""Converts between the pose of a tag and the pose of its robot's centre, the middle of the axle."""

import math

from robofleet.config.calibrated import TagOffset

# Of a planar pose x, y [m; world], psi [rad]: xx, xy, yy [m^2], x psi, y psi [m rad], psi psi [rad^2].
Covariance = tuple[float, ...]
UNKNOWN: Covariance = (0.0,) * 6


def centre_from_tag(x: float, y: float, psi: float, offset: TagOffset) -> tuple[float, float, float]:
    """Return the pose of a robot's centre (world; psi in (-pi, pi]) from the pose of its tag [m, rad]."""
    heading = math.remainder(psi - math.radians(offset.heading_deg), math.tau)
    c, s = math.cos(heading), math.sin(heading)
    return x - c * offset.forward_m + s * offset.left_m, y - s * offset.forward_m - c * offset.left_m, heading


def centre_covariance(of_tag: Covariance, psi: float, offset: TagOffset) -> Covariance:
    """Return the covariance of a robot's centre from that of its tag's pose with heading ``psi``.

    A wrong heading moves the centre around the tag: dx = y_arm dpsi, dy = -x_arm dpsi for the arm from centre to tag.
    """
    xx, xy, yy, x_psi, y_psi, psi_psi = of_tag
    heading = psi - math.radians(offset.heading_deg)
    c, s = math.cos(heading), math.sin(heading)
    by_x, by_y = c * offset.left_m + s * offset.forward_m, s * offset.left_m - c * offset.forward_m
    return (
        xx + by_x * (2.0 * x_psi + by_x * psi_psi),
        xy + by_y * x_psi + by_x * y_psi + by_x * by_y * psi_psi,
        yy + by_y * (2.0 * y_psi + by_y * psi_psi),
        x_psi + by_x * psi_psi,
        y_psi + by_y * psi_psi,
        psi_psi,
    )


def tag_from_centre(x: float, y: float, psi: float, offset: TagOffset) -> tuple[float, float, float]:
    """Return the pose of a robot's tag from the pose of its centre: the other way round."""
    c, s = math.cos(psi), math.sin(psi)
    heading = math.remainder(psi + math.radians(offset.heading_deg), math.tau)
    return x + c * offset.forward_m - s * offset.left_m, y + s * offset.forward_m + c * offset.left_m, heading


def tag_covariance(of_centre: Covariance, psi: float, offset: TagOffset) -> Covariance:
    """Return the covariance of a tag from that of its robot's centre's pose with heading ``psi``."""
    return centre_covariance(of_centre, psi, TagOffset(forward_m=-offset.forward_m, left_m=-offset.left_m))
