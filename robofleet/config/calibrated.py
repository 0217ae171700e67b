"""What ``tools/calibrate.py`` writes and the configuration names: cameras, floor tags, single robots."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.model import (
    LAST_TAG,
    MANY,
    Coordinate,
    Degrees,
    Delay,
    Height,
    Lag,
    Length,
    Model,
    Name,
    Pixels,
    Text,
    within,
)

Row = Annotated[tuple[Annotated[float, within(-1e15, 1e15)], ...], Field(max_length=MANY, strict=False)]
Turned = Annotated[float, within(-10, 10)]
Focal = Annotated[float, within(1, 1e6)]
Coefficient = Annotated[float, within(-1e6, 1e6)]
Pixel = Annotated[tuple[Annotated[float, within(-1e5, 1e5)], Annotated[float, within(-1e5, 1e5)]], Field(strict=False)]


class Provenance(Model):
    """Where a calibration comes from, and how good it is: written by ``tools/calibrate.py``."""

    date: Text
    """UTC, ISO 8601."""
    tool: Text
    """With its version."""
    inputs: Annotated[dict[Text, Text], Field(max_length=MANY)]
    """Name of what was measured: hash of its bytes."""
    figures: Annotated[dict[Text, Annotated[float, within(-1e15, 1e15)] | None], Field(max_length=MANY)]
    """Name with its unit: value."""
    parameters: Annotated[tuple[Text, ...], Field(max_length=MANY, strict=False)] = ()
    """In the order of the covariance's rows, with units."""
    covariance: Annotated[tuple[Row, ...], Field(max_length=MANY, strict=False)] = ()
    """Of the parameters."""


class TagOffset(Model):
    """The tag's pose on its robot: from the centre of the axle, in the body's frame."""

    forward_m: Annotated[float, within(-10, 10)] = 0.0
    """Of the tag's centre."""
    left_m: Annotated[float, within(-10, 10)] = 0.0
    """Of the tag's centre."""
    heading_deg: Degrees = 0.0
    """Of the print's right over the robot's forward, counter-clockwise."""


class RobotCalibration(Model):
    """What was measured of one robot (a file of ``configs/robots``); it goes before its vehicle's values."""

    robot: Name
    """On which one this was measured."""
    tag_offset: TagOffset = TagOffset()
    """Where the tag sits on it."""
    wheel_radius_m: Length | None = None
    """null: as its vehicle's."""
    wheel_base_m: Length | None = None
    """null: as its vehicle's."""
    delay_s: Delay | None = None
    """From a tick to the moment when its command acts; null: ``controller.command_delay_s``."""
    motor_lag_s: Lag | None = None
    """null: as its vehicle's."""
    offsets: Provenance | None = None
    """How tag and wheels were measured."""
    latency: Provenance | None = None
    """How delay and lag were measured."""


class FloorTag(Model):
    """A tag that was surveyed: it stays where it is, and shows whether the camera does."""

    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    """Its id, of the family 36h11."""
    side_m: Length
    """Of its black square."""
    x_m: Coordinate
    """Of its middle, in the world frame."""
    y_m: Coordinate
    """Of its middle, in the world frame."""
    heading_deg: Degrees = 0.0
    """Of the print's right, counter-clockwise."""
    height_m: Height = 0.0
    """Above the floor."""


class PoseSettings(Model):
    """A rigid transform: camera to world."""

    position_m: Annotated[tuple[Coordinate, Coordinate, Coordinate], Field(strict=False)]
    """Of the camera."""
    rotation_rad: Annotated[tuple[Turned, Turned, Turned], Field(strict=False)]
    """Axis times angle (Rodrigues)."""


class CameraModel(Model):
    """A calibrated camera (a file of ``configs/cameras``).

    ``distortion``: OpenCV's coefficients in OpenCV's order; of a pinhole 0, 4, 5, 8, 12 or 14 (k1 k2 p1 p2 k3 k4 k5 k6
    s1 s2 s3 s4 tx ty), of a fisheye 4 (k1 k2 k3 k4).
    """

    camera: Text = ""
    """On which one this was measured, as its source names it; empty: any."""
    lens: Literal["pinhole", "fisheye"] = "pinhole"
    """OpenCV's model of it."""
    width: Pixels
    """Of the images, in pixels."""
    height: Pixels
    """Of the images, in pixels."""
    focal_px: Annotated[tuple[Focal, Focal], Field(strict=False)]
    """Along x and along y."""
    centre_px: Pixel
    """Integers are pixel centres."""
    distortion: Annotated[tuple[Coefficient, ...], Field(max_length=14, strict=False)]
    """OpenCV's coefficients in OpenCV's order."""
    line_time_s: Annotated[float, within(0, 0.1)] = 0.0
    """Of a rolling shutter, from one row's exposure to the next one's; 0: global shutter."""
    T_world_camera: PoseSettings | None = None
    """Where it hangs; null: not measured yet."""
    intrinsics: Provenance | None = None
    """How the lens was measured."""
    arena: Provenance | None = None
    """How its place was measured."""
