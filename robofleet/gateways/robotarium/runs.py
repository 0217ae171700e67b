"""The runs of a script: each ``Robotarium(...)`` that it makes is one, and ends when the next one begins."""

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.gateways.robotarium.drawing import Drawing
from robofleet.runs import folder as folders
from robofleet.scripts.fleet import Fleet, FleetError
from robofleet.vehicles.readings import SensorReading

Array = NDArray[np.float64]
Walls = Sequence[Sequence[float]]  # x1, y1, x2, y2 [m; world] of each


@dataclass(frozen=True)
class Wanted:
    """How a script's runs are made."""

    config: Path
    name: str  # the script's, for folders
    real_time: bool = False
    ideal: bool = False  # simulated robots have no errors
    changes: tuple[str, ...] = ()  # KEY=VALUE
    out: Path | None = None
    quiet: bool = False


class Runs:
    """The runs of a script, one after the other."""

    def __init__(self, wanted: Wanted) -> None:
        """Take how they are made; ConfigError where the configuration is none."""
        self.wanted = wanted
        self._config = load_config(wanted.config, wanted.changes)
        self._default = folders.new(wanted.name)
        self._count = 0
        self.moved = False  # in some run, by a step
        self.run: Run | None = None  # that is on
        self.last: Run | None = None  # that has begun

    @property
    def most(self) -> int:
        return len(self._config.members)

    def begin(self, starts: Array, *, sensors: bool = False, walls: Walls | None = None) -> "Run":
        """Begin a run of as many robots as ``starts`` has poses x, y [m], psi [rad] (3, N), and let them stand there.

        FleetError where that cannot be; ConfigError where the configuration says why.
        """
        self.end()
        self._count += 1
        fleet = Fleet(
            self.wanted.config, lockstep=not self.wanted.real_time, out=self._folder(),
            robots=starts.shape[1], settings=[*self.wanted.changes, *self._settings(starts, sensors, walls)],
        )  # fmt: skip
        self.run = Run(fleet.open())
        self.last = self.run
        if not placed(self._config):
            self.run.go_to(starts)
        return self.run

    def end(self, failed: str | None = None) -> None:
        """End the run that is on; ``failed``: why its script ends."""
        run, self.run = self.run, None
        if run is not None:
            self.moved |= run.steps > 0
            run.end(failed)

    def _folder(self) -> Path:
        first = self.wanted.out or self._default
        return first if self._count == 1 else first.with_name(f"{first.name}-{self._count}")

    def _settings(self, starts: Array, sensors: bool, walls: Walls | None) -> Iterator[str]:
        """Yield the keys of the configuration that the script decides."""
        members = [robot.id for robot in self._config.members][: starts.shape[1]]
        rows = {robot.id: row for row, robot in enumerate(self._config.robots)}
        for index, (x, y, psi) in enumerate(starts.T.tolist()):
            key, robot = f"robots.{rows[members[index]]}", self._config.robot(members[index])
            if self.wanted.ideal and robot.driver == "simulated":
                yield f"{key}.vehicle=ideal"
            if placed(self._config):
                degrees = math.degrees(math.remainder(psi, math.tau))
                yield f"{key}.start={{x_m: {x:.9f}, y_m: {y:.9f}, heading_deg: {degrees:.9f}}}"
            if sensors and robot.vehicle.sensors is not None:
                yield f"{key}.sensors=true"
        if walls is not None and sensors:
            yield f"arena.walls={[[float(number) for number in wall] for wall in walls]}"


def placed(config: Config) -> bool:
    """Return whether robots stand where a configuration says, because all are simulated."""
    return all(robot.driver == "simulated" or robot.twin is not None for robot in config.members)


class Run:
    """A run that a script drives, tick by tick."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.robots, self.config, self.folder = fleet.robots, fleet.config, fleet.folder
        self.pictures: list[Drawing] = []  # in which the script draws
        self.steps = 0
        self._sensed: tuple[SensorReading | None, ...] | None = None  # at this tick
        self._ticks: Iterator[float] | None = None  # of the loop that the script is in
        self._next()
        self._first = self._angles()

    @property
    def poses(self) -> Array:
        """x, y [m], psi [rad] of the robots (3, N), as they are measured."""
        return np.ascontiguousarray(self.fleet.poses.T)

    @property
    def sensors(self) -> tuple[SensorReading | None, ...]:
        """What the robots' sensors say, by the project's conventions."""
        if self._sensed is None:
            self._sensed = self.fleet.sensors
        return self._sensed

    @property
    def turned(self) -> Array:
        """How far the wheels have turned since the beginning (2, N) [rad]: left, right."""
        return self._angles() - self._first

    def _angles(self) -> Array:
        readings = self.fleet.readings
        return np.vstack([readings["left_angle_rad"], readings["right_angle_rad"]]).astype(np.float64)

    def step(self, velocities: Array) -> None:
        """Drive with v [m/s], omega [rad/s] (2, N) until the next tick; FleetError where there is none."""
        self.fleet.drive(velocities.T)
        self.steps += 1
        self._next()

    def go_to(self, poses: Array) -> None:
        """Bring the robots to poses x, y [m], psi [rad] (3, N), round each other."""
        self.stand()
        goals = {
            robot: (x, y, math.degrees(psi)) for robot, (x, y, psi) in zip(self.robots, poses.T.tolist(), strict=True)
        }
        try:
            self.fleet.go_to(goals)
        except ValueError as error:
            raise FleetError(f"the robots cannot go to the initial conditions: {error}") from error

    def stand(self) -> None:
        """Let the robots stand until the next step, however long that takes."""
        ticks, self._ticks = self._ticks, None
        if isinstance(ticks, Generator):
            ticks.close()

    def end(self, failed: str | None = None) -> None:
        """End it, and keep its pictures; ``failed``: why the script ends."""
        self.stand()
        poses = self.poses
        self.fleet.close(failed)
        for number, picture in enumerate(self.pictures if self.folder is not None else (), 1):
            picture.save(self.folder / f"figure{number}.png", poses)  # type: ignore[operator]

    def _next(self) -> None:
        if self._ticks is None:
            self._ticks = self.fleet.ticks(resume=True)
        next(self._ticks)
        self._sensed = None
