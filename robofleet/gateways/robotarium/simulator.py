"""What both versions of the Robotarium's interface have in common: poses in, velocities out, step by step."""

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robofleet.gateways.robotarium.drawing import Drawing
from robofleet.gateways.robotarium.runs import Run, Runs, Walls
from robofleet.scripts.fleet import FleetError

Array = NDArray[np.float64]

# The Robotarium's published values.
TIME_STEP = 0.033  # [s]
LENGTH, WIDTH = 3.2, 2.0  # of the arena [m]
ROBOT_DIAMETER = 0.11  # [m]
WHEEL_RADIUS = 0.016  # [m]
MAX_LINEAR_VELOCITY = 0.2  # [m/s]
MAX_WHEEL_VELOCITY = MAX_LINEAR_VELOCITY / WHEEL_RADIUS  # [rad/s]
MAX_ANGULAR_VELOCITY = 2 * MAX_LINEAR_VELOCITY / ROBOT_DIAMETER  # [rad/s]
COLLISION_OFFSET, COLLISION_DIAMETER = 0.025, 0.135  # [m]: of the points ahead of the axles, and how near is too near
_MOST_ROBOTS = 50  # of the original
_UTILITIES = "rps.utilities.misc"


class Simulator:
    """A fleet as a script of the Robotarium sees it. Each is a run of its own."""

    runs: ClassVar[Runs]  # of the script: the class that it gets has them
    _base: ClassVar[float]  # between the wheels, by which the version judges their speeds [m]

    def __init__(
        self, number_of_robots: Any, show_figure: Any, sim_in_real_time: Any, initial_conditions: Any,
        draw: Callable[[int], Array], sensors: bool = False, walls: Walls | None = None,
    ) -> None:  # fmt: skip
        """Begin a run. ``draw`` returns random poses (3, N) where the script has none.

        AssertionError where the script says what the original refuses; FleetError and ConfigError where there is no
        such run.
        """
        for name, value, kind in (
            ("number_of_robots", number_of_robots, int), ("show_figure", show_figure, bool),
            ("sim_in_real_time", sim_in_real_time, bool), ("initial_conditions", initial_conditions, np.ndarray),
        ):  # fmt: skip
            assert isinstance(value, kind), f"{name} must be of {kind.__name__}, not {type(value).__name__}"
        assert 0 <= number_of_robots <= _MOST_ROBOTS, (
            f"number_of_robots is {number_of_robots}, must be 0 to {_MOST_ROBOTS}"
        )
        n, most = number_of_robots, self.runs.most
        if not 0 < n <= most:
            config = self.runs.wanted.config
            mend = "ask for at least one" if n < 1 else "ask for fewer, or name a configuration that has them"
            raise FleetError(f"the script asks for {n} robots, {config} has {most}: {mend}")
        shape = initial_conditions.shape
        assert initial_conditions.size == 0 or shape == (3, n), f"initial_conditions is {shape}, must be (3, {n})"
        starts = draw(n) if initial_conditions.size == 0 else np.array(initial_conditions, np.float64)
        self.number_of_robots, self.show_figure = n, show_figure
        self._drawing = self._drawn(starts) if show_figure else None
        self._run: Run = self.runs.begin(starts, sensors=sensors, walls=walls)
        if self._drawing is not None:
            self._run.pictures.append(self._drawing)
        self._measured = self._run.poses
        self._commanded = np.zeros((2, n))
        self._called_step_already, self._checked_poses_already = True, False
        self._errors: dict[str, Any] = {}
        self._steps = 0

    def _drawn(self, poses: Array) -> Drawing:
        bounds = -LENGTH / 2, LENGTH / 2, -WIDTH / 2, WIDTH / 2
        return Drawing(poses, bounds, ROBOT_DIAMETER, not self.runs.wanted.quiet)

    def get_poses(self) -> Array:
        """Return x, y [m], psi [rad] of the robots (3, N), once a step."""
        assert not self._checked_poses_already, "get_poses() may be called once per step()"
        self._called_step_already, self._checked_poses_already = False, True
        return self._seen()

    def step(self) -> None:
        """Drive until the next tick."""
        assert not self._called_step_already, "call get_poses() before step()"
        self._called_step_already, self._checked_poses_already = True, False
        self._judge(self._measured, self._wheels(self._commanded))
        self._steps += 1
        self._run.step(self._let_through())
        self._measured[:] = self._run.poses  # version 1 shows them in the array that the script has
        if self._drawing is not None:
            self._drawing.update(self._measured)

    def _seen(self) -> Array:
        return self._measured.copy()

    def _let_through(self) -> Array:
        """Return the velocities that the version lets the robots have."""
        return self._commanded

    def _judge(self, poses: Array, wheels: Array) -> None:
        """Count what the original calls errors."""
        raise NotImplementedError

    def _report(self, title: str, lines: list[str]) -> None:
        with_errors = lines or ["no errors"]
        print(f"{title}: {self._steps} steps, {self._steps * TIME_STEP:.1f} s on the Robotarium")
        for line in with_errors:
            print(f"  {line}")
        if self._run is self.runs.run:
            self._run.stand()

    def _wheels(self, velocities: Array) -> Array:
        """Return the wheels' speeds (2, N) [rad/s]: left, right."""
        v, turn = velocities[0], velocities[1] * self._base / 2
        return np.vstack([v - turn, v + turn]) / WHEEL_RADIUS

    def _take(self, ids: ArrayLike, velocities: Any) -> None:
        commanded, most = np.asarray(velocities, np.float64), self.number_of_robots
        shape = commanded.shape
        assert len(shape) == 2 and shape[1] <= most, f"velocities is {shape}, must be (2, 1 to {most})"
        self._commanded[:, np.asarray(ids, np.intp).ravel()] = commanded


def outside(poses: Array) -> NDArray[np.bool_]:
    return np.asarray((np.abs(poses[0]) > LENGTH / 2) | (np.abs(poses[1]) > WIDTH / 2))


def collided(poses: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs of robots that are too close, the lower numbers first."""
    ahead = poses[:2] + COLLISION_OFFSET * np.vstack([np.cos(poses[2]), np.sin(poses[2])])
    apart = np.hypot(*(ahead[:, :, None] - ahead[:, None, :]))
    first, other = np.nonzero(np.triu(apart <= COLLISION_DIAMETER, 1))
    return first, other


def utility(name: str) -> Callable[..., Any]:
    """Return a function of the user's installed utilities; FleetError where they do not have it."""
    found = getattr(import_module(_UTILITIES), name, None)
    if found is None:
        where = getattr(sys.modules[_UTILITIES], "__file__", _UTILITIES)
        raise FleetError(f"{where} has no {name}: the installed rps is of the other version: say --api 1 or --api 2")
    result: Callable[..., Any] = found
    return result
