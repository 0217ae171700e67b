"""The configuration: one YAML, one frozen tree. ``load.py`` reads it and reports what is wrong where.

Every key carries its unit. World frame: the arena's centre on the floor, x along the long side, y left, z up.
"""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.calibrated import FloorTag
from robofleet.config.camera import CameraSettings
from robofleet.config.controller import ControllerSettings
from robofleet.config.model import MANY, TAGS, Coordinate, Count, Delay, Fraction, Height, Length, Model, Name, within
from robofleet.config.patterns import ENDPOINT_PATTERN, PRIVATE
from robofleet.config.robots import Robot
from robofleet.config.troubles import Fault

Side = Annotated[float, within(0.1, 1000)]
Derivative = Annotated[float, within(-1e4, 1e4)]
Most = Annotated[float, within(1e-6, 1e9)]


class Arena(Model):
    """The floor the robots may be on: a rectangle around the world's origin."""

    name: Name
    """On the bus, and for ``robofleet stop``; an arena has one run at a time."""
    size_m: Annotated[tuple[Side, Side], Field(strict=False)]
    """Along x and along y."""


class BusSettings(Model):
    """Where the router listens. Whoever reaches it can drive."""

    endpoint: Annotated[str, Field(max_length=300, pattern=ENDPOINT_PATTERN)] = PRIVATE
    """``private``: a socket named after the arena, in ``$XDG_RUNTIME_DIR/robofleet`` or ``/tmp/robofleet-UID``. The
    folder of a socket must be this user's alone. Port 0 takes any free one."""
    insecure: Literal["loopback"] | None = None
    """``loopback`` allows TCP on this computer: every user and program of it can then drive."""


class Knot(Model):
    """A joint of the path: position and derivative with respect to the parameter, one unit a side."""

    at_m: Annotated[tuple[Coordinate, Coordinate], Field(strict=False)]
    """Its position [world frame]."""
    derivative_m: Annotated[tuple[Derivative, Derivative], Field(strict=False)]
    """With respect to the parameter, which is 1 longer at the next knot."""


class PathFile(Model):
    """A closed path of Hermite cubics (a file of ``configs/paths``)."""

    knots: Annotated[tuple[Knot, ...], Field(min_length=2, max_length=MANY, strict=False)]
    """In the order of driving; the last side leads back to the first knot."""


class Group(Model):
    """Robots that do something together, first one first."""

    behaviour: Literal["platoon", "excitation"]
    """``excitation`` is what ``tools/calibrate.py`` lets the robots drive."""
    robots: Annotated[tuple[Name, ...], Field(min_length=1, max_length=TAGS, strict=False)]
    """By their ids, the leader first."""
    path: PathFile
    """What the leader follows."""
    spacing_m: Annotated[float, within(1e-3, 1000)]
    """From each robot's point to the one ahead of it, along the path (d)."""
    path_rate: Annotated[float, within(1e-6, 100)]
    """Sides of the path per second (gamma)."""
    track: Literal["point", "centre"] = "point"
    """What follows the path: the point p, ahead of the axle, or the robot's centre."""


class TruthSettings(Model):
    """Poses without pixels: everybody's, with ``tracker.source: truth``; else those of the robots that are in no image
    (``reality: simulated``), which have the delay of the image they are merged with."""

    position_noise_m: Annotated[float, within(0, 10)] = 0.0
    """Standard deviation, along each axis."""
    heading_noise_rad: Annotated[float, within(0, 10)] = 0.0
    """Standard deviation."""
    delay_s: Annotated[float, Field(ge=0, le=0.25)] = 0.01
    """From the moment that a pose is of to its arrival; the simulation remembers 0.3 s."""
    jitter_s: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    """Most that is added to it, at random."""
    dropout: Fraction = 0.0
    """Share of the poses that are missing."""


class TrackerSettings(Model):
    """Where poses come from."""

    source: Literal["camera", "truth"]
    """``camera``: the detector reads its images; ``truth``: all robots are simulated and say where they are."""
    tag_side_m: Length
    """Of the black square of a robot's tag."""
    tag_height_m: Height
    """Of the robots' tags above the floor."""
    floor_tags: Annotated[tuple[FloorTag, ...], Field(max_length=TAGS, strict=False)] = ()
    """Surveyed ones, by which a camera that moves is noticed and corrected."""
    truth: TruthSettings = TruthSettings()
    """How good the poses without pixels are."""


class DriverSettings(Model):
    """How the robots' drivers are spread over processes."""

    robots_per_process: Annotated[int, within(1, TAGS)] = 1
    """At most, in the order of ``robots``."""
    started_by: Literal["run", "systemd"] = "run"
    """``systemd``: units of ``tools/deploy`` start them, and ``robofleet run`` starts everything else."""


class LockstepSettings(Model):
    """What a lockstep run charges for work that takes no simulated time."""

    bus_delay_s: Annotated[float, within(1e-6, 1)] = 0.001
    """From a message's sending to its arrival."""
    tracker_delay_s: Delay = 0.004
    """From an image to its poses."""


class Bounds(Model):
    """What a run is judged by in its report, as ``summary.json`` has the figures; null: not judged."""

    control_error_mean_mm: Most | None = None
    """At most, of the mean over all robots."""
    timed_error_mean_mm: Most | None = None
    """At most, of the leader's mean."""
    path_error_mean_mm: Most | None = None
    """At most, of the mean over all robots."""
    spacing_max_deviation_mm: Most | None = None
    """At most, after ``run.spacing_settle_s``."""
    min_gap_mm: Annotated[float, within(-1e6, 1e6)] | None = None
    """At least, between two robots' bodies."""
    pose_error_rms_mm: Most | None = None
    """At most, of the filter at the tick against truth."""
    overruns: Count | None = None
    """At most: ticks that were missed."""
    exposure_to_wheel_p99_ms: Most | None = None
    """At most, from mid-exposure to the wheel."""
    stops: Count | None = None
    """At most: how often a robot stood by itself."""


class RunSettings(Model):
    """One run."""

    duration_s: Annotated[float, within(1e-3, 1e7)]
    """From the first tick of the run; a lap of the shipped path takes 88 s."""
    settle_s: Annotated[float, within(0, 1e7)] = 1.4
    """The control error counts from then on."""
    spacing_settle_s: Annotated[float, within(0, 1e7)] = 5.0
    """The spacing and what is measured on the truth count from then on."""
    seed: Annotated[int, within(0, 2**63 - 1)] = 1
    """Of everything random; in lockstep the same seed gives the same run."""
    attended: bool = False
    """Somebody sits at the terminal: when it closes, or ``robofleet run`` is frozen, the robots are stopped."""
    start: Literal["auto", "operator"] = "auto"
    """``operator``: everything is there and waits until somebody starts it."""
    bounds: Bounds = Bounds()
    """What the report judges the run by."""


class Config(Model):
    """The whole tree."""

    arena: Arena
    """The floor."""
    bus: BusSettings = BusSettings()
    """Where the processes meet."""
    robots: Annotated[tuple[Robot, ...], Field(min_length=1, max_length=TAGS, strict=False)]
    """Every robot of the fleet; one that is in no group is a bystander, which the others keep clear of."""
    groups: Annotated[tuple[Group, ...], Field(min_length=1, max_length=1, strict=False)]
    """One, today."""
    controller: ControllerSettings
    """The law, and what it believes."""
    tracker: TrackerSettings
    """How the robots are seen."""
    camera: CameraSettings
    """The overhead camera."""
    run: RunSettings
    """How long, from which seed, and how it is judged."""
    drivers: DriverSettings = DriverSettings()
    """How the drivers are spread over processes."""
    lockstep: LockstepSettings = LockstepSettings()
    """What ``robofleet run --lockstep`` charges."""
    faults: Annotated[tuple[Fault, ...], Field(max_length=MANY, strict=False)] = ()
    """What goes wrong on purpose, and when; ``--faults FILE`` replaces them."""

    @property
    def processes(self) -> tuple[str, ...]:
        """The processes of a run, by name."""
        twins = ("twins",) if self.twins else ()
        return "router", "supervisor", "tracker", "controller", *twins, *self.driven

    @property
    def twins(self) -> tuple[Robot, ...]:
        """The robots in whose place a twin answers."""
        return tuple(robot for robot in self.robots if robot.twin is not None)

    @property
    def seen(self) -> tuple[Robot, ...]:
        """The robots that stand in the arena: those that a camera can see."""
        return tuple(robot for robot in self.robots if robot.reality == "real")

    @property
    def virtual(self) -> tuple[Robot, ...]:
        """The robots that stand in no arena: their poses are merged with what the camera sees of the others."""
        return tuple(robot for robot in self.robots if robot.reality == "simulated")

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

    @property
    def bystanders(self) -> tuple[Robot, ...]:
        """The robots that this run does not drive: bodies that the group keeps clear of, wherever they stand."""
        return tuple(robot for robot in self.robots if robot.id not in self.groups[0].robots)

    @property
    def bodies(self) -> tuple[Robot, ...]:
        """Every robot, the group's first: what stands in the arena, and the order in which its robots are numbered."""
        return (*self.platoon, *self.bystanders)

    @property
    def ids(self) -> tuple[str, ...]:
        """The names of the bodies, in their order."""
        return tuple(robot.id for robot in self.bodies)
