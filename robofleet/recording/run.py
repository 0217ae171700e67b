"""What a run left: every message, and the columns that its figures are made from."""

import re
import warnings
from array import array
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from robofleet.behaviours import described
from robofleet.behaviours.interface import Past
from robofleet.bus.keys import NEWS, POSES, STATE, STATUS, TICK, TRUTH, Topic, key
from robofleet.bus.layouts import VERSION, Layout, ListLayout
from robofleet.bus.messages import FLEET_POSES, RUN_STATE, TICK_RECORD, TRACKER_NEWS, FleetPoses, RobotStatus, RunState
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.plugins import PluginError
from robofleet.core.valid_json import dumps
from robofleet.recording.gauge import Curve, Figures, Gauge, gauges, peaked
from robofleet.recording.provenance import Provenance
from robofleet.recording.reduced import Reduced
from robofleet.recording.run_clock import RunClock
from robofleet.safety.supervisor import Phase

SHOWN = 512  # messages of a key, for a live view
_BEYOND = 1e9  # nothing in an arena has a figure so large, whatever its unit: a message that says so measured nothing

_LONGEST_NS = 1 << 62
_MOST_IN_FOUR_BYTES = (1 << 32) - 1
_PIECE_BYTES = 1 << 20
Duration = Annotated[int, Field(ge=0, lt=_LONGEST_NS)]


_DURATIONS = re.compile(rb'"(?P<name>tick_durations_ns|tracker_durations_ns)": \[(?P<values>[0-9, ]+)\]')


def _integers(text: bytes, start: int, stop: int) -> "array[int] | None":
    """Return a list of durations, which may be millions, without an object for each; None where it is no such list."""
    durations = array("I")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy warns where it cannot read on
        while start <= stop:  # piece by piece: each copy of all of them is tens of megabytes
            end = stop if stop - start <= _PIECE_BYTES else text.rfind(b",", start, start + _PIECE_BYTES)
            piece = text[start : max(start, end)].strip()
            if not piece:
                return None
            try:
                values = np.fromstring(piece, np.int64, sep=",")
            except (ValueError, DeprecationWarning):
                return None
            if len(values) != piece.count(b",") + 1 or not (values < _LONGEST_NS).all():
                return None
            if durations.typecode == "I" and (values > _MOST_IN_FOUR_BYTES).any():
                durations = array("q", durations)
            durations.frombytes(values.astype(durations.typecode).tobytes())
            start = end + 1
    return durations


class EndingFile(BaseModel):
    """What the one who ran it knows and no message says, as its file keeps it."""

    model_config = ConfigDict(strict=True, extra="forbid")

    outcome: Annotated[str, Field(max_length=100)] | None
    cause: Annotated[str, Field(max_length=10_000)] | None
    elapsed_s: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    trace_hash: Annotated[str, Field(max_length=100)] | None
    tick_durations_ns: list[Duration] | None
    tracker_durations_ns: list[Duration] | None


@dataclass
class Recording:
    """Every message of a run, by key, as it came; and what the one who ran it measured."""

    config: Config
    messages: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    provenance: Provenance | None = None  # None: the file does not say
    dropped: int = 0  # messages that are not in the file
    trouble: str | None = None  # what is wrong with the file, behind the last of these messages; None: it is whole
    outcome: str | None = None  # completed, stopped or fault; None: whoever ran it did not come to say it
    cause: str | None = None
    elapsed_s: float = 0.0
    trace_hash: str | None = None
    tick_durations_ns: Sequence[int] | None = None  # lockstep's own stopwatch: no time passes on the simulated clock
    tracker_durations_ns: Sequence[int] | None = None
    file_groups: tuple[described.Group, ...] | None = None  # as the file says; None: as the configuration does
    foreign: frozenset[str] = frozenset()  # behaviours that only a file names: their modules are not imported
    _places: dict[str, "array[int]"] = field(default_factory=lambda: defaultdict(lambda: array("Q")))
    count: int = 0  # of all messages
    _arrays: dict[str, tuple[int, list[tuple[NDArray[np.int64], NDArray[Any]]]]] = field(default_factory=dict)

    @cached_property
    def groups(self) -> tuple[described.Group, ...]:
        """The groups: which figures their ticks have, and what is drawn for them."""
        if self.file_groups is not None:
            return self.file_groups
        if self.foreign:
            raise PluginError(
                f"{', '.join(sorted(self.foreign))} is needed: add `--behaviours DIR`, the folder of its module"
            )
        return groups.descriptions(self.config)

    @cached_property
    def gauges(self) -> tuple[Gauge, ...]:
        return gauges(self.config, self.groups, self.foreign)

    @property
    def whole(self) -> bool:
        return self.trouble is None

    def add(self, full: str, payload: bytes) -> None:
        self.count += 1
        self.messages[full].append(payload)
        self._places[full].append(self.count)

    def between(self, full: str, first: int, until: int) -> list[bytes]:
        """Return the messages of a key from a place in the order of all messages up to another one."""
        places = self._places.get(full, ())
        return self.messages.get(full, [])[bisect_left(places, first) : bisect_left(places, until)]

    def since(self, first_index: int) -> "Recording":
        """Return a recording that goes on from a place in the order of all messages."""
        later = self.emptied()
        for full, places in self._places.items():
            first = bisect_left(places, first_index)
            later.messages[full], later._places[full] = self.messages[full][first:], places[first:]
        return later

    def emptied(self) -> "Recording":
        made = replace(self, messages=defaultdict(list), _places=defaultdict(lambda: array("Q")), _arrays={})
        made.__dict__.update({name: self.__dict__[name] for name in ("groups", "gauges") if name in self.__dict__})
        return made

    def keep_newest(self, most: int) -> None:
        """Drop old messages where a key has more than ``most``: the run's file has all of them."""
        for full, messages in self.messages.items():
            if len(messages) > 2 * most:
                self.forget(full, len(messages) - most)

    def forget(self, full: str, count: int) -> None:
        del self.messages[full][:count], self._places[full][:count]
        self._arrays.pop(full, None)

    def ending(self) -> bytes:
        fields = {name: getattr(self, name) for name in EndingFile.model_fields}
        return dumps(
            {name: list(values) if isinstance(values, array) else values for name, values in fields.items()}
        ).encode()

    def end(self, text: bytes) -> None:
        """Take how the run ended from its file; ValueError where it does not say so."""
        long: dict[str, array[int]] = {}

        def cut(match: re.Match[bytes]) -> bytes:
            values = _integers(text, *match.span("values"))
            if values is None:
                return match[0]
            long[match["name"].decode()] = values
            return text[match.start() : match.start("values")] + b"]"

        for name, value in EndingFile.model_validate_json(_DURATIONS.sub(cut, text)):
            short = array("q", value) if isinstance(value, list) else value
            setattr(self, name, long.get(name, short))

    def measured(self, full: str, layout: Layout[Any], own: "Own") -> NDArray[Any]:
        """Return a key's messages of the right size whose figures can be true, as a structured array."""
        payloads = [p for p in self.between(full, own.first, own.until) if len(p) == layout.size]
        rows = np.frombuffer(b"".join(payloads), dtype=layout.dtype)
        return rows[_can_be(rows)]

    def of_robot(self, topic: Topic, robot: str) -> NDArray[Any]:
        """Return a robot's part of its unit's messages: the fields of their heads and of its items, and ``message``.

        ``message`` is the place among the messages of the key; those of another size than the unit's are left out.
        """
        unit = self.config.unit_of[robot]
        index = self.config.units[unit].index(robot)
        layout = topic.layout
        assert isinstance(layout, ListLayout)
        parts = [
            _joined(messages, rows, rows["items"][:, column])
            for messages, rows in self._of_unit(topic, unit)
            for column in _columns_of(rows["items"], index, len(self.config.units[unit]))
        ]
        if not parts:
            return _joined(np.empty(0, np.int64), np.empty(0, layout.dtype(0)), np.empty(0, layout.item_dtype))
        joined = np.concatenate(parts) if len(parts) > 1 else parts[0]
        return joined[np.argsort(joined["message"], kind="stable")] if len(parts) > 1 else joined

    def _of_unit(self, topic: Topic, unit: str) -> list[tuple[NDArray[np.int64], NDArray[Any]]]:
        """Return a unit's messages as arrays, one for each size, with their places among the key's messages."""
        full, layout = key(self.config.arena.name, topic, unit), topic.layout
        assert isinstance(layout, ListLayout)
        payloads = self.messages.get(full, [])
        count, parts = self._arrays.get(full, (-1, []))
        if count != self.count:  # every robot of the unit asks for the same
            sizes = np.array([len(payload) for payload in payloads], np.int64)
            parts = []
            for n in range(1, len(self.config.units[unit]) + 1):
                (fitting,) = np.nonzero(sizes == layout.dtype(n).itemsize)
                if len(fitting):
                    rows = np.frombuffer(b"".join([payloads[k] for k in fitting.tolist()]), layout.dtype(n))
                    whole = (rows["count"] == n) & (rows["version"] == VERSION)
                    parts.append((fitting[whole], rows[whole]))
            self._arrays[full] = self.count, parts
        return parts

    def newest(self, topic: Topic, name: str = "") -> Any:
        """Return the newest message of a topic; None where there is none, or where it cannot be read."""
        messages = self.messages.get(key(self.config.arena.name, topic, name))
        assert topic.layout is not None
        return topic.layout.decode(messages[-1]) if messages else None

    def newest_status(self, robot: str) -> RobotStatus | None:
        """Return what a robot's unit said of it last; None where it has not spoken."""
        unit = self.config.unit_of[robot]
        payload, robots = self.newest(STATUS, unit), self.config.units[unit]
        return None if payload is None or len(payload.robots) != len(robots) else payload.robots[robots.index(robot)]

    def places(self, full: str) -> Sequence[int]:
        """Return the place of a key's messages in the order of all messages."""
        return self._places.get(full, ())

    def placed(self, full: str) -> Iterator[tuple[int, bytes]]:
        """Yield the messages of a key, each with its place in the order of all messages."""
        return zip(self.places(full), self.messages.get(full, ()), strict=True)


Watch = Callable[[Recording, str], None]  # called during a run with what came so far, and the phase's name


class Own(NamedTuple):
    """Which part of a run is looked at, where a recording holds what came shortly before it and after it, too."""

    first: int = 0  # place in the order of all messages
    until: int = 1 << 62
    start_ns: int | None = None  # the run's first tick, where it was before this part
    began: tuple[int, ...] = ()  # the numbers of the images, of each camera, that it knew
    newest: tuple[int, float] | None = None  # stamp and run time of the run's newest tick before this part
    last: bool = True  # nothing follows


@dataclass(frozen=True)
class GroupColumns:
    """One group of a run."""

    gauge: Gauge
    rows: slice  # of the members' arrays
    past: Past  # of the ticks while the fleet ran
    running: NDArray[np.bool_]  # (K,) which of the run's ticks those are
    peaks: Sequence[Figures] = ()  # of a long run, of which the past has only some ticks: figures of its parts

    @property
    def group(self) -> described.Group:
        return self.gauge.group

    @cached_property
    def curves(self) -> tuple[Curve, ...]:
        """What was told and measured of it, over all ticks (K,) of the run."""
        curves = self.gauge.curves(self.past) if len(self.past.t) else ()
        if self.running.all():
            return curves
        return tuple(
            curve._replace(
                values=self._spread(curve.values, np.nan),
                counts=None if curve.counts is None else self._spread(curve.counts, False),
            )
            for curve in curves
        )

    def summary(self) -> Figures:
        return peaked(self.gauge.summary(self.past), self.peaks)

    def _spread(self, values: NDArray[Any], otherwise: float) -> NDArray[Any]:
        spread = np.full((len(self.running), *values.shape[1:]), otherwise, values.dtype)
        spread[self.running] = values
        return spread


class Run:
    """The recording in columns: ticks of the run (K,), robots of all groups, group by group (N,).

    ``every_tick``: also those in which the fleet was not running. ``own``: the part that is looked at.
    """

    every: int = 1  # of so many ticks the columns have one
    reduced: Reduced | None = None  # of a long run, of which the columns have only some ticks: its figures

    def __init__(self, recording: Recording, *, every_tick: bool = False, own: Own = Own()) -> None:  # noqa: B008
        self.recording, self.own = recording, own
        config = self.config = recording.config
        arena, robots = config.arena.name, config.members
        dtype = TICK_RECORD.dtype(len(robots), described.size(recording.groups, len(config.camera_names)))
        placed = [(at, p) for at, p in recording.placed(key(arena, TICK)) if len(p) == dtype.itemsize]
        records = np.frombuffer(b"".join(p for _, p in placed), dtype=dtype)
        places = np.array([at for at, _ in placed], np.uint64)
        first, until = np.searchsorted(places, (own.first, own.until))
        self.near = records  # ticks, with those shortly before and after this part
        self.before = records[:first][-1:]  # (1,) the tick before these; (0,) where there is none
        self.all_ticks, places = records[first:until], places[first:until]
        self._places = places
        self._choose((self.all_ticks["run_tick"] >= 0) | every_tick)
        statuses = [recording.of_robot(STATUS, r.id) for r in robots]
        self.statuses = [status[_can_be(status)] for status in statuses]
        of_units = {unit: np.array(recording.places(key(arena, STATUS, unit)), np.uint64) for unit in config.units}
        self.status_places = [
            of_units[config.unit_of[robot.id]][status["message"]]
            for robot, status in zip(robots, self.statuses, strict=True)
        ]
        self._truths = [true[_can_be(true)] for true in (recording.of_robot(TRUTH, r.id) for r in config.bodies)]
        self._know_truths()
        news = [recording.measured(key(arena, NEWS, camera), TRACKER_NEWS, own) for camera in config.camera_names]
        self.news = np.concatenate(news)  # of all cameras
        self.news_of = np.repeat(
            config.camera_names, [len(camera_news) for camera_news in news]
        )  # whose each of them is
        self.states = _changes(recording, key(arena, STATE))
        self.start_ns = int(self.ticks["stamp_ns"][0]) if own.start_ns is None and len(self.ticks) else own.start_ns
        self.began = own.began
        if not self.began and len(self.ticks):
            self.began = int(self.ticks["poses_seq"][0]), *self._further_began()
        self.images = {  # of each camera, without those of the checks before
            camera: _images(recording, camera, own, self.began[row] if self.began else 0)
            for row, camera in enumerate(config.camera_names)
        }
        self.frames = [frame for images in self.images.values() for frame in images]

    def whole(self) -> "Run":
        """Return the run with every tick since its first one: those of its holds, and those after its end."""
        since = np.maximum.accumulate(self.all_ticks["run_tick"] >= 0) | (self.own.start_ns is not None)
        if since.sum() == len(self.ticks):
            return self
        found = copy(self)
        for name in [name for name in found.__dict__ if isinstance(getattr(Run, name, None), cached_property)]:
            del found.__dict__[name]
        found._choose(since)
        found._know_truths()
        return found

    def _choose(self, ticks: NDArray[np.bool_]) -> None:
        """Take some of all ticks."""
        self._tick_places = self._places[ticks]
        self._take(self.all_ticks[ticks])

    def _take(self, ticks: NDArray[Any]) -> None:
        self.ticks = ticks
        self.running = self.ticks["run_tick"] >= 0  # (K,)
        self.t = self.ticks["run_tick"] * self.config.controller.tick_s
        self.items = _with_gaps(self.ticks["items"])  # NaN: a figure that nobody can have measured
        self.groups = self.recording.groups
        numbers = self.ticks["figures"]
        numbers = np.where(np.abs(numbers) < _BEYOND, numbers, np.nan)
        self.group_figures = described.told(self.groups, numbers)  # of each group

    def _know_truths(self) -> None:
        known = np.array([len(truth) > 0 for truth in self._truths])
        self._know(self._at_ticks(self._truths) if known.any() and len(self.t) else None, known)

    def _know(self, bodies: Array | None, known: NDArray[np.bool_]) -> None:
        """Take the true poses of all bodies, and of which they are known (M,)."""
        self.bodies, self.all_known = bodies, known  # (K, M, 3), the groups' robots first; NaN: not told
        self.known = known[: len(self.config.members)]  # (N,) whose truth was told
        self.truth = None if bodies is None or not self.known.any() else bodies[:, : len(self.known)]

    @property
    def robots(self) -> list[str]:
        """The ids of the groups' robots (N,)."""
        return [robot.id for robot in self.config.members]

    def own_statuses(self, robot: int) -> NDArray[np.bool_]:
        """Return which of a robot's statuses (S,) are of this part."""
        return np.asarray((self.status_places[robot] >= self.own.first) & (self.status_places[robot] < self.own.until))

    def _further_began(self) -> list[int]:
        """Return the numbers of the images, of each camera but the first, that the first tick knew."""
        first = described.size(self.groups)
        return [int(seq) for seq in self.ticks["figures"][0, first + 1 :: described.NAMING]]

    @cached_property
    def parts(self) -> tuple[GroupColumns, ...]:
        config, running = self.config, self.running
        t, poses, points = self.t[running], self.poses()[running], self.points()[running]
        settled, spaced = self.counts[running], self.counts_spacing[running]
        parts = []
        peaks = self.reduced.peaks if self.reduced else {}
        rows_of = groups.rows(config.groups)
        for gauge, columns, rows in zip(self.recording.gauges, self.group_figures, rows_of, strict=True):
            figures = {name: values[running] for name, values in columns.figures.items()}
            past = Past(
                t=t, poses=poses[:, rows], points=points[:, rows], known=self.known[rows], settled=settled,
                spaced=spaced, references=columns.references[running], figures=figures,
            )  # fmt: skip
            parts.append(GroupColumns(gauge, rows, past, running, peaks.get(gauge.group.name, ())))
        return tuple(parts)

    @cached_property
    def references(self) -> Array:
        """Where each robot's followed point is to be (K, N, 2) [m]; NaN: nowhere."""
        return np.concatenate([columns.references for columns in self.group_figures], axis=1)

    @cached_property
    def newest_statuses(self) -> list[NDArray[np.int64]]:
        """For each robot the row of the newest status that came before each tick (K,); -1: there was none."""
        if not len(self.ticks):
            return []
        return [np.searchsorted(places, self._tick_places) - 1 for places in self.status_places]

    @cached_property
    def instants(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Stamps of the drivers' statuses and their places in the order of all messages, in that order."""
        places = np.concatenate([np.array(own, dtype=np.int64) for own in self.status_places])
        stamps = np.concatenate([status["stamp_ns"] for status in self.statuses])
        order = np.argsort(places)
        return stamps[order], places[order]

    def _at_ticks(self, truths: list[NDArray[Any]]) -> Array:
        """True poses at the ticks' instants (K, N, 3): on one host the stamps are of one clock."""
        columns: list[list[Array]] = []
        for truth in truths:
            if not len(truth):
                columns.append([np.full(len(self.t), np.nan)] * 3)
                continue
            stamps = truth["stamp_ns"]
            psi = np.unwrap(truth["psi_rad"])
            columns.append([np.interp(self.ticks["stamp_ns"], stamps, y) for y in (truth["x_m"], truth["y_m"], psi)])
        return np.array(columns).transpose(2, 0, 1)

    def poses(self) -> Array:
        """Poses of the centres (K, N, 3): true ones, else as estimated."""
        estimates = np.stack([self.items[name] for name in ("x_m", "y_m", "psi_rad")], axis=-1)
        return estimates if self.truth is None else np.where(self.known[:, None], self.truth, estimates)

    def standing(self) -> Array:
        """Poses of the bystanders' centres at the end (B, 3): true ones, else as seen last, else NaN."""
        config = self.config
        places = np.full((len(config.bystanders), 3), np.nan) if self.reduced is None else self.reduced.standing
        tags = {robot.tag: row for row, robot in enumerate(config.bystanders)}
        for frame in self.frames if tags else ():
            for pose in frame.poses:
                if pose.tag in tags and pose.coasted_ns == 0:
                    places[tags[pose.tag]] = pose.x_m, pose.y_m, pose.psi_rad
        true = None if self.bodies is None else self.bodies[-1, len(config.members) :]
        return places if true is None else np.where(np.isfinite(true), true, places)

    def points(self) -> Array:
        """Points p (K, N, 2): true ones, else as estimated."""
        estimates = np.stack([self.items["point_x_m"], self.items["point_y_m"]], axis=-1)
        if self.truth is None:
            return estimates
        ahead = self.config.controller.point_ahead_m
        psi = self.truth[..., 2]
        true = self.truth[..., :2] + ahead * np.stack([np.cos(psi), np.sin(psi)], axis=-1)
        return np.where(self.known[:, None], true, estimates)

    @cached_property
    def clock(self) -> RunClock:
        """The two times of the run."""
        stamps, run_s = self.ticks["stamp_ns"][self.running], self.t[self.running]
        if (newest := self.own.newest) is not None:
            stamps, run_s = np.append(newest[0], stamps), np.append(newest[1], run_s)
        return RunClock(self.start_ns or 0, stamps, run_s, self.every * self.config.controller.tick_s)

    @property
    def newest(self) -> tuple[int, float] | None:
        """Stamp and run time of the newest tick of the run up to the end of this part; None: it has not begun."""
        clock = self.clock
        return (int(clock.stamps_ns[-1]), float(clock.run_s[-1])) if len(clock.stamps_ns) else None

    @property
    def ended_ns(self) -> int:
        """Stamp of the newest tick of the run in this part, those of its holds too; 0: there is none."""
        on = (self.all_ticks["run_tick"] >= 0) | (self.all_ticks["phase"] == Phase.HOLD)
        stamps = self.all_ticks["stamp_ns"][on]
        return int(stamps[-1]) if self.start_ns is not None and len(stamps) else 0

    @cached_property
    def clock_time_s(self) -> Array:
        """Clock times of the ticks (K,): they go on in a hold [s]."""
        return self.clock.clock_time_s(self.ticks["stamp_ns"])

    @cached_property
    def run_time_s(self) -> Array:
        """Run times of the ticks (K,): they stand still in a hold; NaN before the start [s]."""
        return self.clock.run_time_s(self.ticks["stamp_ns"])

    @property
    def counts(self) -> NDArray[np.bool_]:
        """At which ticks (K,) the groups' figures count: while the fleet is running, after ``run.settle_s``."""
        return self.running & self.after(self.config.run.settle_s)

    @property
    def counts_spacing(self) -> NDArray[np.bool_]:
        """At which of these a spacing and a true error of the groups that come with robofleet count (K,)."""
        return self.counts & self.after(self.config.run.spacing_settle_s)

    @cached_property
    def pose_errors(self) -> tuple[Array, Array] | None:
        """How far the filter is off: distances (K, N) [m] and turns (K, N) [rad]; None: no truth is known."""
        if self.truth is None:
            return None
        off = np.hypot(self.items["x_m"] - self.truth[..., 0], self.items["y_m"] - self.truth[..., 1])
        return off, np.angle(np.exp(1j * (self.items["psi_rad"] - self.truth[..., 2])))

    def after(self, start_s: float) -> NDArray[np.bool_]:
        return np.asarray(self.t >= start_s)


def _images(recording: Recording, camera: str, own: Own, began: int) -> list[FleetPoses]:
    """Return what a camera saw, from an image's number on."""
    payloads = recording.between(key(recording.config.arena.name, POSES, camera), own.first, own.until)
    frames = (FLEET_POSES.decode(payload) for payload in payloads)
    return [frame for frame in frames if frame is not None and frame.seq >= began]


def _columns_of(items: NDArray[Any], offset: int, size: int) -> list[int]:
    """Return the column of a robot's items (K, n) in messages of ``size`` robots, or of some that say who they are."""
    if "place" not in (items.dtype.names or ()):
        return [offset] if items.shape[1] == size else []
    return np.flatnonzero(items["place"][0] == offset).tolist() if len(items) else []


def _joined(messages: NDArray[np.int64], rows: NDArray[Any], items: NDArray[Any]) -> NDArray[Any]:
    """Return heads and items of one robot (K,) side by side."""
    heads = [(name, rows.dtype[name]) for name in rows.dtype.names or () if name not in ("version", "count", "items")]
    own = [(name, items.dtype[name]) for name in items.dtype.names or ()]
    joined = np.empty(len(rows), [("message", np.int64), *heads, *own])
    joined["message"] = messages
    for name, _ in heads:
        joined[name] = rows[name]
    for name, _ in own:
        joined[name] = items[name]
    return joined


def _can_be(rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Return of which rows (K,) every figure can be true."""
    good = np.ones(len(rows), np.bool_)
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            good &= np.abs(rows[name]) < _BEYOND  # a NaN is not
    return good


def _with_gaps(items: NDArray[Any]) -> NDArray[Any]:
    """Return the robots of ticks (K, N) with NaN in place of every figure that is not finite, or beyond any arena.

    The same in place of the pose of a robot that no image has shown yet: its filter stands at zero.
    """
    wrong = {name: ~(np.abs(items[name]) < _BEYOND) for name in items.dtype.names or ()}
    unseen = (items["lost"] > 0) & np.all([items[name] == 0.0 for name in ("x_m", "y_m", "psi_rad")], axis=0)
    for name in ("x_m", "y_m", "psi_rad", "point_x_m", "point_y_m"):
        wrong[name] |= unseen
    if not any(where.any() for where in wrong.values()):
        return items
    items = items.copy()
    for name, where in wrong.items():
        items[name][where] = np.nan
    return items


def _changes(recording: Recording, full: str) -> list[tuple[int, RunState]]:
    """Return the run's states, each with its place in the order of all messages; repetitions are left out."""
    changes: list[tuple[int, RunState]] = []
    for at, payload in recording.placed(full):
        state = RUN_STATE.decode(payload)
        if state is not None and not (changes and state.repeats(changes[-1][1])):
            changes.append((at, state))
    return changes
