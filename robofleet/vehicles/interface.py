"""What a robot's driver offers, and the values that cross it.

A driver knows its robot and nothing of the bus; the process around it knows the bus and nothing of the robot.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, runtime_checkable

from robofleet.core.errors import RobofleetError
from robofleet.vehicles.differential_drive import DifferentialDrive

if TYPE_CHECKING:  # the gate's own types stand here, and `robofleet stop` must not wait for numpy
    import numpy as np

    from robofleet.vehicles.sensors import Sensing, SensorKind

Wiring = Literal["straight", "swapped", "left_reversed", "right_reversed", "both_reversed"]


class WheelSpeeds(NamedTuple):
    """Angular speeds of the two wheels [rad/s; forward is +]."""

    left: float
    right: float


STOP = WheelSpeeds(0.0, 0.0)


class RobotFault(IntFlag):
    """What a robot says is wrong with it; its gate closes and latches while one of these is there."""

    WIRED_STOP = 1  # its own e-stop input is pressed
    BUMPED = 2  # a bumper is pressed
    CLIFF = 4  # there is no floor ahead of it
    WHEEL_DROPPED = 8  # a wheel has lost the floor: the robot is lifted
    OVERCURRENT = 16  # a motor draws too much current: a wheel is blocked
    CHARGING = 32  # it is at its charger
    UNREACHABLE = 64  # nobody can tell: its driver has lost it (the driver's process says this, no driver does)
    OWN = 1 << 16  # from this bit on: what only its own driver's README knows


WIRED_STOP = RobotFault.WIRED_STOP


class SensorReading(NamedTuple):
    """What a robot senses beside its wheels; None of what it has not, or does not tell.

    Robot frame: origin at the middle of the axle, x ahead, y to the left, z up.
    """

    gyro: tuple[float, float, float] | None = None  # turning about x, y, z [rad/s; CCW +]
    accelerometer: tuple[float, float, float] | None = None  # specific force along x, y, z [m/s^2]; at rest z is +9.8
    magnetometer: tuple[float, float, float] | None = None  # magnetic field along x, y, z [T]
    heading: float | None = None  # by a compass or the like [rad; CCW +, in (-pi, pi], from a zero of its own]
    distances: tuple[float, ...] | None = None  # [m], in the order of its kind's sensors; NaN: one sees nothing


class DriverReading(NamedTuple):
    """What a robot reports about itself."""

    left_angle: float  # [rad; forward +, accumulated since the driver opened]
    right_angle: float  # [rad]
    left_speed: float  # [rad/s; as measured]
    right_speed: float  # [rad/s]
    battery: float  # charge [0..1]; NaN where the robot cannot tell
    faults: int  # of RobotFault; 0 when healthy
    sensors: SensorReading | None = None  # None: it has no more, or ``DriverContext.sensors`` asks for none


class TruePose(NamedTuple):
    """Where a simulated robot really is [m, rad; world frame, CCW +] and how it moves [m/s, rad/s; body frame]."""

    x: float
    y: float
    psi: float
    v: float
    omega: float


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """How far a simulated robot is from the ideal one. Spreads are half widths of a uniform draw made once."""

    motor_lag: float  # time constant of the wheel-speed loop [s]
    speed_quantum: float  # one encoder count in one period of the loop [rad/s]
    loop_period: float  # of the firmware [s]
    deadband: float  # a turning wheel stops when commanded less [rad/s]
    breakaway: float  # a resting wheel stays at rest when commanded less (stiction) [rad/s]
    wheel_gain_spread: float  # of each wheel's travel, relative
    wheel_base_spread: float  # relative
    slip: float  # fraction of a wheel's travel lost at a yaw rate of 1 rad/s [s/rad]
    slip_noise: float  # standard deviation of the slip, relative to it
    top_speed_sag: float  # fraction of the top speed lost when the battery is empty
    battery_life: float  # [s]
    wheel_gain_error: float = 0.0  # of both wheels' travel, relative
    wiring: Wiring = "straight"  # of motors and encoders together
    actuation_delay: float = 0.0  # from a command's arrival to the moment when the wheels begin to follow it [s]


class BodyTrouble(NamedTuple):
    """What is wrong with a simulated robot now."""

    stuck: bool = False  # motors stand still, whatever they are told
    slip: float = 0.0  # share of the wheels' travel that is lost
    left: float | None = None  # speed at which this wheel turns by itself [rad/s]; None: it does as it is told
    right: float | None = None
    pushed: tuple[float, float] = (0.0, 0.0)  # by a hand: velocity along x and y [m/s; world]


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """What only a simulated robot needs."""

    drive: DifferentialDrive  # the kind of robot that it is one of
    imperfections: Imperfections
    start: tuple[float, float, float]  # x, y [m], psi [rad]; world
    trouble: Callable[[], BodyTrouble] | None  # None: never any
    rng: "np.random.Generator"
    radius: float = 0.0  # of the disc that others' distance sensors see [m]
    sensing: "Sensing | None" = None  # None: it senses no more than its wheels


@dataclass(frozen=True, kw_only=True)
class WorldRobot:
    """A robot of a run, as the configuration has it."""

    robot: str  # id
    unit: str  # of the driver process that drives it: robots of one unit share a process
    drive: DifferentialDrive  # as believed
    radius: float  # of the smallest disc, about the middle of the axle, that covers it [m]
    start: tuple[float, float, float] | None  # x, y [m], psi [rad] of the axle's middle; world; None: not known


@dataclass(frozen=True, kw_only=True)
class WorldObstacle:
    """Something on the floor that does not move: a disc about its only point, or a polygon."""

    name: str
    points: tuple[tuple[float, float], ...]  # corners, counter-clockwise; of a disc its middle [m; world]
    radius: float  # of a disc [m]; 0 for a polygon
    height: float  # [m]


@dataclass(frozen=True, kw_only=True)
class World:
    """Everything that stands in the arena: what a driver that simulates physics builds its world from.

    World frame: origin at the arena's centre on the floor, x along ``size[0]``, y to the left, psi CCW from x.
    """

    size: tuple[float, float]  # of the arena along x and y [m]
    floor: tuple[tuple[float, float], ...] | None  # the floor's corners [m]; None: the whole rectangle
    robots: tuple[WorldRobot, ...]  # all of the run, the driver's own too, in the configuration's order
    obstacles: tuple[WorldObstacle, ...]

    def unit(self, robot: str) -> tuple[WorldRobot, ...]:
        """Return the robots of one robot's driver process; KeyError where there is no such robot."""
        units = {each.robot: each.unit for each in self.robots}
        return tuple(each for each in self.robots if each.unit == units[robot])


@dataclass(frozen=True, kw_only=True)
class DriverContext:
    """What a driver is made from."""

    robot: str
    drive: DifferentialDrive  # as believed
    simulation: Simulation | None  # None: the robot exists
    now_ns: Callable[[], int]  # the process's clock
    settings: Any = None  # robots[].settings as the driver's own ``Settings``; None where its class has none
    sensors: "SensorKind | None" = None  # the sensors that ``read`` is to tell of; None: nobody asks for any
    world: World | None = None  # the other robots and the obstacles; None: the driver is made outside a run


class DriverError(RobofleetError):
    """Raised where a robot cannot be driven. The message says what is wrong and how to mend it."""


class Driver(Protocol):
    """One robot. Found by the entry-point group ``robofleet.drivers``, or as ``module:Class`` in the config.

    The class is called with one :class:`DriverContext`, and returns when the robot has answered and stands; it may
    take some seconds for that, and raises :class:`DriverError` where it cannot. Whatever is raised afterwards stops
    and latches this robot alone: the driver is closed, and made again ever more patiently. A new one's angles begin
    at zero again; the process adds what was turned before, so that what it publishes goes on without a jump.

    Its class may have ``Settings``, a pydantic model of what ``robots[].settings`` may say, and a static method
    ``refusals(settings, drive)`` that returns what cannot work as (dotted path below the robot, what is wrong and how
    to mend it): ``robofleet check`` asks it before anything is opened. It may say ``body_faults = True``, where
    ``context.simulation.trouble`` acts on its robot: faults of a body are refused for every other one.

    Drivers are constructed one after the other, in the configuration's order. A class may say ``concurrent = True``:
    then ``robofleet check`` and ``run`` construct it in a thread of its own, at once with others, so that boards that
    take seconds to start are waited for together. It must share nothing with other drivers: no world, no device.
    """

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels [rad/s]. Called only by the gate's process; raises if the robot cannot be told."""

    def read(self) -> DriverReading:
        """Return the newest reading without waiting for the robot; raises if there can be none."""

    def close(self) -> None:
        """Motors off. Idempotent."""


def is_concurrent(kind: type) -> bool:
    """Return whether drivers of a class may be constructed at once."""
    return bool(getattr(kind, "concurrent", False))


@runtime_checkable
class SimulatedDriver(Protocol):
    """A driver whose robot does not exist: it also knows the truth, for the simulated camera and for the summary."""

    def truth(self) -> TruePose:
        """Return the true pose now."""
