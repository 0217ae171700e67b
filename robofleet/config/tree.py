"""The configuration: one YAML, one frozen tree. ``load.py`` reads it and reports what is wrong where.

Every key carries its unit. World frame: the arena's centre on the floor, x along the long side, y left, z up.
"""

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

NAME_PATTERN = r"^[a-z][a-z0-9_-]{0,31}$"
LAST_TAG = 586  # AprilTag 36h11 has 587 ids
ENDPOINT_PATTERN = r"^tcp/[^\s/]+:\d{1,5}$"

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Gray = Annotated[int, Field(ge=0, le=255)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Vector2 = Annotated[tuple[Finite, Finite], Field(strict=False)]
Vector3 = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]


class Model(BaseModel):
    """A frozen part of the tree; unknown keys are refused, and a number must be a number."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Arena(Model):
    """The floor the robots may be on: a rectangle around the world's origin."""

    name: Name
    size_m: Annotated[tuple[Positive, Positive], Field(strict=False)]


class BusSettings(Model):
    """Where the router listens; port 0 takes any free one."""

    endpoint: Annotated[str, Field(pattern=ENDPOINT_PATTERN)] = "tcp/127.0.0.1:0"


class PlantErrors(Model):
    """How far a simulated robot is from ideal. Spreads are half widths of a uniform draw, one a run."""

    motor_lag_s: NonNegative
    speed_quantum_rad_s: NonNegative
    loop_period_s: Positive
    deadband_rad_s: NonNegative
    breakaway_rad_s: NonNegative
    actuation_delay_s: NonNegative = 0.0  # from a command's arrival to the moment when the wheels begin to follow it
    wheel_gain_error: Annotated[float, Field(gt=-1, lt=1)] = 0.0  # of both wheels' travel, relative
    wheel_gain_spread: Fraction
    wheel_base_spread: Fraction
    slip_s_per_rad: NonNegative
    slip_noise: NonNegative
    top_speed_sag: Fraction
    battery_life_s: Positive


class Vehicle(Model):
    """A kind of robot (a file of ``configs/robots``): what the controller believes, and the errors."""

    wheel_radius_m: Positive
    wheel_base_m: Positive
    body_radius_m: Positive
    max_wheel_speed_rad_s: Positive
    max_speed_m_s: Positive
    motor_lag_s: NonNegative
    simulated: PlantErrors


class StartPose(Model):
    """Where a simulated robot's centre stands at first [world frame; heading CCW +]."""

    x_m: Finite
    y_m: Finite
    heading_deg: Finite

    @property
    def psi(self) -> float:
        """Heading in (-pi, pi] [rad]."""
        return math.remainder(math.radians(self.heading_deg), math.tau)


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


class Robot(Model):
    """One robot of the fleet."""

    id: Name
    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    tag_height_m: NonNegative | None = None  # default: tracker.tag_height_m
    driver: Annotated[str, Field(min_length=1)] = "simulated"
    vehicle: Vehicle
    calibration: RobotCalibration | None = None
    start: StartPose


class Knot(Model):
    """A joint of the path: position and derivative with respect to the parameter, one unit a side."""

    at_m: Vector2
    derivative_m: Vector2


class PathFile(Model):
    """A closed path of Hermite cubics (a file of ``configs/paths``)."""

    knots: Annotated[tuple[Knot, ...], Field(min_length=2, strict=False)]


class Group(Model):
    """Robots that do something together, first one first."""

    behaviour: Literal["platoon", "excitation"]  # excitation: what tools/calibrate.py lets the robots drive
    robots: Annotated[tuple[Name, ...], Field(min_length=1, strict=False)]
    path: PathFile
    spacing_m: Positive
    path_rate: Positive  # gamma [sides of the path per second]
    track: Literal["point", "centre"] = "point"


class FilterSettings(Model):
    """The fleet filter: standard deviations of a pose measurement, and the prediction's loss of certainty."""

    position_noise_m: Positive = 0.0004
    heading_noise_rad: Positive = 0.006
    position_drift_m: Positive = 0.0015  # after one second [m / sqrt(s)]
    heading_drift_rad: Positive = 0.06  # after one second [rad / sqrt(s)]
    efficiency_sigma: Fraction = 0.15  # of a wheel's true travel over the believed one, in the long run
    efficiency_time_s: Positive = 20.0  # in which it is forgotten
    gate_sigma: Positive = 5.0  # a measurement further off than this is an outlier
    lost_after_s: Positive = 0.5  # without a measurement for so long, a robot is lost and stands still


class ControllerSettings(Model):
    """The NR flow and its tick."""

    tick_s: Positive
    alpha: Positive
    horizon_s: Positive  # T
    point_ahead_m: Positive  # l
    integrator: Literal["exact", "euler"] = "exact"
    disturbance: Literal["estimated", "none"] = "none"  # what the law knows of wheels that do not do as asked
    command_delay_s: NonNegative = 0.002  # from the tick to the moment when its commands act
    filter: FilterSettings = FilterSettings()


class TruthSettings(Model):
    """Poses without pixels (``tracker.source: truth``)."""

    position_noise_m: NonNegative = 0.0
    heading_noise_rad: NonNegative = 0.0
    delay_s: Annotated[float, Field(ge=0, le=0.25)] = 0.01  # the simulation remembers 0.3 s
    jitter_s: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    dropout: Fraction = 0.0


class FloorTag(Model):
    """A tag that was surveyed: it stays where it is, and shows whether the camera does."""

    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    side_m: Positive
    x_m: Finite  # [world]
    y_m: Finite
    heading_deg: Finite = 0.0  # of the print's right; CCW +
    height_m: NonNegative = 0.0


class TrackerSettings(Model):
    """Where poses come from."""

    source: Literal["camera", "truth"]
    tag_side_m: Positive
    tag_height_m: NonNegative
    floor_tags: Annotated[tuple[FloorTag, ...], Field(strict=False)] = ()
    truth: TruthSettings = TruthSettings()


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


class Cable(Model):
    """Something thin over the arena, near the camera: it hides what is below."""

    points_px: Annotated[tuple[Vector2, ...], Field(min_length=2, strict=False)]
    width_px: Annotated[int, Field(ge=1, le=100)] = 2
    gray: Gray = 40
    at_s: NonNegative = 0.0  # from then on; time counts from the first image


class Glare(Model):
    """A lamp's reflection: light added around a pixel, falling off as a Gaussian."""

    at_px: Vector2
    radius_px: Positive
    gray: Positive = 400.0  # at its middle: beyond 255 it saturates


class Outage(Model):
    """The camera sends the same picture again and again, or none. Time counts from its first image."""

    kind: Literal["frozen", "stalled"]
    at_s: NonNegative
    duration_s: Positive


class Knock(Model):
    """The camera is turned about its own axes and shifted, at once or slowly. Time counts from its first image."""

    at_s: NonNegative
    over_s: NonNegative = 0.0
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)  # about x right, y down, z forward [camera]
    shift_m: Vector3 = (0.0, 0.0, 0.0)  # [world]


class Cover(Model):
    """A robot's tag is covered. Time counts from the first image."""

    robot: Name
    at_s: NonNegative = 0.0
    duration_s: Positive


class Swap(Model):
    """Two robots' tags are exchanged. Time counts from the first image."""

    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    at_s: NonNegative


class TrueTagOffset(TagOffset):
    """Where a simulated robot's tag really is on it."""

    robot: Name


class SimulatedCameraSettings(Model):
    """What the simulated camera has to survive; nothing by default."""

    light: Annotated[float, Field(gt=0, le=1)] = 1.0  # of full light
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    projector_gray: Gray = 0  # strength of a projector's moving pattern, added to what it falls on
    cables: Annotated[tuple[Cable, ...], Field(strict=False)] = ()
    glare: Annotated[tuple[Glare, ...], Field(strict=False)] = ()
    posters: Annotated[tuple[FloorTag, ...], Field(strict=False)] = ()  # prints that nobody surveyed, of any id
    covers: Annotated[tuple[Cover, ...], Field(strict=False)] = ()
    swaps: Annotated[tuple[Swap, ...], Field(strict=False)] = ()
    outages: Annotated[tuple[Outage, ...], Field(strict=False)] = ()
    knocks: Annotated[tuple[Knock, ...], Field(strict=False)] = ()
    tag_offsets: Annotated[tuple[TrueTagOffset, ...], Field(strict=False)] = ()  # default: as calibrated


class V4L2Settings(Model):
    """A camera of the kernel's (``camera.source: v4l2``)."""

    device: Annotated[str, Field(min_length=1)] = "/dev/video0"  # a link in /dev/v4l/by-id stays when it is replugged
    format: Literal["MJPG", "GREY"] = "MJPG"
    gain: int | None = 0  # in the driver's units; null: this camera has no gain to set
    stamp: Literal["start", "end"] = "start"  # what its driver stamps: the exposure's start, or the end of the transfer


class FilesSettings(Model):
    """A video, or a folder of images (``camera.source: files``). Paths count from where robofleet is started."""

    path: Annotated[str, Field(min_length=1)]
    stamps: str | None = None  # CSV of mid-exposures, see tracking/files.py; null: each image's name is its own, in ns


class BaslerSettings(Model):
    """A Basler camera through pylon (``camera.source: basler``)."""

    serial: str | None = None  # null: the only one that is plugged in
    gain: NonNegative = 0.0  # [dB]; of an older camera in the units of its GainRaw
    trigger_source: Literal["Software", "Line1", "Line2", "Line3"] = "Software"  # with ``camera.trigger: tick``


class CameraSettings(Model):
    """The overhead camera. ``trigger: tick`` exposes a fixed time before every tick; ``free`` does not."""

    source: Annotated[str, Field(min_length=1)] = "simulated"
    model: CameraModel
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    rate_hz: Positive
    trigger: Literal["free", "tick"] = "tick"
    trigger_lead_s: Positive = 0.018  # from mid-exposure to the tick
    exposure_s: Positive = 0.004
    readout_s: NonNegative = 0.004  # from the end of the (first row's) exposure until the image is here
    noise_gray: NonNegative = 3.0  # of a pixel; 0: of no pixel, so that two images may be equal
    simulated: SimulatedCameraSettings = SimulatedCameraSettings()
    v4l2: V4L2Settings = V4L2Settings()
    files: FilesSettings | None = None
    basler: BaslerSettings = BaslerSettings()


class LockstepSettings(Model):
    """What a lockstep run charges for work that takes no simulated time."""

    bus_delay_s: Positive = 0.001
    tracker_delay_s: NonNegative = 0.004


class Fault(Model):
    """A timed fault of a simulated robot. Time counts from its first motion command."""

    robot: Name
    kind: Literal["motor_stuck"]
    at_s: NonNegative
    duration_s: Positive


class RunSettings(Model):
    """One run."""

    duration_s: Positive
    settle_s: NonNegative = 1.4
    spacing_settle_s: NonNegative = 5.0
    seed: Annotated[int, Field(ge=0)] = 1
    attended: bool = False


class Config(Model):
    """The whole tree."""

    arena: Arena
    bus: BusSettings = BusSettings()
    robots: Annotated[tuple[Robot, ...], Field(min_length=1, strict=False)]
    groups: Annotated[tuple[Group, ...], Field(min_length=1, max_length=1, strict=False)]
    controller: ControllerSettings
    tracker: TrackerSettings
    camera: CameraSettings
    run: RunSettings
    lockstep: LockstepSettings = LockstepSettings()
    faults: Annotated[tuple[Fault, ...], Field(strict=False)] = ()

    def robot(self, robot_id: str) -> Robot:
        """Return a robot by its id; KeyError if there is none."""
        for robot in self.robots:
            if robot.id == robot_id:
                return robot
        raise KeyError(robot_id)

    @property
    def platoon(self) -> tuple[Robot, ...]:
        """The robots of the group, leader first: the order of every array and of every report."""
        return tuple(self.robot(robot_id) for robot_id in self.groups[0].robots)
