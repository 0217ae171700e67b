"""What ``robofleet calibrate`` writes and the configuration names: cameras, floor tags, single robots."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.plant_errors import PlantErrors
from robofleet.core.settings import (
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
    """Origin and quality of a calibration, written by ``robofleet calibrate``."""

    date: Text
    """Time of the calibration, UTC in ISO 8601."""
    tool: Text
    """Tool that wrote it, with its version."""
    inputs: Annotated[dict[Text, Text], Field(max_length=MANY)]
    """Measured files, each with the hash of its bytes."""
    figures: Annotated[dict[Text, Annotated[float, within(-1e15, 1e15)] | None], Field(max_length=MANY)]
    """Figures by name, with units."""
    parameters: Annotated[tuple[Text, ...], Field(max_length=MANY, strict=False)] = ()
    """Names of the parameters, with units, in the order of the covariance's rows."""
    covariance: Annotated[tuple[Row, ...], Field(max_length=MANY, strict=False)] = ()
    """Covariance matrix of the parameters."""


class TagOffset(Model):
    """Pose of the tag on its robot, from the centre of the axle, in the body's frame."""

    forward_m: Annotated[float, within(-10, 10)] = 0.0
    """Position of the tag's centre, forward of the axle's centre."""
    left_m: Annotated[float, within(-10, 10)] = 0.0
    """Position of the tag's centre, to the left of the axle's centre."""
    heading_deg: Degrees = 0.0
    """Angle from the robot's forward direction to the right side of the print, counter-clockwise."""


class RobotCalibration(Model):
    """What was measured of one robot (a file of ``configs/robots``). These values replace those of its vehicle."""

    robot: Name
    """Id of the robot that was measured."""
    tag_offset: TagOffset = TagOffset()
    """Pose of the tag on the robot."""
    tag_height_m: Height | None = None
    """Height of the tag above the floor; null: the robot's, or ``tracker.tag_height_m``."""
    wheel_radius_m: Length | None = None
    """Radius of a wheel; null: the vehicle's."""
    wheel_base_m: Length | None = None
    """Distance between the points where the wheels touch the floor; null: the vehicle's."""
    delay_s: Delay | None = None
    """Time from a tick until its command acts on the wheels; null: ``controller.command_delay_s``."""
    motor_lag_s: Lag | None = None
    """Time constant of the wheel-speed loop; null: the vehicle's."""
    simulated: PlantErrors | None = None
    """Errors of a simulated robot that moves as this one; null: its vehicle's."""
    offsets: Provenance | None = None
    """How tag and wheels were measured."""
    latency: Provenance | None = None
    """How delay and motor lag were measured."""
    identified: Provenance | None = None
    """How ``robofleet identify`` measured."""


class FloorTag(Model):
    """A tag at a surveyed place. The tag does not move, so it shows whether the camera does."""

    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    """Id of the tag, of the family ``tracker.family``."""
    side_m: Length
    """Side of its square, as ``tracker.tag_side_m``."""
    x_m: Coordinate
    """Position of its centre along x, in the world frame."""
    y_m: Coordinate
    """Position of its centre along y, in the world frame."""
    heading_deg: Degrees = 0.0
    """Angle from the x axis to the right side of the print, counter-clockwise."""
    height_m: Height = 0.0
    """Height above the floor."""


class PoseSettings(Model):
    """A rigid transform from the camera's frame to the world's."""

    position_m: Annotated[tuple[Coordinate, Coordinate, Coordinate], Field(strict=False)]
    """Position of the camera."""
    rotation_rad: Annotated[tuple[Turned, Turned, Turned], Field(strict=False)]
    """Rotation vector: axis times angle (Rodrigues)."""


class SeenMark(Model):
    """A surveyed mark as the camera saw it when its pose was measured: what ``verify`` compares with."""

    x_m: Coordinate
    """Surveyed position along x, in the world frame."""
    y_m: Coordinate
    """Surveyed position along y, in the world frame."""
    height_m: Height
    """Surveyed height above the floor."""
    pixel_px: Pixel
    """Where the camera saw it."""
    sigma_px: Annotated[float, within(1e-4, 1e3)]
    """Standard deviation of the pixel, one coordinate."""


class ImagingSettings(Model):
    """How a camera shows an edge, beside its lens's geometry. Greys count from 0 to 255; contrast is white minus black.
    A run starts from these values and learns on; a value that is missing is learnt from the beginning."""

    blur_px: Annotated[float, within(0, 20)] | None = None
    """Standard deviation of the lens's point spread in the middle of the image, without the pixel's own square."""
    blur_edge_px: Annotated[float, within(0, 20)] | None = None
    """The same in the corners. Between them it grows with the squared distance from the middle."""
    tone: Annotated[float, within(-0.5, 0.5)] | None = None
    """How far the image of light halfway between black and white lies above halfway, as a share of the contrast; 0: the
    camera is linear. sRGB: 0.13 to 0.24, the more the darker black is."""
    read_noise_gray: Annotated[float, within(0, 255)] | None = None
    """Standard deviation of a dark pixel's grey, from image to image."""
    shot_noise: Annotated[float, within(-255, 255)] | None = None
    """By how much that variance grows with each grey level. A tone curve may make it shrink: then this is below 0."""


class CameraModel(Model):
    """A calibrated camera (a file of ``configs/cameras``)."""

    camera: Text = ""
    """Identity of the measured camera, as its source names it; empty: any camera."""
    lens: Literal["pinhole", "fisheye"] = "pinhole"
    """OpenCV's model of the lens."""
    width: Pixels
    """Width of the images in pixels."""
    height: Pixels
    """Height of the images in pixels."""
    focal_px: Annotated[tuple[Focal, Focal], Field(strict=False)]
    """Focal lengths along x and along y."""
    centre_px: Pixel
    """Principal point. Integer coordinates are the centres of pixels."""
    distortion: Annotated[tuple[Coefficient, ...], Field(max_length=14, strict=False)]
    """OpenCV's distortion coefficients in OpenCV's order. ``pinhole``: 0, 4, 5, 8, 12 or 14 of k1 k2 p1 p2 k3 k4 k5 k6
    s1 s2 s3 s4 tx ty. ``fisheye``: k1 k2 k3 k4."""
    line_time_s: Annotated[float, within(0, 0.1)] = 0.0
    """Time from one row's exposure to the next row's, of a rolling shutter; 0: global shutter."""
    imaging: ImagingSettings | None = None
    """Blur, tone curve and noise; null: not measured."""
    T_world_camera: PoseSettings | None = None
    """Pose of the camera; null: not measured yet."""
    intrinsics: Provenance | None = None
    """How the lens was measured."""
    arena: Provenance | None = None
    """How the camera's pose was measured."""
    marks: Annotated[dict[Text, SeenMark], Field(max_length=MANY)] | None = None
    """Surveyed marks, by name, as the camera saw them then; null: not known."""
