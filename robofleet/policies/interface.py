"""What a task is: where episodes begin, what each robot observes, what it earns, and when an episode is over.

A task is a subclass of :class:`Task`, found by an entry point of ``robofleet.tasks`` or as ``module:Class``. It works
on arrays with a leading axis of arenas: thousands in an environment (``robofleet.envs``), one in a run, where the
behaviour ``policy`` asks it for the observation alone. So a policy observes the same there as where it was trained.

World frame: x and y in metres from the arena's centre, psi in radians, counter-clockwise. A is the number of arenas,
N that of the group's robots, in the group's order.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robofleet.behaviours.interface import Refusal, Shape, Team
from robofleet.core.arrays import Array, Array32, Flags, Indices
from robofleet.core.plugins import PluginError, load
from robofleet.core.settings import Model
from robofleet.policies import observations

GROUP = "robofleet.tasks"  # of entry points
LARGEST = 10.0  # number that a network gets: what lies beyond is cut off


class Term(NamedTuple):
    """A part of what a robot observes.

    Attributes:
        name: Small letters, digits and _.
        size: How many numbers it is.
        unit: Their unit before they are divided by ``scale``. Empty: plain numbers.
        scale: What they are divided by for the network [unit].
    """

    name: str
    size: int
    unit: str = ""
    scale: float = 1.0


MOTION = Term("speed", 1, "m/s", 0.2), Term("turn_rate", 1, "rad/s", 3.0)  # of a robot itself


@dataclass(frozen=True, kw_only=True)
class TaskView:
    """The arenas (A,) at one tick, when its commands act.

    Attributes:
        t: Time since the episode's start (A,) [s].
        poses: Poses of the centres (A, N, 3): x, y [m], psi [rad; world], as measured and predicted.
        velocities: What the robots were commanded at the tick before (A, N, 2), after the wheels' limits and the
            barrier: v [m/s] and omega [rad/s] of the bodies.
        others: Every other robot (A, M, 3): x, y [m; world], body radius [m].
        team: What is known of the group.
    """

    t: Array
    poses: Array
    velocities: Array
    others: Array
    team: Team

    @cached_property
    def gaps(self) -> Array:
        """Distance (A, N) of each body from the nearest body, obstacle or edge [m]; below 0: they overlap."""
        radii = np.array([body.radius for body in self.team.bodies])
        return observations.gaps(self.poses, self.others, radii, self.team.arena, self.team.keepout.solids)


class Task:
    """A task of a group. ``terms``, ``observe`` and ``reward`` must be written; everything else has a default.

    Attributes:
        duration_s: An episode is cut off after so long [s].
        settings: An instance of the class's own ``Settings``.
        team: What is known of the group.
        arenas: A.
    """

    class Settings(Model):
        """Keys of the task's settings, with units in their names, limits and defaults."""

    duration_s: ClassVar[float] = 20.0

    def __init__(self, settings: Any, team: Team, arenas: int) -> None:
        """Keep what it is made of."""
        self.settings, self.team, self.arenas = settings, team, arenas

    @property
    def terms(self) -> Sequence[Term]:
        """What each robot observes, in the order of ``observe``."""
        raise NotImplementedError

    def observe(self, view: TaskView) -> Sequence[Array]:
        """Return what each robot observes: an array (A, N, size) for each of ``terms``, in its unit."""
        raise NotImplementedError

    def reward(self, view: TaskView) -> Array:
        """Return what each robot earns by the tick that ends here (A, N)."""
        raise NotImplementedError

    def done(self, view: TaskView) -> Flags:
        """Return in which arenas (A,) the task is done, or failed for good: the episode ends there."""
        return np.zeros(self.arenas, dtype=np.bool_)

    def starts(self, count: int, rng: "np.random.Generator") -> Array:
        """Return where the robots of ``count`` new episodes stand (count, N, 3). By default anywhere, with free way."""
        return observations.drawn_poses(self.team, count, rng)

    def begin(self, arenas: Indices, poses: Array, rng: "np.random.Generator") -> None:
        """Begin an episode.

        Args:
            arenas: In which arenas (K,). In a run it is the only one.
            poses: Where the robots stand there (K, N, 3).
            rng: For goals that are drawn where the settings give none.
        """

    def refusals(self) -> Iterable[Refusal]:
        """Return what cannot work: a key of the settings, and a line that says how to mend it."""
        return ()

    def shapes(self) -> Sequence[Shape]:
        """Return what page, report and viewers draw on the floor of the first arena."""
        return ()


def load_task(name: str) -> type[Task]:
    """Return a task's class by its name, or as ``module:Class``; PluginError where there is none."""
    found: type[Task] = load(GROUP, name)
    if not issubclass(found, Task):
        raise PluginError(f"{name!r} is not a task: derive it from robofleet.policies.Task")
    return found


def observed(task: Task, view: TaskView) -> Array32:
    """Return what a network gets (A, N, F): all terms side by side, each divided by its scale, within ``LARGEST``.

    Raises:
        ValueError: ``observe`` does not return what ``terms`` says.
    """
    found, terms = task.observe(view), task.terms
    shapes = [np.shape(array) for array in found]
    expected = [(*view.poses.shape[:2], term.size) for term in terms]
    if shapes != expected:
        raise ValueError(f"{type(task).__name__}.observe returned shapes {shapes}; `terms` says {expected}")
    numbers, begin = np.empty((*view.poses.shape[:2], width(task)), dtype=np.float32), 0
    for array, term in zip(found, terms, strict=True):
        np.divide(array, term.scale, out=numbers[..., begin : begin + term.size], casting="unsafe")
        begin += term.size
    return np.clip(numbers, -LARGEST, LARGEST, out=numbers)


def width(task: Task) -> int:
    """Return F: how many numbers a robot observes."""
    return sum(term.size for term in task.terms)


def velocities(actions: Array | Array32, team: Team) -> Array:
    """Return what actions (..., N, 2) in [-1, 1] ask for: v [m/s] and omega [rad/s], as shares of the top speeds."""
    return np.asarray(np.clip(actions, -1.0, 1.0, dtype=np.float64) * top_speeds(team))


def top_speeds(team: Team) -> Array:
    """Return what the robots (N, 2) can do at most: v straight on [m/s], and omega on the spot [rad/s]."""
    return np.array([(d.max_speed, 2.0 * d.wheel_radius * d.max_wheel_speed / d.wheel_base) for d in team.drives])
