"""The configuration: one YAML, one frozen tree. ``load.py`` reads it and reports what is wrong where.

Every key carries its unit. World frame: the arena's centre on the floor, x along the long side, y left, z up.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import Field, JsonValue, SerializerFunctionWrapHandler, model_serializer, model_validator

from robofleet.config.calibrated import FloorTag
from robofleet.config.camera import CameraSettings
from robofleet.config.controller import ControllerSettings
from robofleet.config.mocap import MocapSettings
from robofleet.config.obstacles import Arena
from robofleet.config.projectors import ProjectionSettings, ProjectorSettings
from robofleet.config.robots import Robot
from robofleet.config.troubles import InjectedFault
from robofleet.core.patterns import ENDPOINT_PATTERN, NETWORK_PATTERN, PRIVATE, TRACKER, driver_role, tracker_role
from robofleet.core.settings import (
    CAMERAS,
    MANY,
    ROBOTS,
    TAGS,
    Count,
    Delay,
    FamilyName,
    Fraction,
    Height,
    Length,
    Model,
    Name,
    Named,
    Text,
    within,
)
from robofleet.safety.supervisor import Roster

Most = Annotated[float, within(1e-6, 1e9)]


class BusSettings(Model):
    """The address at which the processes of a run meet. Everybody who reaches it can drive the robots."""

    endpoint: Annotated[str, Field(max_length=300, pattern=ENDPOINT_PATTERN)] = PRIVATE
    """``private``: a socket named after the arena, in ``$XDG_RUNTIME_DIR/robofleet`` or ``/tmp/robofleet-UID``. Only
    this user may have access to the folder of a socket. With TCP, port 0 takes any free port."""
    listen: Annotated[
        tuple[Annotated[str, Field(max_length=300, pattern=NETWORK_PATTERN)], ...], Field(max_length=8, strict=False)
    ] = ()
    """Addresses of this computer at which the router admits other hosts, by the certificates of ``robofleet keys``:
    ``quic/192.168.1.10:7447`` for robots on a radio, ``tls/192.168.1.10:7447`` for others."""
    router: Literal["run", "service"] = "run"
    """Who starts the router: each run its own, or ``service``: it is there before and after runs, as ``robofleet node
    router CONFIG`` or a zenohd of your own. ``robofleet hosts CONFIG`` then shows the robots' computers between runs,
    too."""
    insecure: Literal["loopback"] | None = None
    """``loopback`` allows TCP on this computer. Every user and every program of the computer can then drive the
    robots."""


class Group(Model):
    """Robots that drive together."""

    name: Name | None = None
    """Name of the group in messages, figures and the summary; null: its behaviour's name, or ``group1``, ``group2``."""
    behaviour: Named
    """What the group does: an entry point of ``robofleet.behaviours``, or a class as ``module:Class``."""
    robots: Annotated[tuple[Name, ...], Field(min_length=1, max_length=ROBOTS, strict=False)]
    """Ids of the robots, in the order of the group: where one leads, the leader first."""
    settings: Annotated[dict[Text, JsonValue], Field(max_length=MANY)] = Field(default={})
    """Settings of the behaviour. ``configs/keys/behaviours.md`` lists them."""

    @property
    def title(self) -> str:
        """The group's name; once the file is read, every group has one."""
        return self.name or self.behaviour


class TruthSettings(Model):
    """Poses that no image is needed for. With ``tracker.source: truth`` all robots have such poses. Otherwise the
    robots with ``reality: simulated`` have them, as late as the image with which they are merged."""

    position_noise_m: Annotated[float, within(0, 10)] = 0.0
    """Standard deviation of the position along each axis."""
    heading_noise_rad: Annotated[float, within(0, 10)] = 0.0
    """Standard deviation of the heading."""
    delay_s: Annotated[float, Field(ge=0, le=0.25)] = 0.01
    """Time from the instant at which a pose is true to its arrival. The simulation remembers 0.3 s."""
    jitter_s: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    """Largest random time that is added to the delay."""
    dropout: Fraction = 0.0
    """Share of the poses that are missing."""


class TrackerSettings(Model):
    """How robofleet measures the robots' poses."""

    source: Named
    """Where poses come from: an entry point of ``robofleet.poses``, or a class as ``module:Class``. ``camera``: the
    detector finds the tags in the camera's images. ``mocap``: a motion-capture system measures the robots' bodies.
    ``truth``: all robots are simulated and publish their true poses."""
    family: FamilyName = "36h11"
    """AprilTag family of all tags. 36h11 has 587 ids, 25h9 has 35, 16h5 has 30, and fewer ids have larger cells in a
    print of the same size. Standard41h12 has 2115 ids; its bits lie inside and around a white square in a black one."""
    tag_side_m: Length
    """Side of the black square of a robot's tag; of Standard41h12, of the white square in the black one: 5 of the
    print's 9 cells."""
    tag_side_tolerance_m: Annotated[float, within(0, 0.01)] = 5e-5
    """By how much the side of a robot's tag may be wrong: 0.05 mm, if measured with a caliper. A tag that appears
    larger or smaller by more than that is named: it may lie higher or lower than configured."""
    tag_height_m: Height
    """Height of the robots' tags above the floor."""
    floor_tags: Annotated[tuple[FloorTag, ...], Field(max_length=TAGS, strict=False)] = ()
    """Surveyed tags on the floor. They show whether the camera moves, and by how much the poses must be corrected."""
    truth: TruthSettings = TruthSettings()
    """Noise, delay and losses of the poses that no image is needed for."""
    mocap: MocapSettings = MocapSettings()
    """The motion-capture system of ``tracker.source: mocap``."""

    @property
    def simulated(self) -> bool:
        """Whether the poses are those of simulated robots, and no camera's images are needed for them."""
        return self.source == "truth" or (self.source == "mocap" and self.mocap.system == "simulated")

    @property
    def own_times(self) -> bool:
        """Whether poses come at times of their own: their source follows no camera's trigger."""
        return self.source not in ("camera", "truth")


class DriverSettings(Model):
    """How the robots' drivers share processes, and who starts them."""

    robots_per_process: Annotated[int, within(1, ROBOTS)] | None = None
    """Largest number of robots in one driver process, of those without ``robots[].unit``. They are taken in the order
    of ``robots``. null: all robots with the driver ``simulated`` in one process, each other robot in one of its own."""
    started_by: Literal["run", "systemd", "daemon"] = "run"
    """``run``: ``robofleet run`` starts the drivers. ``systemd``: the services of ``tools/deploy`` start them, and
    ``robofleet run`` starts everything else. ``daemon``: as ``run``, but each robot that is not simulated has a
    computer of its own, on which ``robofleet node driver --unit UNIT`` waits for this configuration."""


OWN_PLANT = "own"


class PlantSettings(Model):
    """The physics of the simulated robots, and of the robots in whose place twins answer. The robots of one process
    share a world: ``drivers`` and ``robots[].unit`` say which these are; all twins are in one."""

    model: Named = OWN_PLANT
    """``own``: the equations of ``robofleet/vehicles/plant.py``. Else an entry point of ``robofleet.plants``, or a
    class as ``module:Class``; ``mujoco``: wheels in contact with the floor, and bodies that collide."""
    settings: Annotated[dict[Text, JsonValue], Field(max_length=MANY)] = Field(default={})
    """Settings of that plant. ``robofleet/simulation/PLANTS.md`` lists them."""


class LockstepSettings(Model):
    """Simulated times of a lockstep run, where computing takes no simulated time by itself."""

    bus_delay_s: Annotated[float, within(1e-6, 1)] = 0.001
    """Time from the sending of a message to its arrival."""
    tracker_delay_s: Delay = 0.004
    """Time from an image to its poses."""


class Bounds(Model):
    """Limits by which the report judges a run. The figures are those of ``summary.json``; null: the figure is not
    judged."""

    control_error_mean_mm: Most | None = None
    """Upper limit of the mean control error over all robots."""
    timed_error_mean_mm: Most | None = None
    """Upper limit of the leader's mean timed error."""
    path_error_mean_mm: Most | None = None
    """Upper limit of the mean path error over all robots."""
    spacing_max_deviation_mm: Most | None = None
    """Upper limit of the largest deviation from ``spacing_m``, after ``run.spacing_settle_s``."""
    min_gap_mm: Annotated[float, within(-1e6, 1e6)] | None = None
    """Lower limit of the smallest gap between the bodies of two robots."""
    min_obstacle_gap_mm: Annotated[float, within(-1e6, 1e6)] | None = None
    """Lower limit of the smallest gap between a robot's body and an obstacle, or the edge of ``arena.floor_m``."""
    pose_error_rms_mm: Most | None = None
    """Upper limit of the root mean square of the filter's position error at the ticks."""
    overruns: Count | None = None
    """Upper limit of the number of ticks that the controller missed."""
    exposure_to_wheel_p99_ms: Most | None = None
    """Upper limit of the 99th percentile of the time from mid-exposure to the wheels."""
    stops: Count | None = None
    """Upper limit of the number of unrequested stops. Each robot counts: a stop of four robots is four."""
    gap: Annotated[float, within(1, 1e6)] | None = None
    """Upper limit of the worst ratio between the run and its simulation with the identified robots, which
    ``robofleet gap`` measures."""


class RunSettings(Model):
    """Length, start and judgement of a run."""

    duration_s: Annotated[float, within(1e-3, 1e7)]
    """Run time of the whole run: it stands still in a hold. A lap of the shipped path takes 88 s."""
    settle_s: Annotated[float, within(0, 1e7)] = 1.4
    """Run time after which the control error counts."""
    spacing_settle_s: Annotated[float, within(0, 1e7)] = 5.0
    """Run time after which the spacing and the true errors count, where it is longer than ``settle_s``."""
    seed: Annotated[int, within(0, 2**63 - 1)] = 1
    """Seed of all random numbers. In lockstep the same seed gives the same run."""
    attended: bool = False
    """``true``: a person sits at the terminal. The robots stop when the terminal closes or ``robofleet run``
    freezes."""
    begin: Literal["where_they_stand", "go_to_start"] = "where_they_stand"
    """``go_to_start``: before the first tick the robots drive by themselves to where their behaviours begin (a platoon:
    behind each other on the path), and where a behaviour has no places, to ``robots[].start``."""
    end: Literal["where_they_stand", "park"] = "where_they_stand"
    """``park``: after the run the robots drive to ``robots[].park``."""
    start: Literal["auto", "operator"] = "auto"
    """``auto``: the robots drive as soon as the checks have passed. ``operator``: they wait until the operator starts
    them."""
    bounds: Bounds = Bounds()
    """Limits by which the report judges the run."""


class Config(Model):
    """The parts of a configuration."""

    arena: Arena
    """The floor: name, size and what stands on it."""
    bus: BusSettings = BusSettings()
    """The address at which the processes meet."""
    robots: Annotated[tuple[Robot, ...], Field(min_length=1, max_length=ROBOTS, strict=False)]
    """Every robot of the fleet. A robot in no group is a bystander: it does not drive, and the others keep clear of
    it."""
    groups: Annotated[tuple[Group, ...], Field(min_length=1, max_length=ROBOTS, strict=False)]
    """Which robots drive together, and what they do. A robot is in one group at most."""
    controller: ControllerSettings
    """The control law, its filter and the barrier between robots."""
    tracker: TrackerSettings
    """How the robots' poses are measured."""
    camera: CameraSettings
    """The overhead camera. Required, unless there is ``cameras``; both are refused."""
    cameras: Annotated[tuple[CameraSettings, ...], Field(max_length=CAMERAS, strict=False)] = ()
    """Several overhead cameras, each with a name of its own. Their views may overlap."""
    projectors: Annotated[tuple[ProjectorSettings, ...], Field(max_length=CAMERAS, strict=False)] = ()
    """Projectors that light the floor."""
    projection: ProjectionSettings = ProjectionSettings()
    """What projectors show of a run."""
    run: RunSettings
    """Length, seed, start and judgement of a run."""
    drivers: DriverSettings = DriverSettings()
    """How the drivers share processes, and who starts them."""
    plant: PlantSettings = PlantSettings()
    """The physics of simulated robots and twins."""
    lockstep: LockstepSettings = LockstepSettings()
    """Simulated times of bus and tracker in ``robofleet run CONFIG --lockstep``."""
    faults: Annotated[tuple[InjectedFault, ...], Field(max_length=MANY, strict=False)] = ()
    """Faults on purpose, and their times. ``--faults FILE`` replaces them."""

    @model_validator(mode="before")
    @classmethod
    def _first_camera(cls, given: object) -> object:
        """Let ``camera`` be the first of several, where these are written."""
        if not isinstance(given, dict) or given.get("camera") is not None:
            return given
        several = given.get("cameras")
        return {**given, "camera": several[0]} if isinstance(several, list | tuple) and several else given

    @model_serializer(mode="wrap")
    def _as_written(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave ``camera`` out where there are several, and ``cameras`` where there is one."""
        tree: dict[str, Any] = dump(self)
        tree.pop("camera" if self.cameras else "cameras", None)
        return tree

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values; what was found in the robots is found anew.

        Args:
            update: The other values by their keys, which are not validated.
            deep: Whether the values are copied, too.

        Returns:
            The copy.
        """
        copy = super().model_copy(update=update, deep=deep)
        for found in ("units", "unit_of", "_by_id", "ids"):
            copy.__dict__.pop(found, None)
        return copy

    @property
    def trackers(self) -> dict[str, Self]:
        """The tracker processes by name, each with the configuration as it has it: ``camera`` is its own."""
        if len(self.views) == 1:
            return {TRACKER: self}
        return {tracker_role(view.camera.name): view for view in self.views}

    @property
    def views(self) -> tuple[Self, ...]:
        """The configuration as each camera's process has it: ``camera`` is its own. Without cameras there is one."""
        if not self.cameras or self.tracker.source != "camera":
            return (self,)
        return tuple(self.model_copy(update={"camera": camera}) for camera in self.cameras)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """The names by which poses come: of every camera, in the order of ``views``."""
        return tuple(view.camera.name for view in self.views)

    @property
    def camera_keys(self) -> tuple[tuple[str, CameraSettings], ...]:
        """Every camera, with the dotted path at which it is written."""
        if not self.cameras:
            return (("camera", self.camera),)
        return tuple((f"cameras.{i}", camera) for i, camera in enumerate(self.cameras))

    @property
    def twins(self) -> tuple[Robot, ...]:
        """The robots in whose place a twin answers."""
        return tuple(robot for robot in self.robots if robot.twin is not None)

    @property
    def simulated(self) -> bool:
        """Whether nothing of a run exists outside this computer: every robot, or its twin, and the camera."""
        robots = all(robot.driver == "simulated" or robot.twin is not None for robot in self.robots)
        return robots and self.poses_simulated

    @property
    def poses_simulated(self) -> bool:
        """Whether poses come from a simulation: its truth, its motion capture or its camera."""
        rendered = all(camera.rendered for _, camera in self.camera_keys)
        return self.tracker.simulated or (self.tracker.source == "camera" and rendered)

    @property
    def seen(self) -> tuple[Robot, ...]:
        """The robots that stand in the arena: those that a camera can see."""
        return tuple(robot for robot in self.robots if robot.reality == "real")

    @property
    def virtual(self) -> tuple[Robot, ...]:
        """The robots that stand in no arena: their poses are merged with what the camera sees of the others."""
        return tuple(robot for robot in self.robots if robot.reality == "simulated")

    @cached_property
    def units(self) -> dict[str, tuple[str, ...]]:
        """The units by name, each with its robots' ids: what one driver process drives."""
        named: dict[str, list[str]] = {}
        for robot in self.robots:
            if robot.unit is not None:
                named.setdefault(robot.unit, []).append(robot.id)
        crews = {crew[0].id: [robot.id for robot in crew] for crew in self.crews}
        found = {name: tuple(ids) for name, ids in {**crews, **named}.items()}
        places = {robot.id: index for index, robot in enumerate(self.robots)}
        return dict(sorted(found.items(), key=lambda unit: places[unit[1][0]]))

    @property
    def daemons(self) -> tuple[str, ...]:
        """The units whose drivers wait on computers of their own: a run hands them its configuration."""
        if self.drivers.started_by != "daemon":
            return ()
        named = {robot.unit for robot in self.robots if robot.unit is not None and robot.driver != "simulated"}
        return tuple(unit for unit in self.units if unit in named)

    @property
    def sensing(self) -> tuple[str, ...]:
        """The units of which a robot tells what its sensors measure."""
        return tuple(unit for unit, ids in self.units.items() if any(self.robot(robot_id).sensors for robot_id in ids))

    @property
    def crews(self) -> Sequence[Sequence[Robot]]:
        """The robots without ``unit``, by the processes that they share: each is a unit named after its first robot."""
        free, most = [robot for robot in self.robots if robot.unit is None], self.drivers.robots_per_process
        if most is not None:
            return [free[k : k + most] for k in range(0, len(free), most)]
        simulated = [robot for robot in free if robot.driver == "simulated"]
        return [*([simulated] if simulated else []), *([robot] for robot in free if robot.driver != "simulated")]

    @property
    def driven(self) -> dict[str, tuple[str, ...]]:
        """The driver processes by name, each with its robots' ids."""
        return {driver_role(unit): robots for unit, robots in self.units.items()}

    @cached_property
    def unit_of(self) -> dict[str, str]:
        """The unit of each robot, by their names."""
        return {robot_id: unit for unit, robots in self.units.items() for robot_id in robots}

    def driver_of(self, robot_id: str) -> str:
        """Return the name of the process that drives a robot.

        Args:
            robot_id: The robot's id.

        Returns:
            The process's name, as messages and logs have it.
        """
        return driver_role(self.unit_of[robot_id])

    def robot(self, robot_id: str) -> Robot:
        """Return a robot by its id.

        Args:
            robot_id: The robot's id.

        Returns:
            The robot, as the configuration has it.

        Raises:
            KeyError: There is no such robot.
        """
        return self._by_id[robot_id]

    @cached_property
    def _by_id(self) -> dict[str, Robot]:
        return {robot.id: robot for robot in self.robots}

    @property
    def members(self) -> tuple[Robot, ...]:
        """The robots of all groups, group by group: the order of every array and of every report."""
        return tuple(self.robot(robot_id) for group in self.groups for robot_id in group.robots)

    @property
    def bystanders(self) -> tuple[Robot, ...]:
        """The robots that this run does not drive: bodies that the others keep clear of, wherever they stand."""
        driven = {robot_id for group in self.groups for robot_id in group.robots}
        return tuple(robot for robot in self.robots if robot.id not in driven)

    @property
    def bodies(self) -> tuple[Robot, ...]:
        """Every robot, the groups' first: what stands in the arena, and the order in which its robots are numbered."""
        return (*self.members, *self.bystanders)

    @cached_property
    def ids(self) -> Roster:
        """The names of the bodies, in their order, and of their groups."""
        groups = {robot_id: group.title for group in self.groups for robot_id in group.robots}
        return Roster(
            (robot.id for robot in self.bodies), (groups.get(robot.id, "") for robot in self.bodies), self.camera_names
        )
