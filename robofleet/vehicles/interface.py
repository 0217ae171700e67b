"""What a robot's driver offers, and the values that cross it.

A driver knows its robot and nothing of the bus; the process around it knows the bus and nothing of the robot.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, runtime_checkable

from robofleet.core.errors import RobofleetError
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.readings import SensorReading, TruePose

if TYPE_CHECKING:  # the gate's own types stand here, and `robofleet stop` must not wait for numpy
    import numpy as np

    from robofleet.vehicles.plants import SharedPlant
    from robofleet.vehicles.sensors import Sensing, SensorKind

Wiring = Literal["straight", "swapped", "left_reversed", "right_reversed", "both_reversed"]


class WheelSpeeds(NamedTuple):
    """Angular speeds of the two wheels [rad/s; forward is +].

    Attributes:
        left: Left wheel [rad/s].
        right: Right wheel [rad/s].
    """

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


class DriverReading(NamedTuple):
    """What a robot reports about itself.

    Attributes:
        left_angle: Angle of the left wheel [rad; forward +, accumulated since the driver opened].
        right_angle: Angle of the right wheel [rad].
        left_speed: Measured speed of the left wheel [rad/s].
        right_speed: Measured speed of the right wheel [rad/s].
        battery: Charge [0..1]. NaN where the robot cannot tell.
        faults: Bits of ``RobotFault``. 0: healthy.
        sensors: Its other sensors. None: it has none, or ``DriverContext.sensors`` asks for none.
    """

    left_angle: float
    right_angle: float
    left_speed: float
    right_speed: float
    battery: float
    faults: int
    sensors: SensorReading | None = None


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """How far a simulated robot is from the ideal one. Spreads are half widths of a uniform draw made once.

    Attributes:
        motor_lag: Time constant of the wheel-speed loop [s].
        speed_quantum: One encoder count in one period of the loop [rad/s].
        loop_period: Period of the firmware's loop [s].
        deadband: A turning wheel stops when commanded less [rad/s].
        breakaway: A resting wheel stays at rest when commanded less (stiction) [rad/s].
        wheel_gain_spread: Spread of each wheel's travel, relative.
        wheel_base_spread: Spread of the wheel base, relative.
        slip: Share of a wheel's travel that is lost at a yaw rate of 1 rad/s [s/rad].
        slip_noise: Standard deviation of the slip, relative to it.
        top_speed_sag: Share of the top speed that is lost when the battery is empty.
        battery_life: Time from a full battery to an empty one [s].
        wheel_gain_error: Error of both wheels' travel, relative.
        wheel_gain_difference: Travel of the right wheel minus that of the left one, relative.
        wheel_base_error: Error of the wheel base, relative.
        top_speed_error: Error of the top speed, relative.
        wiring: How motors and encoders are connected.
        stop_lag: Time constant of a wheel that is commanded to stand [s]. None: as ``motor_lag``.
        actuation_delay: Time from a command's arrival until the wheels begin to follow it [s].
    """

    motor_lag: float
    speed_quantum: float
    loop_period: float
    deadband: float
    breakaway: float
    wheel_gain_spread: float
    wheel_base_spread: float
    slip: float
    slip_noise: float
    top_speed_sag: float
    battery_life: float
    wheel_gain_error: float = 0.0
    wheel_gain_difference: float = 0.0
    wheel_base_error: float = 0.0
    top_speed_error: float = 0.0
    wiring: Wiring = "straight"
    actuation_delay: float = 0.0
    stop_lag: float | None = None


class BodyTrouble(NamedTuple):
    """What is wrong with a simulated robot now.

    Attributes:
        stuck: Whether the motors stand still, whatever they are commanded.
        slip: Share of the wheels' travel that is lost.
        left: Speed at which the left wheel turns by itself [rad/s]. None: it obeys.
        right: The same of the right wheel [rad/s].
        pushed: Velocity by a hand along x and y [m/s; world].
    """

    stuck: bool = False
    slip: float = 0.0
    left: float | None = None
    right: float | None = None
    pushed: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """What only a simulated robot needs.

    Attributes:
        drive: Wheels and limits of its kind of robot.
        imperfections: How it differs from the ideal robot.
        start: Pose at the start: x, y [m], psi [rad; world].
        trouble: Returns what is wrong with it now. None: never anything.
        rng: Its random numbers.
        radius: Radius of the disc that others' distance sensors see [m].
        sensing: Its sensors. None: its wheels alone.
        plant: The plant that it shares with the other robots of its process. None: this project's own.
    """

    drive: DifferentialDrive
    imperfections: Imperfections
    start: tuple[float, float, float]
    trouble: Callable[[], BodyTrouble] | None
    rng: "np.random.Generator"
    radius: float = 0.0
    sensing: "Sensing | None" = None
    plant: "SharedPlant | None" = None


@dataclass(frozen=True, kw_only=True)
class WorldRobot:
    """A robot of a run, as the configuration has it.

    Attributes:
        robot: Its id.
        unit: Its driver process: robots of one unit share a process.
        drive: Its wheels and limits, as the controller assumes them.
        radius: Radius of the smallest disc about the axle's middle that covers it [m].
        start: Pose of the axle's middle: x, y [m], psi [rad; world]. None: not known.
    """

    robot: str
    unit: str
    drive: DifferentialDrive
    radius: float
    start: tuple[float, float, float] | None


@dataclass(frozen=True, kw_only=True)
class WorldObstacle:
    """Something on the floor that does not move: a disc about its only point, or a polygon.

    Attributes:
        name: Its name.
        points: A polygon's corners, counter-clockwise, or a disc's middle [m; world].
        radius: A disc's radius [m]. 0: a polygon.
        height: Height above the floor [m].
    """

    name: str
    points: tuple[tuple[float, float], ...]
    radius: float
    height: float


@dataclass(frozen=True, kw_only=True)
class World:
    """Everything that stands in the arena: what a driver that simulates physics builds its world from.

    World frame: origin at the arena's centre on the floor, x along ``size[0]``, y to the left, psi CCW from x.

    Attributes:
        size: Size of the arena along x and y [m].
        floor: Corners of the floor [m]. None: the whole rectangle.
        robots: All robots of the run, the driver's own too, in the configuration's order.
        obstacles: Everything on the floor that does not move.
    """

    size: tuple[float, float]
    floor: tuple[tuple[float, float], ...] | None
    robots: tuple[WorldRobot, ...]
    obstacles: tuple[WorldObstacle, ...]

    def unit(self, robot: str) -> tuple[WorldRobot, ...]:
        """Return the robots of one robot's driver process.

        Args:
            robot: The robot's id.

        Returns:
            The robots of its unit, itself too, in the configuration's order.

        Raises:
            KeyError: There is no such robot.
        """
        units = {each.robot: each.unit for each in self.robots}
        return tuple(each for each in self.robots if each.unit == units[robot])


@dataclass(frozen=True, kw_only=True)
class DriverContext:
    """What a driver is made from.

    Attributes:
        robot: The robot's id.
        drive: Its wheels and limits, as the controller assumes them.
        simulation: What a simulated robot is made from. None: the robot exists.
        now_ns: Returns the process's clock [ns].
        settings: ``robots[].settings`` as the class's own ``Settings``. None where the class has none.
        sensors: The sensors that ``read`` is to report. None: nobody asks for any.
        world: The arena with all robots and obstacles. None: the driver is made outside a run.
    """

    robot: str
    drive: DifferentialDrive
    simulation: Simulation | None
    now_ns: Callable[[], int]
    settings: Any = None
    sensors: "SensorKind | None" = None
    world: World | None = None


class DriverError(RobofleetError):
    """Raised where a robot cannot be driven. The message says what is wrong and how to mend it."""


class MisfitError(DriverError):
    """Raised where a robot answers its driver, and is not the one that is configured."""


class Driver(Protocol):
    """One robot. Found by the entry-point group ``robofleet.drivers``, or as ``module:Class`` in the config.

    The class is called with one :class:`DriverContext`, and returns when the robot has answered and stands; it may
    take some seconds for that, and raises :class:`DriverError` where it cannot. Whatever is raised afterwards stops
    and latches this robot alone: the driver is closed, and made again ever more patiently. A new driver's angles begin
    at zero; the process adds what was turned before, so that the published angles have no jump.

    Drivers are constructed one after the other, in the configuration's order. With ``concurrent`` a class is
    constructed in a thread of its own, at once with others, so that boards that take seconds to start are waited for
    together. It must share nothing with other drivers: no world, no device.

    A class may define what is no part of this protocol:

    - ``Settings``: a pydantic model of what ``robots[].settings`` may say.
    - ``refusals(settings, drive)``, a static method: returns what cannot work as (dotted path below the robot, what is
      wrong and how to mend it). ``robofleet check`` calls it before anything is opened.
    - ``body_faults = True``: ``context.simulation.trouble`` acts on its robot. Else faults of a body are refused.
    - ``concurrent = True``: see above.
    """

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels at once, without waiting for the robot. Only the gate calls it.

        Args:
            wheels: Speeds of the wheels [rad/s; forward +].

        Raises:
            DriverError: The robot cannot be commanded.
        """

    def read(self) -> DriverReading:
        """Return the newest reading, without waiting for the robot.

        Returns:
            Angles [rad] and speeds [rad/s] of the wheels, charge [0..1], faults, sensors.

        Raises:
            DriverError: The robot has not answered for 0.5 s, or cannot answer any more.
        """

    def close(self) -> None:
        """Switch the motors off and let go of the robot. Idempotent."""


def is_concurrent(kind: type) -> bool:
    """Return whether drivers of a class may be constructed at once."""
    return bool(getattr(kind, "concurrent", False))


@runtime_checkable
class SimulatedDriver(Protocol):
    """A driver whose robot does not exist: it also knows the truth, for the simulated camera and for the summary."""

    def truth(self) -> TruePose:
        """Return the true pose now.

        Returns:
            Pose [m, rad; world] and velocity [m/s, rad/s] of the axle's middle.
        """
