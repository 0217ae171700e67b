"""Plants: physics in the place of this project's own, and the robots that live in one.

A plant moves the bodies of all robots of a process in one world. It knows wheel setpoints and durations alone. The
rest is that of every simulated robot (``plant.py``): commands that act late or end by themselves, encoders that count,
a battery.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from robofleet.core.arrays import Array
from robofleet.vehicles.interface import BodyTrouble, DriverReading, WheelSpeeds, World
from robofleet.vehicles.plant import (
    NEVER_NS,
    Build,
    Coming,
    Plant,
    act,
    befall,
    capacity,
    command,
    placed,
    setpoints,
)
from robofleet.vehicles.readings import TruePose

_NS = 1e-9


@dataclass(frozen=True, kw_only=True)
class PlantRobot:
    """A robot of a plant.

    Attributes:
        robot: Its id.
        build: How it was built: of one seed the same draws as in this project's own plant.
        start: Pose of the axle's middle at first: x, y [m], psi [rad; world].
        radius: Radius of the smallest disc about the axle's middle that covers it [m].
        height: Height of its tag above the floor [m].
    """

    robot: str
    build: Build
    start: tuple[float, float, float]
    radius: float
    height: float


@dataclass(frozen=True, kw_only=True)
class PlantContext:
    """What a plant is made from.

    Attributes:
        robots: The robots (N,) that it moves, in the order of every array.
        world: The arena with its obstacles.
        settings: ``plant.settings`` as the class's own ``Settings``. None where the class has none.
        rng: Its random numbers, of the run's seed.
    """

    robots: tuple[PlantRobot, ...]
    world: World
    settings: Any
    rng: np.random.Generator


class PlantState(NamedTuple):
    """Where the robots (N,) of a plant are, and how they move.

    Attributes:
        poses: Poses of the axles' middles (N, 3): x, y [m], psi [rad; world].
        velocities: Velocities (N, 2): along the heading [m/s], of the heading [rad/s].
        angles: Angles of the wheels (N, 2), left and right [rad; forward +, accumulated].
        speeds: Speeds of the wheels (N, 2) [rad/s].
    """

    poses: Array
    velocities: Array
    angles: Array
    speeds: Array


class FleetPlant(Protocol):
    """The bodies of all robots (N,) of a process, with their motors and wheel-speed loops.

    Found by the entry-point group ``robofleet.plants``, or as ``module:Class`` in ``plant.model``. The class is called
    with one :class:`PlantContext`. It may define what is no part of this protocol:

    - ``Settings``: a pydantic model of what ``plant.settings`` may say.
    - ``refusals(settings, robots)``, a static method: returns what cannot work, with the ids of all robots, as (dotted
      path below ``plant``, what is wrong and how to mend it). ``robofleet check`` calls it before a plant is made.
    """

    def step(self, setpoints: Array, duration: float) -> None:
        """Let time pass, in steps of the plant's own choice.

        Args:
            setpoints: Speeds (N, 2) that the wheel-speed loops aim at, left and right [rad/s; forward +].
            duration: How long they stay the same [s], above 0.
        """

    def state(self) -> PlantState:
        """Return the state now.

        Returns:
            Arrays that no later step changes.
        """


class SharedPlant:
    """The robots (N,) of a plant, which share its time: whoever lets it pass lets it pass for all.

    The plant is stepped when a robot is commanded or read: twins let time pass with every byte.
    """

    def __init__(self, plant: FleetPlant, robots: Sequence[PlantRobot], now_ns: int) -> None:
        self._plant, self._reached_ns, self._now_ns = plant, now_ns, now_ns
        self._robots = {robot.robot: PlantedRobot(self, robot, now_ns) for robot in robots}

    def robot(self, robot: str, trouble: Callable[[], BodyTrouble] | None = None) -> "PlantedRobot":
        """Return a robot by its id; ``trouble`` returns what is wrong with it now."""
        found = self._robots[robot]
        found.trouble = trouble
        return found

    def others(self, robot: str) -> list[tuple[TruePose, float]]:
        """Return where the other robots truly are, and the radii of their bodies [m]."""
        return [(other.truth(), other.radius) for name, other in self._robots.items() if name != robot]

    def advance(self, now_ns: int) -> None:
        """Let time pass until then [ns]; the past changes nothing."""
        self._now_ns = max(self._now_ns, now_ns)

    def catch_up(self) -> None:
        """Step the plant up to the present, cut where commands begin to act."""
        robots, now_ns = self._robots.values(), self._now_ns
        if now_ns == self._reached_ns:
            return
        for robot in robots:
            robot.suffer()
        while self._reached_ns < now_ns:
            until_ns = min(now_ns, *(robot.obey(self._reached_ns) for robot in robots))
            duration = (until_ns - self._reached_ns) * _NS
            self._plant.step(np.array([robot.setpoints for robot in robots]), duration)
            self._reached_ns = until_ns
        state = self._plant.state()
        for robot, *rows in zip(robots, *(array.tolist() for array in state), strict=True):
            robot.arrive(now_ns, *rows)


class PlantedRobot(Plant):
    """One robot of a shared plant: to its driver, and to its firmware's twin, a robot like any other."""

    def __init__(self, shared: SharedPlant, robot: PlantRobot, now_ns: int) -> None:
        self._shared, self._p, self._b = shared, robot.build, placed(robot.start, now_ns)
        self.radius, self._began_ns = robot.radius, now_ns
        self._coming = [Coming() for _ in range(capacity(self._p.delay_ns))]
        self.trouble: Callable[[], BodyTrouble] | None = None

    def write(self, wheels: WheelSpeeds, *, off_ns: int = NEVER_NS) -> None:
        self._shared.catch_up()
        super().write(wheels, off_ns=off_ns)

    def advance(self, now_ns: int) -> None:
        self._shared.advance(now_ns)

    def reading(self) -> DriverReading:
        self._shared.catch_up()
        return super().reading()

    def truth(self) -> TruePose:
        self._shared.catch_up()
        return super().truth()

    def suffer(self) -> None:
        if self.trouble is not None:
            befall(self._b, self.trouble())

    def obey(self, now_ns: int) -> int:
        """Let the commands act that are due; returns when the next one is [ns]."""
        b = self._b
        b.reached_ns = now_ns
        if now_ns >= b.off_ns:
            command(b, self._p, self._coming, 0.0, 0.0, NEVER_NS)
        act(b, self._coming)
        next_ns = self._coming[b.first].at_ns if b.waiting else NEVER_NS
        return min(next_ns, b.off_ns)

    @property
    def setpoints(self) -> tuple[float, float]:
        """What the loops of its wheels, left and right, aim at [rad/s]."""
        return (0.0, 0.0) if self._b.stuck else setpoints(self._b, self._p)

    def arrive(self, now_ns: int, *rows: list[float]) -> None:
        """Take a row of the plant's state at an instant [ns]."""
        b = self._b
        b.reached_ns, b.used = now_ns, (now_ns - self._began_ns) * _NS
        (b.x, b.y, b.psi), (b.v, b.omega), (b.left_angle, b.right_angle), (b.left_speed, b.right_speed) = rows
