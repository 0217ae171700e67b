"""The configuration: one YAML, one frozen tree. ``load.py`` reads it and reports what is wrong where.

Every key carries its unit. World frame: the arena's centre on the floor, x along the long side, y left, z up.
"""

import math
from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.calibrated import (
    FloorTag,
    RobotCalibration,
)
from robofleet.config.camera import (
    CameraSettings,
)
from robofleet.config.model import (
    ENDPOINT_PATTERN,
    LAST_TAG,
    Finite,
    Fraction,
    Model,
    Name,
    NonNegative,
    Positive,
    Vector2,
)
from robofleet.config.troubles import Fault
from robofleet.vehicles.interface import Wiring


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
    wiring: Wiring = "straight"  # of motors and encoders together
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
    max_wheel_acceleration_rad_s2: Positive
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


class BarrierSettings(Model):
    """The barrier between robots: distances follow from these, the bodies and what is believed of the drives."""

    gap_m: NonNegative = 0.01  # that two bodies keep at the worst
    age_s: NonNegative = 0.133  # of the newest image at a tick, at most: 100 ms of delay, and a tick
    rate_per_s: Positive = 10.0  # gamma: how fast a distance may be used up
    ahead_m: Positive = 0.01  # of the axle: the point that is kept apart


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
    barrier: BarrierSettings = BarrierSettings()


class TruthSettings(Model):
    """Poses without pixels (``tracker.source: truth``)."""

    position_noise_m: NonNegative = 0.0
    heading_noise_rad: NonNegative = 0.0
    delay_s: Annotated[float, Field(ge=0, le=0.25)] = 0.01  # the simulation remembers 0.3 s
    jitter_s: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    dropout: Fraction = 0.0


class TrackerSettings(Model):
    """Where poses come from."""

    source: Literal["camera", "truth"]
    tag_side_m: Positive
    tag_height_m: NonNegative
    floor_tags: Annotated[tuple[FloorTag, ...], Field(strict=False)] = ()
    truth: TruthSettings = TruthSettings()


class DriverSettings(Model):
    """How the robots' drivers are spread over processes."""

    robots_per_process: Annotated[int, Field(ge=1)] = 1


class LockstepSettings(Model):
    """What a lockstep run charges for work that takes no simulated time."""

    bus_delay_s: Positive = 0.001
    tracker_delay_s: NonNegative = 0.004


class Bounds(Model):
    """What a run is judged by in its report, as ``summary.json`` has the figures; null: not judged."""

    control_error_mean_mm: Positive | None = None
    timed_error_mean_mm: Positive | None = None  # the leader's
    path_error_mean_mm: Positive | None = None
    spacing_max_deviation_mm: Positive | None = None
    min_gap_mm: Finite | None = None  # at least
    pose_error_rms_mm: Positive | None = None
    overruns: Annotated[int, Field(ge=0)] | None = None
    exposure_to_wheel_p99_ms: Positive | None = None
    stops: Annotated[int, Field(ge=0)] | None = None


class RunSettings(Model):
    """One run."""

    duration_s: Positive
    settle_s: NonNegative = 1.4
    spacing_settle_s: NonNegative = 5.0
    seed: Annotated[int, Field(ge=0)] = 1
    attended: bool = False
    start: Literal["auto", "operator"] = "auto"  # operator: everything is there and waits until somebody starts it
    bounds: Bounds = Bounds()


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
    drivers: DriverSettings = DriverSettings()
    lockstep: LockstepSettings = LockstepSettings()
    faults: Annotated[tuple[Fault, ...], Field(strict=False)] = ()

    @property
    def processes(self) -> tuple[str, ...]:
        """The processes of a run, by name."""
        return "router", "supervisor", "tracker", "controller", *self.driven

    @property
    def driven(self) -> dict[str, tuple[str, ...]]:
        """The driver processes by name, each with its robots' ids."""
        ids, most = [robot.id for robot in self.robots], self.drivers.robots_per_process
        return {f"driver-{ids[k]}": tuple(ids[k : k + most]) for k in range(0, len(ids), most)}

    def driver_of(self, robot_id: str) -> str:
        """Return the name of the process that drives a robot."""
        return next(name for name, robots in self.driven.items() if robot_id in robots)

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
