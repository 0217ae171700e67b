"""What a behaviour is: what the robots of a group decide at each tick, and everything that is the behaviour's own.

A behaviour is a subclass of :class:`Behaviour`, found by an entry point of ``robofleet.behaviours`` or as
``module:Class``. It gets arrays and returns arrays; it sees no bus, no clock and no configuration but its own. What it
tells of itself is data: figures (names and units), references and shapes (points and lines), measures (arrays). The
recording, the report, the page, the terminal and the viewers draw that data and know no behaviour.

World frame: x and y in metres from the arena's centre, psi in radians, counter-clockwise. N is the number of the
group's robots, in the group's order. The *point ahead* p of a robot is ``point_ahead`` [m] in front of its axle.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.settings import Model
from robofleet.safety.distances import Body, Keepout
from robofleet.safety.starts import Reason
from robofleet.safety.supervisor import Event
from robofleet.vehicles.differential_drive import DifferentialDrive

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pose = tuple[float, float, float]  # x, y [m], psi [rad]

_SHOWN = {("m", "mm"): 1e3, ("rad", "deg"): 180.0 / math.pi, ("m/s", "mm/s"): 1e3}
_ROUNDING = 1e-9


class Flow(NamedTuple):
    """Parameters of the Newton-Raphson flow, as ``controller`` in the configuration has them."""

    alpha: float  # [1/s]
    horizon: float  # T [s]
    integrator: Literal["exact", "euler"]


@dataclass(frozen=True, kw_only=True)
class Team:
    """What a behaviour knows of its group."""

    name: str  # of the group
    robots: tuple[str, ...]  # ids
    drives: tuple[DifferentialDrive, ...]
    bodies: tuple[Body, ...]  # for ``safety.barrier.apart`` and ``from_edge``: what the barrier keeps
    starts: tuple[Pose | None, ...]  # of the robots' centres, where the behaviour begins from known ones
    bystanders: tuple[tuple[str, Body, Pose | None], ...]  # robots in no group: id, body, start
    keepout: Keepout
    arena: tuple[float, float]  # size along x and y [m]
    tick: float  # control step [s]
    delay: float  # from a tick to the moment when the first robot's command acts [s]
    point_ahead: float  # l [m]
    flow: Flow
    rng: "np.random.Generator"  # the same for the same seed

    def __len__(self) -> int:
        """Return N."""
        return len(self.robots)


class WishKind(IntEnum):
    """What a script wishes that its robots do."""

    STAND = 0  # until it says something else, however long that takes
    BODY = 1  # v [m/s] and omega [rad/s] of the bodies
    POINT = 2  # velocities of the points ahead: x, y [m/s; world]
    POSES = 3  # to go to poses: x, y [m], psi [rad] of the centres [world]
    DONE = 4  # nothing more: the script has done all that it was to do
    FAILED = 5  # nothing more: the script has ended by an error
    RESCUE = 6  # of a person: as BODY, of the one robot that is driven out of a held run


@dataclass(frozen=True, kw_only=True)
class Wish:
    """The newest word of a script that drives a group from a process of its own."""

    kind: WishKind
    values: Array  # (N, 3), as ``kind`` says: of BODY and POINT the last column means nothing; 0 where not ``told``
    told: Flags  # (N,) which robots it is about: the others stand
    order: int  # counts a script's journeys: of POSES with the same number there is one plan
    age: float  # since the tick by which the script wished it, by the controller's ticks [s]
    epoch: int  # drawn when the script began
    seq: int


@dataclass(frozen=True, kw_only=True)
class Situation:
    """What a behaviour decides by: everything at the moment when the tick's commands act."""

    t: float  # since the group's start [s]
    poses: Array  # (N, 3) of the centres: x, y [m], psi [rad]
    driving: Flags  # (N,) which robots may drive: the others stand, whatever is decided
    disturbance: Array  # (N, 2) velocity of the points ahead beyond what was asked, as estimated [m/s; world]; else 0
    others: Array  # (M, 3): x, y, body radius [m] of every other robot in the arena that was seen
    wish: Wish | None = None  # of a behaviour that ``takes_wishes``: the newest since the run went on; None: none yet

    def points(self, ahead: float) -> Array:
        """Return the points (N, 2) that are ``ahead`` [m] in front of the axles [m]."""
        psi, points = self.poses[:, 2], np.empty((len(self.poses), 2))
        np.cos(psi, out=points[:, 0])
        np.sin(psi, out=points[:, 1])
        points *= ahead
        points += self.poses[:, :2]
        return points


class Decision(NamedTuple):
    """What a behaviour decided.

    ``velocities`` (N, 2) are what the robots are to do: of their points ahead [m/s; world frame], or with
    ``of="body"`` the bodies' own v [m/s] and omega [rad/s]. Wheels that cannot do all of it are slowed together, and
    the barrier may change the rest: ``Behaviour.changed`` tells.
    """

    velocities: Array
    of: Literal["point", "body"] = "point"
    references: Array | None = None  # (N, 2) where each robot's followed point is to be [m; world]; NaN: nowhere
    figures: Mapping[str, Array | float] = {}  # by the figures' names: (N,), or one value for all; missing: NaN
    hold: Event | None = None  # why the group stands at once and the run is to be held, where it is


class Figure(NamedTuple):
    """A figure that a behaviour tells of each robot at each tick."""

    name: str  # small letters, digits and _, without the unit: "control_error"
    unit: str = ""  # "m", "rad", "m/s"; empty: a plain number
    shown: str = ""  # the unit for people and for summary.json: "mm" of m, "deg" of rad; empty: ``unit``
    meaning: str = ""  # a sentence
    live: bool = True  # a column of the terminal and of the page

    @property
    def key(self) -> str:
        """Name in its own unit, in which a tick of the recording has it: ``control_error_m``."""
        return with_unit(self.name, self.unit)

    @property
    def shown_key(self) -> str:
        """Name in ``summary.json``, in ``metrics.csv`` and in the viewers' messages: ``control_error_mm``."""
        return with_unit(self.name, self.shown or self.unit)

    @property
    def scale(self) -> float:
        """What a value is multiplied by to be shown."""
        return scale(self.unit, self.shown)


def with_unit(name: str, unit: str) -> str:
    """Return a name that ends in its unit: ``speed_m_s``."""
    return f"{name}_{unit.replace('/', '_')}" if unit else name


def scale(unit: str, shown: str) -> float:
    """Return the factor from a unit to the one that is shown; ValueError where there is none."""
    if not shown or shown == unit:
        return 1.0
    if (unit, shown) not in _SHOWN:
        raise ValueError(f"{unit!r} cannot be shown in {shown!r}: use one of {sorted(_SHOWN)}")
    return _SHOWN[unit, shown]


class Line(NamedTuple):
    """A line that is drawn on the floor; one that has the name of a robot has its colour."""

    name: str
    points: Array  # (M, 2) [m; world]
    closed: bool = False
    directed: bool = False  # it is driven in the points' order: arrows are drawn on it


class Dots(NamedTuple):
    """Points that are drawn on the floor, one colour for each robot where there are N."""

    name: str
    points: Array  # (M, 2) [m; world]


Shape = Line | Dots


class Refusal(NamedTuple):
    """Something that cannot work."""

    key: str  # "settings.path_rate" or "robots.1" of the group; "r2.start": of the robot r2; else from the root
    message: str  # what is wrong and how to mend it


@dataclass(frozen=True)
class Bound:
    """One thing that was looked at before a run: a value, and its limit (at most, at least, or ``strict``: less)."""

    path: str  # as a Refusal's key
    what: str
    value: float
    limit: float
    unit: str
    mend: str
    at_least: bool = False
    strict: bool = False

    @property
    def tightness(self) -> float:
        """Up to 1 when the bound holds."""
        used, available = (self.limit, self.value) if self.at_least else (self.value, self.limit)
        return used / available if available > 0 else math.inf

    @property
    def holds(self) -> bool:
        """Whether the bound is kept."""
        return self.tightness <= 1 + (-_ROUNDING if self.strict else _ROUNDING)


class Start(NamedTuple):
    """What a behaviour says of a start, before a wheel turns."""

    jam: Reason | None = None  # two robots that would not get past each other
    arrived_s: Sequence[float] = ()  # when each robot is where the behaviour wants it; infinite: not soon
    rows: Sequence[tuple[str, str, str, str]] = ()  # for a table: (what, value, limit, note)
    warnings: Sequence[tuple[float, str]] = ()  # what may take long: how long [s], and a sentence


@dataclass(frozen=True, kw_only=True)
class Past:
    """What became of a group: K ticks while the fleet ran."""

    t: Array  # (K,) since the start [s]
    poses: Array  # (K, N, 3) of the centres: true where ``known``, else as estimated
    points: Array  # (K, N, 2) of the points ahead
    known: Flags  # (N,) whose true poses were told
    settled: Flags  # (K,) ticks after ``run.settle_s``: of these the figures count
    spaced: Flags  # (K,) ticks after ``run.spacing_settle_s``: of these the true errors count
    references: Array  # (K, N, 2); NaN: none
    figures: Mapping[str, Array]  # (K, N) by the figures' names; NaN: not told


class Measure(NamedTuple):
    """Something that was measured of a group after a run, in columns."""

    name: str  # as a Figure's
    unit: str
    values: Array  # (K, n); NaN: not known
    of: tuple[str, ...]  # what each of the n columns is about: robots' ids, or pairs of them
    shown: str = ""
    meaning: str = ""
    asked: float | None = None  # what the values should be


class Behaviour:
    """A behaviour of a group. Only ``decide`` must be written; everything else has a default."""

    class Settings(Model):
        """Keys of ``groups[].settings``, with units in their names, limits and defaults."""

    figures: ClassVar[Sequence[Figure]] = ()
    takes_wishes: ClassVar[bool] = False  # of a script: ``Situation.wish``

    def __init__(self, settings: Any, team: Team) -> None:
        """Keep what it is made of: ``settings`` is an instance of the class's own ``Settings``.

        Raises:
            ValueError: if the settings are impossible for this group; ``refusals`` says it better.
        """
        self.settings = settings
        self.team = team

    def decide(self, now: Situation) -> Decision:
        """Return what the robots do in the next tick. It must take less than a few milliseconds."""
        raise NotImplementedError

    def restart(self) -> None:
        """Begin a new run: forget what was."""

    def changed(self, velocities: Array) -> None:
        """Hear what the robots are really asked for: velocities (N, 2) of their points ahead [m/s; world]."""

    def carried(self, robot: int) -> None:
        """Hear that a robot was carried away (the kidnapped robot): what was known of its progress is wrong."""

    @property
    def arrived(self) -> bool:
        """Whether it has done all that it was to do: a run ends then. Most behaviours never have."""
        return False

    def places(self) -> Sequence[Pose] | None:
        """Return where its robots' centres stand at the beginning; None: anywhere."""
        return None

    def start(self, poses: Sequence[Pose]) -> Start:
        """Judge a start from these poses of the centres, before a wheel turns."""
        return Start()

    def bounds(self) -> Iterable[Bound]:
        """Yield what must hold before a run: inside the arena, wheel speeds, distances against the barrier."""
        return ()

    def refusals(self) -> Iterable[Refusal]:
        """Yield what cannot work and is no bound."""
        return ()

    def shapes(self) -> Sequence[Shape]:
        """Return what is drawn on the floor for it."""
        return ()

    def measures(self, past: Past) -> Sequence[Measure]:
        """Return what is measured afterwards beyond its figures: of each tick by itself.

        A long run is measured part by part, and as a whole by every n-th tick of it.
        """
        return ()

    def summary(self, past: Past) -> dict[str, Any]:
        """Return its part of ``summary.json``: by default mean, ``max`` and each robot's mean of figures and
        measures. ``max`` is the largest magnitude: a figure may have a sign.

        A figure that was not measured is None.
        """
        told = [
            Measure(f.name, f.unit, past.figures[f.name], self.team.robots, f.shown, f.meaning) for f in self.figures
        ]
        return {
            with_unit(m.name, m.shown or m.unit): statistics(m.values[past.settled] * scale(m.unit, m.shown))
            for m in [*told, *self.measures(past)]
        }


def statistics(values: Array) -> dict[str, Any] | None:
    """Return mean, largest magnitude and each column's mean of values (K, n), without those that are not known.

    Means keep the values' sign: the mean of a signed figure is its bias.
    """
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    each = [rounded(column[np.isfinite(column)].mean()) if np.isfinite(column).any() else None for column in values.T]
    return {"mean": rounded(known.mean()), "max": rounded(np.abs(known).max()), "per_robot_mean": each}


def rounded(value: float, digits: int = 4) -> float:
    """Return a number as ``summary.json`` has it."""
    return round(float(value), digits)
