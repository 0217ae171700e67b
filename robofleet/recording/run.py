"""What a run left: every message, and the columns that its figures are made from."""

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import compress
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from robofleet.comms.keys import CAMERA, NEWS, POSES, STATE, STATUS, TICK, TRUTH, key
from robofleet.comms.layouts import Layout
from robofleet.comms.messages import FLEET_POSES, ROBOT_STATUS, RUN_STATE, TICK_RECORD, TRACKER_NEWS, RunState
from robofleet.comms.messages import TRUTH as TRUTH_LAYOUT
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.control.path import Path
from robofleet.recording.provenance import Provenance
from robofleet.valid_json import dumps

Array = NDArray[np.float64]

_BEYOND = 1e9  # nothing in an arena has a figure so large, whatever its unit: a message that says so measured nothing

Duration = Annotated[int, Field(ge=0, lt=1 << 62)]


class Ending(BaseModel):
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
    tick_durations_ns: list[int] | None = None  # lockstep's own stopwatch: no time passes on the simulated clock
    tracker_durations_ns: list[int] | None = None
    _places: dict[str, "array[int]"] = field(default_factory=lambda: defaultdict(lambda: array("Q")))
    count: int = 0  # of all messages

    @property
    def whole(self) -> bool:
        """Whether the file is as it was written, up to its end."""
        return self.trouble is None

    def add(self, full: str, payload: bytes) -> None:
        """Keep a message."""
        self.count += 1
        self.messages[full].append(payload)
        self._places[full].append(self.count)

    def keep_newest(self, most: int) -> None:
        """Let go of old messages where there are more than ``most`` of a key: a run that goes on is in its file."""
        for full, messages in self.messages.items():
            if len(messages) > 2 * most:
                del messages[:-most], self._places[full][:-most]

    def ending(self) -> bytes:
        """Return how the run ended, for its file."""
        return dumps({name: getattr(self, name) for name in Ending.model_fields}).encode()

    def end(self, text: bytes) -> None:
        """Take how the run ended from its file; ValueError where it does not say so."""
        for name, value in Ending.model_validate_json(text):
            setattr(self, name, value)

    def rows(self, full: str, layout: Layout[Any]) -> NDArray[Any]:
        """Return the messages of a key as a structured array; those of another size are left out."""
        payloads = [p for p in self.messages.get(full, ()) if len(p) == layout.size]
        return np.frombuffer(b"".join(payloads), dtype=layout.dtype)

    def measured(self, full: str, layout: Layout[Any]) -> NDArray[Any]:
        """Return the rows of a key whose figures can be true."""
        rows = self.rows(full, layout)
        return rows[_can_be(rows)]

    def placed(self, full: str) -> Iterator[tuple[int, bytes]]:
        """Yield the messages of a key, each with its place in the order of all messages."""
        return zip(self._places.get(full, ()), self.messages.get(full, ()), strict=True)


Watch = Callable[[Recording, str], None]  # called during a run with what came so far, and the phase's name


class Run:
    """The recording in columns: ticks of the run (K,), robots in platoon order (N,)."""

    def __init__(self, recording: Recording) -> None:
        config = self.config = recording.config
        arena, robots = config.arena.name, config.platoon
        dtype = TICK_RECORD.dtype(len(robots))
        payloads = recording.messages.get(key(arena, TICK), ())
        self.all_ticks = np.frombuffer(b"".join(p for p in payloads if len(p) == dtype.itemsize), dtype=dtype)
        self.ticks = self.all_ticks[self.all_ticks["run_tick"] >= 0]
        self.t = self.ticks["run_tick"] * config.controller.tick_s
        self.items = _with_gaps(self.ticks["items"])  # NaN: a figure that nobody can have measured
        statuses = [recording.rows(key(arena, STATUS, r.id), ROBOT_STATUS) for r in robots]
        self.statuses = [status[_can_be(status)] for status in statuses]
        places = [
            [place for place, p in recording.placed(key(arena, STATUS, r.id)) if len(p) == ROBOT_STATUS.size]
            for r in robots
        ]
        self.status_places = [list(compress(own, _can_be(told))) for own, told in zip(places, statuses, strict=True)]
        self.path = Path.hermite(*slices.knots(config.groups[0]))
        truths = [recording.measured(key(arena, TRUTH, r.id), TRUTH_LAYOUT) for r in config.bodies]
        told = np.array([len(truth) > 0 for truth in truths])
        # (K, M, 3) of all bodies, the group's robots first; NaN: not told
        self.bodies = self._at_ticks(truths) if told.any() and len(self.t) else None
        self.known = told[: len(robots)]  # (N,) whose truth was told
        self.truth = None if self.bodies is None or not self.known.any() else self.bodies[:, : len(robots)]
        poses = recording.messages.get(key(arena, POSES, CAMERA), ())
        self.news = recording.measured(key(arena, NEWS, CAMERA), TRACKER_NEWS)
        self.states = _changes(recording, key(arena, STATE))
        frames = [frame for payload in poses if (frame := FLEET_POSES.decode(payload)) is not None]
        began = int(self.ticks["poses_seq"][0]) if len(self.ticks) else 0
        self.frames = [frame for frame in frames if frame.seq >= began]  # without those of the checks before

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
        places = np.full((len(config.bystanders), 3), np.nan)
        tags = {robot.tag: row for row, robot in enumerate(config.bystanders)}
        for frame in self.frames if tags else ():
            for pose in frame.poses:
                if pose.tag in tags and pose.coasted_ns == 0:
                    places[tags[pose.tag]] = pose.x_m, pose.y_m, pose.psi_rad
        true = None if self.bodies is None else self.bodies[-1, len(config.platoon) :]
        return places if true is None else np.where(np.isfinite(true), true, places)

    def points(self) -> Array | None:
        """Points p (K, N, 2): true ones, else as estimated."""
        if not len(self.t):
            return None
        estimates = np.stack([self.items["point_x_m"], self.items["point_y_m"]], axis=-1)
        if self.truth is None:
            return estimates
        ahead = self.config.controller.point_ahead_m
        psi = self.truth[..., 2]
        true = self.truth[..., :2] + ahead * np.stack([np.cos(psi), np.sin(psi)], axis=-1)
        return np.where(self.known[:, None], true, estimates)

    def after(self, start_s: float) -> NDArray[np.bool_]:
        """Return which ticks count."""
        return np.asarray(self.t >= start_s)


def _can_be(rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Return of which rows (K,) every figure can be true."""
    good = np.ones(len(rows), np.bool_)
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            good &= np.abs(rows[name]) < _BEYOND  # a NaN is not
    return good


def _with_gaps(items: NDArray[Any]) -> NDArray[Any]:
    """Return the robots of ticks (K, N) with NaN in place of every figure that is not finite, or beyond any arena."""
    wrong = {name: ~(np.abs(items[name]) < _BEYOND) for name in items.dtype.names or ()}
    if not any(where.any() for where in wrong.values()):
        return items
    items = items.copy()
    for name, where in wrong.items():
        items[name][where] = np.nan
    return items


def _changes(recording: Recording, full: str) -> list[tuple[int, RunState]]:
    """Return the run's states, each with its place in the order of all messages; repetitions are left out."""
    changes: list[tuple[int, RunState]] = []
    for place, payload in recording.placed(full):
        state = RUN_STATE.decode(payload)
        if state is not None and (not changes or state[2:] != changes[-1][1][2:]):
            changes.append((place, state))
    return changes
