"""What ``tools/calibrate.py`` writes and the configuration names: cameras, floor tags, single robots."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.model import (
    LAST_TAG,
    Finite,
    Model,
    Name,
    NonNegative,
    Positive,
    Vector2,
    Vector3,
)


class Provenance(Model):
    """Where a calibration comes from, and how good it is: written by ``tools/calibrate.py``."""

    date: str  # UTC, ISO 8601
    tool: str  # with its version
    inputs: dict[str, str]  # name of what was measured -> hash of its bytes
    figures: dict[str, float | None]  # name with unit -> value
    parameters: Annotated[tuple[str, ...], Field(strict=False)] = ()  # order of the covariance's rows, with units
    covariance: Annotated[tuple[Annotated[tuple[Finite, ...], Field(strict=False)], ...], Field(strict=False)] = ()


class TagOffset(Model):
    """The tag's pose on its robot: from the centre of the axle, in the body's frame."""

    forward_m: Finite = 0.0
    left_m: Finite = 0.0
    heading_deg: Finite = 0.0  # of the print's right over the robot's forward; CCW +


class RobotCalibration(Model):
    """What was measured of one robot (a file of ``configs/robots``); it goes before its vehicle's values."""

    robot: Name
    tag_offset: TagOffset = TagOffset()
    wheel_radius_m: Positive | None = None
    wheel_base_m: Positive | None = None
    delay_s: NonNegative | None = None  # from a tick to the moment when its command acts
    motor_lag_s: NonNegative | None = None
    offsets: Provenance | None = None
    latency: Provenance | None = None


class FloorTag(Model):
    """A tag that was surveyed: it stays where it is, and shows whether the camera does."""

    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    side_m: Positive
    x_m: Finite  # [world]
    y_m: Finite
    heading_deg: Finite = 0.0  # of the print's right; CCW +
    height_m: NonNegative = 0.0


class PoseSettings(Model):
    """A rigid transform: camera to world."""

    position_m: Vector3
    rotation_rad: Vector3  # axis times angle (Rodrigues)


class CameraModel(Model):
    """A calibrated camera (a file of ``configs/cameras``).

    ``distortion``: OpenCV's coefficients in OpenCV's order; of a pinhole 0, 4, 5, 8, 12 or 14 (k1 k2 p1 p2 k3 k4 k5 k6
    s1 s2 s3 s4 tx ty), of a fisheye 4 (k1 k2 k3 k4).
    """

    camera: str = ""  # which camera this was measured on, as its source names it; empty: any
    lens: Literal["pinhole", "fisheye"] = "pinhole"
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    focal_px: Annotated[tuple[Positive, Positive], Field(strict=False)]
    centre_px: Vector2  # integer coordinates are pixel centres
    distortion: Annotated[tuple[Finite, ...], Field(strict=False)]
    line_time_s: NonNegative = 0.0  # of a rolling shutter, from one row's exposure to the next one's; 0: global shutter
    T_world_camera: PoseSettings | None = None  # from `calibrate.py arena`
    intrinsics: Provenance | None = None
    arena: Provenance | None = None
