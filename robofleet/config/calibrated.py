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

    date: str
    """UTC, ISO 8601."""
    tool: str
    """With its version."""
    inputs: dict[str, str]
    """Name of what was measured: hash of its bytes."""
    figures: dict[str, float | None]
    """Name with its unit: value."""
    parameters: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """In the order of the covariance's rows, with units."""
    covariance: Annotated[tuple[Annotated[tuple[Finite, ...], Field(strict=False)], ...], Field(strict=False)] = ()
    """Of the parameters."""


class TagOffset(Model):
    """The tag's pose on its robot: from the centre of the axle, in the body's frame."""

    forward_m: Finite = 0.0
    """Of the tag's centre."""
    left_m: Finite = 0.0
    """Of the tag's centre."""
    heading_deg: Finite = 0.0
    """Of the print's right over the robot's forward, counter-clockwise."""


class RobotCalibration(Model):
    """What was measured of one robot (a file of ``configs/robots``); it goes before its vehicle's values."""

    robot: Name
    """On which one this was measured."""
    tag_offset: TagOffset = TagOffset()
    """Where the tag sits on it."""
    wheel_radius_m: Positive | None = None
    """null: as its vehicle's."""
    wheel_base_m: Positive | None = None
    """null: as its vehicle's."""
    delay_s: NonNegative | None = None
    """From a tick to the moment when its command acts; null: ``controller.command_delay_s``."""
    motor_lag_s: NonNegative | None = None
    """null: as its vehicle's."""
    offsets: Provenance | None = None
    """How tag and wheels were measured."""
    latency: Provenance | None = None
    """How delay and lag were measured."""


class FloorTag(Model):
    """A tag that was surveyed: it stays where it is, and shows whether the camera does."""

    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    """Its id, of the family 36h11."""
    side_m: Positive
    """Of its black square."""
    x_m: Finite
    """Of its middle, in the world frame."""
    y_m: Finite
    """Of its middle, in the world frame."""
    heading_deg: Finite = 0.0
    """Of the print's right, counter-clockwise."""
    height_m: NonNegative = 0.0
    """Above the floor."""


class PoseSettings(Model):
    """A rigid transform: camera to world."""

    position_m: Vector3
    """Of the camera."""
    rotation_rad: Vector3
    """Axis times angle (Rodrigues)."""


class CameraModel(Model):
    """A calibrated camera (a file of ``configs/cameras``).

    ``distortion``: OpenCV's coefficients in OpenCV's order; of a pinhole 0, 4, 5, 8, 12 or 14 (k1 k2 p1 p2 k3 k4 k5 k6
    s1 s2 s3 s4 tx ty), of a fisheye 4 (k1 k2 k3 k4).
    """

    camera: str = ""
    """On which one this was measured, as its source names it; empty: any."""
    lens: Literal["pinhole", "fisheye"] = "pinhole"
    """OpenCV's model of it."""
    width: Annotated[int, Field(gt=0)]
    """Of the images, in pixels."""
    height: Annotated[int, Field(gt=0)]
    """Of the images, in pixels."""
    focal_px: Annotated[tuple[Positive, Positive], Field(strict=False)]
    """Along x and along y."""
    centre_px: Vector2
    """Integers are pixel centres."""
    distortion: Annotated[tuple[Finite, ...], Field(strict=False)]
    """OpenCV's coefficients in OpenCV's order."""
    line_time_s: NonNegative = 0.0
    """Of a rolling shutter, from one row's exposure to the next one's; 0: global shutter."""
    T_world_camera: PoseSettings | None = None
    """Where it hangs; null: not measured yet."""
    intrinsics: Provenance | None = None
    """How the lens was measured."""
    arena: Provenance | None = None
    """How its place was measured."""
