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

from robofleet.core.arrays import Array, Flags
from robofleet.core.settings import Model
from robofleet.safety.distances import Body, Keepout
from robofleet.safety.starts import Reason
from robofleet.safety.supervisor import Event
from robofleet.vehicles.differential_drive import DifferentialDrive

Pose = tuple[float, float, float]  # x, y [m], psi [rad]

_SHOWN = {("m", "mm"): 1e3, ("rad", "deg"): 180.0 / math.pi, ("m/s", "mm/s"): 1e3}
_ROUNDING = 1e-9
SHARE_OF_TICK = 0.5  # for all groups' decisions; the rest is the filter's, the barrier's and the bus's


class Flow(NamedTuple):
    """Parameters of the Newton-Raphson flow, as ``controller`` in the configuration has them.

    Attributes:
        alpha: Speed-up of the flow [1/s].
        horizon: How far the flow predicts, T [s].
        integrator: How the flow is stepped: by its exact solution, or by forward Euler.
    """

    alpha: float
    horizon: float
    integrator: Literal["exact", "euler"]


@dataclass(frozen=True, kw_only=True)
class Team:
    """What a behaviour knows of its group.

    Attributes:
        name: The group's name.
        robots: The robots' ids (N).
        drives: The robots' wheels and limits (N).
        bodies: The robots' discs (N), as ``safety.barrier.apart`` and ``from_edge`` take them: what the barrier keeps.
        starts: Pose of each robot's centre (N) where the behaviour begins: x, y [m], psi [rad; world]. None: not known.
        bystanders: The robots in no group: id, body, pose at the start (None: not known).
        keepout: The distances that the barrier keeps.
        arena: Size along x and y [m].
        tick: Control step [s].
        delay: Time from a tick until the first robot's command acts [s].
        point_ahead: Distance l from the axle to the point ahead [m].
        flow: Parameters of the Newton-Raphson flow.
        rng: Random numbers, the same for the same seed.
    """

    name: str
    robots: tuple[str, ...]
    drives: tuple[DifferentialDrive, ...]
    bodies: tuple[Body, ...]
    starts: tuple[Pose | None, ...]
    bystanders: tuple[tuple[str, Body, Pose | None], ...]
    keepout: Keepout
    arena: tuple[float, float]
    tick: float
    delay: float
    point_ahead: float
    flow: Flow
    rng: "np.random.Generator"

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
    """The newest word of a script that drives a group from a process of its own.

    Attributes:
        kind: What ``values`` are.
        values: (N, 3) as ``kind`` says. The last column of BODY and POINT means nothing. 0 where not ``told``.
        told: (N,) which robots the setpoint is for. The others stand.
        order: Number of the script's journey: POSES with the same number have one plan.
        age: Time since the tick by which the script decided, by the controller's ticks [s].
        epoch: Random number of the script's session.
        seq: Number of the setpoint in its session.
    """

    kind: WishKind
    values: Array
    told: Flags
    order: int
    age: float
    epoch: int
    seq: int


@dataclass(frozen=True, kw_only=True)
class Situation:
    """What a behaviour decides by: everything at the moment when the tick's commands act.

    Attributes:
        t: Time since the group's start [s].
        poses: (N, 3) poses of the centres: x, y [m], psi [rad; world].
        driving: (N,) which robots may drive. The others stand, whatever is decided.
        disturbance: (N, 2) estimated velocity of the points ahead beyond what was asked [m/s; world]. 0 without an
            estimate.
        others: (M, 3) every other robot in the arena that was seen: x, y [m; world], body radius [m].
        wish: The newest setpoint since the run went on, for a behaviour that ``takes_wishes``. None: none yet.
    """

    t: float
    poses: Array
    driving: Flags
    disturbance: Array
    others: Array
    wish: Wish | None = None

    def points(self, ahead: float) -> Array:
        """Return the robots' points ahead.

        Args:
            ahead: Distance in front of the axles [m].

        Returns:
            (N, 2) [m; world].
        """
        psi, points = self.poses[:, 2], np.empty((len(self.poses), 2))
        np.cos(psi, out=points[:, 0])
        np.sin(psi, out=points[:, 1])
        points *= ahead
        points += self.poses[:, :2]
        return points


class Decision(NamedTuple):
    """What a behaviour decided.

    Wheels that cannot do all of it are slowed together, and the barrier may change the rest: ``Behaviour.changed`` is
    called with what the robots are really asked for.

    Attributes:
        velocities: (N, 2) what the robots are to do, as ``of`` says.
        of: ``point``: velocities of the points ahead along x and y [m/s; world]. ``body``: v [m/s] and omega [rad/s] of
            the bodies.
        references: (N, 2) where each robot's followed point is to be [m; world]. NaN: nowhere.
        figures: Values by the figures' names: (N,), or one value for all. A missing one is NaN.
        hold: Why the group stands at once and the run is to be held. None: it goes on.
    """

    velocities: Array
    of: Literal["point", "body"] = "point"
    references: Array | None = None
    figures: Mapping[str, Array | float] = {}
    hold: Event | None = None


class Figure(NamedTuple):
    """A figure that a behaviour tells of each robot at each tick.

    Attributes:
        name: Small letters, digits and _, without the unit: "control_error".
        unit: "m", "rad", "m/s". Empty: a plain number.
        shown: The unit for people and for ``summary.json``: "mm" of m, "deg" of rad. Empty: ``unit``.
        meaning: A sentence for the report and the viewers.
        live: Whether it is a column of the terminal and of the page.
    """

    name: str
    unit: str = ""
    shown: str = ""
    meaning: str = ""
    live: bool = True

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
    """A line that is drawn on the floor.

    Attributes:
        name: Its name. A line with the name of a robot has its colour.
        points: (M, 2) [m; world].
        closed: Whether it ends where it begins.
        directed: Whether it is driven in the points' order: arrows are drawn on it.
    """

    name: str
    points: Array
    closed: bool = False
    directed: bool = False


class Dots(NamedTuple):
    """Points that are drawn on the floor, one colour for each robot where there are N.

    Attributes:
        name: Their name.
        points: (M, 2) [m; world].
    """

    name: str
    points: Array


Shape = Line | Dots


class Refusal(NamedTuple):
    """Something that cannot work.

    Attributes:
        key: The key that is wrong: "settings.path_rate" or "robots.1" of the group, "r2.start" of the robot r2, else
            from the root.
        message: What is wrong and how to mend it.
    """

    key: str
    message: str


@dataclass(frozen=True)
class Bound:
    """One thing that is judged before a run: a value and its limit.

    Attributes:
        path: The key that is judged, as a Refusal's.
        what: What the value is.
        value: What was found [unit].
        limit: What it is compared with [unit].
        unit: Unit of both.
        mend: How to mend a bound that does not hold.
        at_least: Whether the value must be at least the limit. Else it must be at most the limit.
        strict: Whether the value must not equal the limit.
    """

    path: str
    what: str
    value: float
    limit: float
    unit: str
    mend: str
    at_least: bool = False
    strict: bool = False

    @property
    def tightness(self) -> float:
        """How much of the limit is used, as a share: up to 1 where the bound holds."""
        used, available = (self.limit, self.value) if self.at_least else (self.value, self.limit)
        return used / available if available > 0 else math.inf

    @property
    def holds(self) -> bool:
        """Whether the bound is kept."""
        return self.tightness <= 1 + (-_ROUNDING if self.strict else _ROUNDING)


class Start(NamedTuple):
    """What a behaviour says of a start, before a wheel turns.

    Attributes:
        jam: Two robots that would not get past each other. None: nobody jams.
        arrived_s: When each robot is where the behaviour wants it (N) [s]. Infinite: not soon.
        rows: Rows of a table: what, value, limit, note.
        warnings: What may take long: how long [s], and a sentence.
    """

    jam: Reason | None = None
    arrived_s: Sequence[float] = ()
    rows: Sequence[tuple[str, str, str, str]] = ()
    warnings: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True, kw_only=True)
class Past:
    """What became of a group: K ticks while the fleet ran.

    Attributes:
        t: (K,) run time [s].
        poses: (K, N, 3) poses of the centres: x, y [m], psi [rad; world]. True where ``known``, else as estimated.
        points: (K, N, 2) the points ahead of the same poses [m; world].
        known: (N,) whose true poses are known.
        settled: (K,) ticks after ``run.settle_s``: of these the figures count.
        spaced: (K,) of these, those after ``run.spacing_settle_s``: of these the true errors count.
        references: (K, N, 2) as decided [m; world]. NaN: none.
        figures: (K, N) by the figures' names. NaN: not decided.
    """

    t: Array
    poses: Array
    points: Array
    known: Flags
    settled: Flags
    spaced: Flags
    references: Array
    figures: Mapping[str, Array]


class Measure(NamedTuple):
    """Something that was measured of a group after a run, in columns.

    Attributes:
        name: Small letters, digits and _, without the unit.
        unit: Unit of ``values``. Empty: plain numbers.
        values: (K, n). NaN: not known.
        of: What each of the n columns is about: robots' ids, or pairs of them.
        shown: The unit for people, as a Figure's.
        meaning: A sentence for the report.
        asked: What the values should be. None: nothing certain.
        counts: (K,) at which ticks the values count. None: after ``run.settle_s``.
    """

    name: str
    unit: str
    values: Array
    of: tuple[str, ...]
    shown: str = ""
    meaning: str = ""
    asked: float | None = None
    counts: Flags | None = None


class Behaviour:
    """A behaviour of a group. Only ``decide`` must be written; everything else has a default.

    Attributes:
        figures: What it reports of each robot at each tick.
        takes_wishes: Whether a script or a person drives the group: ``Situation.wish`` has the newest setpoint.
        settings: An instance of the class's own ``Settings``.
        team: What it knows of its group.
    """

    class Settings(Model):
        """Keys of ``groups[].settings``, with units in their names, limits and defaults."""

    figures: ClassVar[Sequence[Figure]] = ()
    takes_wishes: ClassVar[bool] = False

    def __init__(self, settings: Any, team: Team) -> None:
        """Keep what it is made of.

        Args:
            settings: An instance of the class's own ``Settings``.
            team: What it knows of its group.

        Raises:
            ValueError: A class of your own may raise it for settings that are impossible for this group. What
                ``refusals`` yields has a better message.
        """
        self.settings = settings
        self.team = team

    def decide(self, now: Situation) -> Decision:
        """Decide what the robots do in the next tick. It must take less than a few milliseconds.

        Args:
            now: The poses, and all else that is known, at the moment when the tick's commands act.

        Returns:
            The velocities (N, 2), the figures, and whether the run is to be held.

        Raises:
            NotImplementedError: The class does not define it. Whatever it raises stops the group and holds the run.
        """
        raise NotImplementedError

    def restart(self) -> None:
        """Begin a new run: forget the one before."""

    def changed(self, velocities: Array) -> None:
        """Take what the robots are really asked for, after the wheels' limits and the barrier.

        Args:
            velocities: (N, 2) velocities of the points ahead [m/s; world].
        """

    def carried(self, robot: int) -> None:
        """Forget a robot's progress: it was carried away (the kidnapped robot).

        Args:
            robot: Its index in the group.
        """

    @property
    def arrived(self) -> bool:
        """Whether the behaviour has done everything: the run ends then. Most behaviours never have."""
        return False

    def by_point_flow(self) -> bool:
        """Return whether the flow of the points ahead (eq. 31) drives the robots, with the parameters of ``team.flow``.

        Returns:
            True: ``robofleet check`` says how much delay, lag and wrong wheel radius the loop bears.
        """
        return False

    def places(self) -> Sequence[Pose] | None:
        """Return where the robots begin; ``run.begin: go_to_start`` brings them there.

        Returns:
            Poses of the centres (N): x, y [m], psi [rad; world]. None: they begin anywhere.
        """
        return None

    def start(self, poses: Sequence[Pose]) -> Start:
        """Judge a start before a wheel turns.

        Args:
            poses: Poses of the centres (N): x, y [m], psi [rad; world].

        Returns:
            Who would jam, when the robots arrive, rows for a table, and warnings.
        """
        return Start()

    def bounds(self) -> Iterable[Bound]:
        """Return what must hold before a run, and ``robofleet check`` shows in a table.

        Returns:
            Distances to the arena's edge, wheel speeds, distances between robots, and the like.
        """
        return ()

    def refusals(self) -> Iterable[Refusal]:
        """Return what cannot work and is no bound; ``robofleet check`` refuses it.

        Returns:
            Each mistake with its key and its cure.
        """
        return ()

    def shapes(self) -> Sequence[Shape]:
        """Return what page, report and viewers draw on the floor.

        Returns:
            Lines and points [m; world].
        """
        return ()

    def measures(self, past: Past) -> Sequence[Measure]:
        """Measure a run beyond the figures: each tick by itself.

        A long run is measured part by part, and as a whole by every n-th tick of it.

        Args:
            past: K ticks of the run.

        Returns:
            Columns of K values each.
        """
        return ()

    def summary(self, past: Past) -> dict[str, Any]:
        """Return the group's part of ``summary.json``.

        Args:
            past: K ticks of the run.

        Returns:
            By default mean, ``max`` and each robot's mean of all figures and measures, of the ticks that count, by
            their names. ``max`` is the largest magnitude: a figure may have a sign. A figure that was not measured is
            None.
        """
        own = [
            Measure(f.name, f.unit, past.figures[f.name], self.team.robots, f.shown, f.meaning) for f in self.figures
        ]
        return {
            with_unit(m.name, m.shown or m.unit): statistics(
                m.values[past.settled if m.counts is None else m.counts] * scale(m.unit, m.shown)
            )
            for m in [*own, *self.measures(past)]
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
