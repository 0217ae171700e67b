"""The user's programming interface: a script of one's own drives a fleet.

    import robofleet
    with robofleet.Fleet("configs/script.yaml", lockstep=True) as fleet:
        for t in fleet.ticks(20):
            fleet.drive(...)

The script is a client without privileges. Its setpoints go over the bus to the behaviour ``script``; the wheels'
limits, the barrier and every gate stand behind it.
"""

import argparse
import math
import secrets
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from html import escape
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robofleet.behaviours import described
from robofleet.behaviours.interface import Dots, Line, WishKind
from robofleet.behaviours.script import journey
from robofleet.bus import sensors
from robofleet.bus.keys import SENSORS, STATUS
from robofleet.bus.messages import NOTE, SCRIPT_WISH, TICK_RECORD, UNIT_STATUS, Note, NoteKind, RobotTick
from robofleet.bus.notes import Marks
from robofleet.config import groups, slices
from robofleet.config.load import ConfigError
from robofleet.config.tree import Config
from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.valid_json import dumps
from robofleet.reports.arena_card import BAD, GOOD, TRAIL_POINTS, TRAIL_S, WAITING, ArenaView, Card
from robofleet.safety.supervisor import Event, Phase
from robofleet.scripts.script_link import FleetError, Link
from robofleet.vehicles.readings import SensorReading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robofleet.reports.recorded_run import RecordedRun

__all__ = ["Fleet", "FleetError"]

Array = NDArray[np.float64]
Summary = dict[str, Any]
Goal = Sequence[float]  # x, y [m], and the heading [deg]

_BEYOND = 1e6  # [m/s, rad/s]: as the controller refuses it
_INTEGER_BITS = 64  # of a figure that is kept: others' JSON readers have no more
_DEEPEST_LIST = 8  # lists in lists of such a figure
_LONGEST_NOTE_BYTES = 100_000
_OTHER_SCRIPT_S = 1.0  # for which another script's setpoints are done and not ours
_EPOCH_BITS = 30  # a figure of the group tells it, and no figure is beyond 1e9
_ROUNDING = 1e-9
_COLUMNS = len(RobotTick._fields)
_NUMBER = Struct("<d")


class Fleet:
    """A fleet that this script drives, for as long as the ``with`` lasts.

    A configuration without a group whose behaviour is ``script`` is driven as one group of all its robots.

    N robots are in the order of ``robots``. World frame: x and y [m] from the arena's centre, psi [rad]
    counter-clockwise. The *point ahead* of a robot is ``point_ahead`` [m] in front of its axle.

    Attributes:
        summary: What ``summary.json`` holds, after the ``with``. Empty where an arena's run goes on.
        folder: The recording's folder. None: nothing is kept, or the run is another's.
        held: How often ``ticks(resume=True)`` has resumed the run.
    """

    def __init__(
        self,
        where: str | Path,
        *,
        lockstep: bool = False,
        out: str | Path | Literal[False] | None = None,
        seed: int | None = None,
        settings: Sequence[str] = (),
        group: str | None = None,
        config: str | Path | None = None,
        robots: int | None = None,
    ) -> None:
        """Take what the run is made of; ``open``, or the ``with``, begins it.

        Args:
            where: A configuration, or the name of an arena in which a run is on. A configuration's run is this
                script's, and ends with the ``with``. An arena's run goes on, and the robots stand.
            lockstep: Whether the run is in this process on a simulated clock. Else it is in real time.
            out: The recording's folder. None: ``runs/<UTC time>-<name>``. False: nothing is kept.
            seed: In place of ``run.seed``.
            settings: ``KEY=VALUE`` as behind ``--set``.
            group: Which group, where scripts drive several.
            config: The run's configuration, where the arena is another computer's.
            robots: Only the first so many of the configuration's robots.
        """
        self._where, self._lockstep, self._out, self._group, self._copy = where, lockstep, out, group, config
        self._changes = [*settings, *([] if seed is None else [f"run.seed={seed}"])]
        self._requested_robots = robots
        self._link: Link | None = None
        self._program = False  # a person who started it reads what is wrong
        self.summary: Summary = {}
        self.held = 0  # times that the run was resumed by itself

    @classmethod
    def from_arguments(cls, config: str | Path, arguments: Sequence[str] | None = None) -> Self:
        """Return what the script's command line asks for: ``[WHERE] [--real-time] [--set KEY=VALUE] [--seed N] ...``

        ``--help`` prints the script's docstring and all arguments. A mistake is printed in a line, and the script ends
        with exit code 2.

        Args:
            config: The configuration where the command line names none; without arguments it runs in lockstep.
            arguments: Arguments in place of the command line's.

        Returns:
            The fleet, which the ``with`` opens.
        """
        about = getattr(sys.modules["__main__"], "__doc__", None)
        raw = argparse.RawDescriptionHelpFormatter
        parser = argparse.ArgumentParser(description=about, formatter_class=raw, allow_abbrev=False)
        add = parser.add_argument
        add("where", nargs="?", default=config, metavar="WHERE", help="another configuration, or an arena with a run")
        add("--real-time", action="store_true", help="a run in real time; else in lockstep on a simulated clock")
        add("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE", help="change a key; repeatable")
        add("--seed", type=int, metavar="N", help="default: run.seed")
        add("--out", type=Path, metavar="DIR", help="default: runs/<UTC time>-<name>")
        chosen = vars(parser.parse_args(arguments))
        lockstep = not chosen.pop("real_time") and Path(chosen["where"]).suffix in CONFIGURATIONS
        fleet = cls(chosen.pop("where"), lockstep=lockstep, **chosen)
        fleet._program = True
        return fleet

    # The run

    def open(self) -> Self:
        """Begin a run, and return when its robots may drive; or join an arena's run, which may be held.

        Returns:
            This fleet.

        Raises:
            ConfigError: The configuration cannot work: a line for each fault.
            FleetError: The run does not begin, or the fleet is open already.
        """
        from robofleet.scripts import script_runs  # noqa: PLC0415 - it loads all that a run needs

        if self._link is not None:
            raise FleetError("this fleet is open already")
        link = script_runs.opened(
            self._where, self._changes, self._out, self._group, self._copy, lockstep=self._lockstep,
            robots=self._requested_robots,
        )  # fmt: skip
        self._begin(link, script_runs.group_of(link.config, self._group))
        try:
            if link.ends:  # an arena's may be held: the script can resume it
                self._next()
        except BaseException as error:
            self.close(f"the run did not go on: {error}")
            raise
        return self

    def _begin(self, link: Link, group: str) -> None:
        config = self._config = link.config
        self._link = link
        names = [group_config.title for group_config in config.groups]
        index = names.index(group)
        self._rows = groups.rows(config.groups)[index]
        self._team = groups.team(config, config.groups[index])
        descriptions = groups.descriptions(config)
        before = described.size(descriptions[:index])
        columns = [figure.name for figure in descriptions[index].figures]
        self._followed = before + 2 + columns.index("wish_epoch")
        self._arrival = before + 2 + columns.index("arrived")
        self._items_at, self._count = TICK_RECORD.head_dtype.itemsize, len(config.members)
        rng = slices.generator(config.run.seed, "script", group)
        self._epoch = slices.drawn_id(rng, _EPOCH_BITS) if self._lockstep else 1 + secrets.randbits(_EPOCH_BITS - 1)
        self._seq = self._notes = self._order = 0
        self._tick_s: float = config.controller.tick_s
        self._setpoint = np.zeros(len(self._team), SCRIPT_WISH.item_dtype)
        self._values = SCRIPT_WISH.floats(self._setpoint)  # of the same memory (N, 3)
        self._kind = WishKind.STAND
        self._commanded = False
        self._strange = 0  # ticks in which another script's setpoints were followed
        self._shapes = [shape for description in descriptions for shape in description.shapes]
        self._descriptions = descriptions
        self._marks = Marks()
        self._trails: deque[Array] = deque(maxlen=TRAIL_POINTS)
        self._trail_ticks = max(1, round(TRAIL_S / TRAIL_POINTS / self._tick_s))
        self._read(link.tick)
        self.folder: Path | None = link.folder

    def close(self, failed: str | None = None) -> None:
        """End the run, or leave an arena's run, in which the robots stand from now on. Idempotent.

        Args:
            failed: Why the script gives up: an arena's run is held. None: it is done.
        """
        link, self._link = self._link, None
        if link is not None:
            done = WishKind.DONE if link.ends else WishKind.STAND
            kind = done if failed is None else WishKind.FAILED
            parting = self._encoded(kind)
            self.summary = (link.done(parting) if failed is None else link.failed(parting, failed)) or {}

    def __enter__(self) -> Self:
        """Begin."""
        try:
            return self.open()
        except (ConfigError, FleetError) as error:
            if self._program:
                print(error, file=sys.stderr)
                raise SystemExit(2) from error
            raise

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """End."""
        well = error is None or (isinstance(error, SystemExit) and not error.code)
        why = f"the script ended by {type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
        if isinstance(error, KeyboardInterrupt):  # an arena's run goes on
            well, why = self._link is None or not self._link.ends, "the operator interrupted"
        self.close(None if well else why)
        if self._program and self.folder is not None:
            print(self.folder / "report.html")

    # What is known

    @property
    def robots(self) -> tuple[str, ...]:
        """The ids of the group's robots (N)."""
        return self._opened._team.robots

    @property
    def poses(self) -> Array:
        """Poses of the robots' centres (N, 3): x, y [m], psi [rad; world], as estimated at the newest tick."""
        return self._items[:, :3].copy()

    @property
    def points(self) -> Array:
        """The points ahead of the same poses (N, 2) [m; world]."""
        x, y, psi = self._items[:, :3].T
        ahead = self.point_ahead
        return np.column_stack([x + ahead * np.cos(psi), y + ahead * np.sin(psi)])

    @property
    def point_ahead(self) -> float:
        """Distance of a robot's point ahead from its axle [m]."""
        return self._opened._team.point_ahead

    @property
    def time(self) -> float:
        """Time of the newest tick since the run's start [s]."""
        _ = self._running
        return max(0, self._run_tick) * self._tick_s

    @property
    def tick_s(self) -> float:
        """Time from one tick to the next [s]."""
        return self._opened._tick_s

    @property
    def phase(self) -> str:
        """The run's phase in small letters: running, hold, fault, estop, idle, ..."""
        return self._running.status.phase.name.lower()

    @property
    def config(self) -> Config:
        """The run's configuration."""
        return self._opened._config

    @property
    def readings(self) -> NDArray[Any]:
        """The newest readings of the robots' drivers (N,), in named columns with their units: ``left_angle_rad``,
        ``left_rad_s`` as measured, ``left_output_rad_s`` as let through, ``battery`` [0..1; -1 where unknown], ...
        """
        found = np.zeros(len(self.robots), UNIT_STATUS.item_dtype)
        rows = {robot: row for row, robot in enumerate(self.robots)}
        for unit, members in self._config.units.items():
            mine = [(rows[robot], index) for index, robot in enumerate(members) if robot in rows]
            payload = self._running.newest(STATUS, unit) if mine else None
            if payload is None or (status := UNIT_STATUS.view(payload)) is None or len(status[1]) != len(members):
                continue
            for row, index in mine:
                found[row] = status[1][index]
        return found

    @property
    def sensors(self) -> tuple[SensorReading | None, ...]:
        """The newest reading of each robot's sensors (N): gyro, accelerometer, magnetometer, heading, distances; SI
        units in the robot's frame. None: the robot has none, or ``robots[].sensors`` is not set.
        """
        link, found = self._running, dict[str, SensorReading]()
        for unit in self.config.sensing:
            payload = link.newest(SENSORS, unit)
            message = None if payload is None else sensors.decoded(payload)
            if message is not None:
                members = self._config.units[unit]
                found |= {members[index]: reading for index, reading in message[1].items() if index < len(members)}
        return tuple(found.get(robot) for robot in self.robots)

    # What the robots do

    def ticks(self, seconds: float | None = None, *, resume: bool = False) -> Iterator[float]:
        """Loop over the run's ticks.

        The newest ``drive`` or ``move`` lasts until the next one. When the loop ends the robots stand. While the run
        is held in real time the loop waits; ticks that the script is too slow for are left out.

        Args:
            seconds: Length of the loop [s]. None: without end.
            resume: Whether a run goes on by itself that is held because the script was late, or because simulated
                robots block each other.

        Yields:
            Time since the loop's first tick [s], once a tick.

        Raises:
            FleetError: The run has ended, or is held in lockstep, or another script drives the robots.
        """
        first: int | None = None
        try:
            while True:
                self._next(resume=resume)
                first = self._run_tick if first is None else first
                t = (self._run_tick - first) * self._tick_s
                if seconds is not None and t >= seconds - _ROUNDING:
                    return
                self._commanded = False
                yield t
                if not self._commanded:
                    self._send()
        finally:
            self._stand()

    def drive(self, v_omega: ArrayLike) -> None:
        """Ask for velocities of the bodies.

        Wheels that cannot do all of it are slowed together, and the barrier may change the rest.

        Args:
            v_omega: (N, 2) v [m/s; forward +] and omega [rad/s; CCW +].

        Raises:
            ValueError: The shape is another one, or a value is not finite.
            FleetError: The fleet is not open, or the run has ended.
        """
        self._command(WishKind.BODY, self._checked(v_omega, "drive: v [m/s], omega [rad/s]"))

    def move(self, velocities: ArrayLike) -> None:
        """Ask for velocities of the points ahead.

        Args:
            velocities: (N, 2) velocities along x and y [m/s; world].

        Raises:
            ValueError: The shape is another one, or a value is not finite.
            FleetError: The fleet is not open, or the run has ended.
        """
        self._command(WishKind.POINT, self._checked(velocities, "move: velocities of the points ahead [m/s]"))

    def go_to(self, poses: Mapping[str, Goal], *, within_s: float = 300.0) -> None:
        """Let robots go to poses round each other; return when they are there.

        The robots that are not named stand. Afterwards all stand.

        Args:
            poses: Goals of the centres by the robots' ids: x, y [m; world], heading [deg; CCW +].
            within_s: The longest time that it may take [s].

        Raises:
            ValueError: A robot is none of the group's, or a pose cannot be reached.
            FleetError: The robots are not there in time, or the run has ended.
        """
        goals = self._goals(poses)
        self._order += 1
        self._setpoint[:] = 0
        for robot, pose in goals.items():
            self._setpoint[self.robots.index(robot)] = (1, *pose)
        self._kind = WishKind.POSES
        first = self._run_tick
        try:
            while True:
                self._send()
                self._next()
                if self._number(self._arrival) == self._order and self._number(self._followed) == self._epoch:
                    return
                if (self._run_tick - first) * self._tick_s > within_s:
                    raise FleetError(f"go_to: the robots are not there after {within_s:g} s: see who is in whose way")
        finally:
            self._stand()

    def hold(self) -> None:
        """Let every robot of the run stand; ``resume`` goes on."""
        self._running.ask(b"hold")

    def resume(self) -> None:
        """Go on after a hold. From another computer this is the operator's."""
        self._running.ask(b"resume")

    def stop(self) -> None:
        """Emergency stop: every gate of the run is latched until somebody resets it, and the run is over."""
        self._running.ask(b"estop")

    # What it leaves

    def say(self, text: str) -> None:
        """Write a line into the recording, the report and the operator's page.

        Args:
            text: At most 100,000 bytes.

        Raises:
            ValueError: It is longer.
        """
        self._note(NoteKind.SAY, str(text))

    def mark(self, name: str, points: ArrayLike, *, line: bool = False, closed: bool = False) -> None:
        """Draw points or a line on page, viewers and report.

        Args:
            name: Its name. The same name again replaces it.
            points: (M, 2) [m; world]. None at all: it is taken away.
            line: Whether a line is drawn through the points.
            closed: Whether the line ends where it begins.

        Raises:
            ValueError: A point is not finite, or there are too many.
        """
        at = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        if not np.isfinite(at).all():
            raise ValueError(f"mark {name!r}: a point is not finite")
        shape = Line(name, at, closed) if line or closed else Dots(name, at)
        self._note(NoteKind.MARK, described.plain_shape(shape))
        self._marks.take(shape)

    def plot(self) -> "Figure":
        """Draw the robots on the floor now, with their trails. Of a closed fleet: as ``robofleet.load(folder).plot()``.

        Returns:
            A matplotlib figure.

        Raises:
            FleetError: The fleet is not open, and nothing was recorded.
        """
        if self._link is None and self._recorded is not None:
            return self._recorded.plot()
        from robofleet.reports import notebook_figures  # noqa: PLC0415 - it loads matplotlib

        return notebook_figures.of_floor(self._view())

    def keep(self, **figures: Any) -> None:
        """Keep figures of the run in ``summary.json``, under the group's ``kept``.

        Args:
            figures: Numbers, texts, or lists of them, by their names.

        Raises:
            ValueError: One is something else, or an integer of more than 64 bits.
        """
        self._note(NoteKind.KEEP, {name: _plain(name, value) for name, value in figures.items()})

    def __repr__(self) -> str:
        """Return which run it is, and its state."""
        if self._link is not None:
            return f"<Fleet {self._where}: {self.phase}, {self.time:.1f} s, {', '.join(self.robots)}>"
        return f"<Fleet {self._where}: {'closed' if self._was_open else 'not open'}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the robots on the floor, and where they are."""
        if self._link is None:
            return escape(repr(self)) if self._recorded is None else self._recorded._repr_html_()
        phase = self._link.status.phase
        poses, readings = self.poses, self.readings
        return Card(
            title=Path(self._where).name,
            state=f"{self.phase}, {self.time:.1f} s",
            colour={Phase.RUNNING: GOOD, Phase.FAULT: BAD, Phase.ESTOP: BAD}.get(phase, WAITING),
            arena=self._view(),
            heads=("robot", "x, m", "y, m", "heading, deg", "wheels, rad/s"),
            rows=[
                (robot, f"{x:.3f}", f"{y:.3f}", str(round(math.degrees(psi))), f"{left:.2f}, {right:.2f}")
                for robot, (x, y, psi), left, right in zip(
                    self.robots, poses, readings["left_rad_s"], readings["right_rad_s"], strict=True
                )
            ],
        ).html()

    # Inside

    @property
    def _was_open(self) -> bool:
        return hasattr(self, "_record")

    @property
    def _opened(self) -> Self:
        if not self._was_open:
            raise FleetError("the fleet is not open: write `with robofleet.Fleet(...) as fleet:`")
        return self

    @property
    def _running(self) -> Link:
        if self._opened._link is None:
            recorded = f": `robofleet.load({str(self.folder)!r})` has the run" if self.folder is not None else ""
            raise FleetError(f"the fleet is closed{recorded}")
        return self._opened._link

    @property
    def _recorded(self) -> "RecordedRun | None":
        """What a closed fleet has left."""
        from robofleet.reports.recorded_run import load  # noqa: PLC0415 - it loads what reads recordings

        return load(self.folder) if self._was_open and self.folder is not None else None

    @property
    def _every_item(self) -> Array:
        """The robots of all groups in the newest tick's record (M, columns of RobotTick)."""
        items = np.frombuffer(self._record, "<f8", self._count * _COLUMNS, self._items_at)
        return items.reshape(self._count, _COLUMNS)

    @property
    def _items(self) -> Array:
        """The group's robots of those (N, columns of RobotTick)."""
        _ = self._running
        return self._every_item[self._rows]

    def _view(self) -> ArenaView:
        """Return everything on the floor now."""
        _ = self._running
        numbers = np.frombuffer(self._record, "<f8", offset=self._items_at + 8 * self._count * _COLUMNS)
        figures = described.told(self._descriptions, numbers[None])
        return ArenaView(
            config=self._config,
            shapes=[*self._shapes, *self._marks.shapes],
            poses=self._every_item[:, :3],
            trails=np.array([*self._trails, self._every_item[:, :2]]),
            references=np.concatenate([group.references[0] for group in figures]),
        )

    def _number(self, index: int) -> float:
        """Return one of the numbers that groups tell, of this group's first robot."""
        return float(_NUMBER.unpack_from(self._record, self._items_at + 8 * (self._count * _COLUMNS + index))[0])

    def _read(self, record: bytes) -> None:
        self._record = record
        self._tick: int = TICK_RECORD.head_of(record, "tick")
        self._run_tick: int = TICK_RECORD.head_of(record, "run_tick")
        if self._run_tick % self._trail_ticks == 0:
            self._trails.append(self._every_item[:, :2].copy())

    def _next(self, *, resume: bool = False) -> None:
        """Wait for a tick of a run that is not held."""
        link = self._running
        while True:
            if resume and link.status.phase is Phase.HOLD:
                self._go_on()
            self._read(link.next_tick())
            if self._run_tick >= 0:
                break
            if link.status.phase is Phase.HOLD:  # while it waits, it keeps its group's lease
                link.wish(self._encoded(WishKind.STAND))
        followed = self._number(self._followed)  # NaN: nobody
        other = followed > 0 and followed != self._epoch and self._kind is not WishKind.STAND
        self._strange = self._strange + 1 if other else 0
        if self._strange * self._tick_s > _OTHER_SCRIPT_S:
            raise FleetError("another script drives these robots: end that one first")

    @property
    def _wanted(self) -> str:
        return f"must be ({len(self.robots)}, 2): a row for each of {', '.join(self.robots)}"

    def _go_on(self) -> None:
        """Resume a run that nobody else has to look at."""
        cause = self._running.status.cause
        if cause is Event.SCRIPT_SILENT or (cause is Event.DEADLOCKED and self._config.simulated):
            self._read(self._running.tick)
            self._running.wish(self._encoded(WishKind.STAND))
            with suppress(FleetError):  # they do not rest yet
                self.resume()
            self.held += 1

    def _checked(self, values: ArrayLike, what: str) -> Array:
        try:
            found = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{what}: this {type(values).__name__} is no array of numbers, {self._wanted}") from error
        if found.shape != (len(self.robots), 2):
            raise ValueError(f"{what}: the shape is {found.shape}, {self._wanted}")
        if not np.abs(found).max() < _BEYOND:  # not so of NaN
            row = int((~(np.abs(found) < _BEYOND)).any(axis=1).argmax())
            shown = f"{found[row].tolist()} of {self.robots[row]}"
            raise ValueError(f"{what}: {shown} is not finite, or beyond every limit")
        return found

    def _goals(self, poses: Mapping[str, Goal]) -> dict[str, tuple[float, float, float]]:
        """Return x, y [m], psi [rad] of each robot; ValueError where they cannot be reached."""
        goals = {}
        for robot, pose in poses.items():
            if robot not in self.robots:
                raise ValueError(f"go_to: there is no robot {robot!r} in the group: it has {', '.join(self.robots)}")
            numbers = np.asarray(pose, dtype=np.float64)
            if numbers.shape != (3,) or not np.isfinite(numbers).all():
                raise ValueError(f"go_to: {robot}: {pose!r} is no pose: write (x [m], y [m], heading [deg])")
            x, y, degrees = numbers.tolist()
            goals[robot] = (x, y, math.radians(math.remainder(degrees, 360.0)))
        if not goals:
            raise ValueError("go_to: name at least one robot")
        for bound in journey(self._team, goals).bounds():
            if not bound.holds:
                relation = "at least" if bound.at_least else "at most"
                raise ValueError(
                    f"go_to: {bound.what} is {bound.value:.4g} {bound.unit}, must be {relation} {bound.limit:.4g} "
                    f"{bound.unit}: {bound.mend}"
                )
        return goals

    def _command(self, kind: WishKind, values: Array) -> None:
        if self._kind is not kind:
            self._setpoint["told"], self._kind = 1, kind
            self._values[:, 2] = 0.0
        self._values[:, :2] = values
        self._send()

    def _send(self) -> None:
        self._commanded = True
        self._running.wish(self._encoded(self._kind))

    def _encoded(self, kind: WishKind) -> bytes:
        self._seq += 1
        return SCRIPT_WISH.encode_array((self._epoch, self._seq, kind, self._order, self._tick), self._setpoint)

    def _stand(self) -> None:
        self._kind = WishKind.STAND
        with suppress(FleetError):  # the run is over
            self._send()

    def _note(self, kind: NoteKind, what: Any) -> None:
        link, text = self._running, dumps(what).encode()
        if len(text) > _LONGEST_NOTE_BYTES:
            raise ValueError(f"{kind.name.lower()}: it has {len(text)} bytes, must be at most {_LONGEST_NOTE_BYTES}")
        self._notes += 1
        link.note(NOTE.encode(Note(self._epoch, self._notes, self._tick, kind, text)))


def _plain(name: str, value: Any, deep: int = 0) -> Any:
    """Return a figure as JSON has it; ValueError where it is none. ``deep``: in so many lists."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        if deep == _DEEPEST_LIST:
            raise ValueError(f"keep: {name} has lists in lists in more than {_DEEPEST_LIST} levels")
        return [_plain(name, entry, deep + 1) for entry in value]
    if isinstance(value, int) and value.bit_length() > _INTEGER_BITS:
        raise ValueError(f"keep: {name} is an integer of {value.bit_length()} bits, must have at most {_INTEGER_BITS}")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ValueError(f"keep: {name} is a {type(value).__name__}: give a number, a text, or a list of them")
