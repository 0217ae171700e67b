"""Replay: what every tick of a recorded run took goes through today's controller, and what it says is compared.

A record says which poses and which state its tick took; the grid gives the instant. Nothing else reaches what a
controller decides: what the drivers say is about leases, and the commands carry the wheels of the record.

What a controller believes depends on all its ticks. So it is known from a beginning on, until a record or a message
is missing. A beginning is its first tick, or one that had taken nothing yet: as after another had these robots.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours import described
from robofleet.behaviours.interface import Decision
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import COMMAND, POSES, STATE, TELEOP, TICK, WISH, Topic, key
from robofleet.bus.layouts import ListLayout
from robofleet.bus.messages import FLEET_POSES, RUN_STATE, SCRIPT_WISH, TICK_RECORD, RobotTick
from robofleet.bus.setpoints import setpoint_topics
from robofleet.config import groups, slices
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.clock import S, SimulatedClock, TickGrid
from robofleet.nodes.controller import Controller
from robofleet.recording.provenance import Provenance
from robofleet.recording.reading import RecordingError
from robofleet.recording.run import Recording
from robofleet.safety.supervisor import Event

Rows = NDArray[Any]
Name = tuple[int, int]  # of a message: its sender's epoch, and its number
NO_NAME = (0, 0)

_OTHER_MACHINE_TOLERANCE = 1e-9  # other versions, or another processor: sums may be in another order
_SHOWN_DIFFERENCES = 5
_ALWAYS = 2  # of what a tick takes: its head names the state and the first camera's image; its numbers name the rest
_EARLIER_TOPICS = {TELEOP: (WISH,)}  # on which older recordings have the messages of a topic
_HEAD = ("run_tick", "phase", "exposure_ns")  # the rest of a record's head is whose it is, and what the time was
_WHEELS = [RobotTick._fields.index(name) for name in ("left_rad_s", "right_rad_s")]


class Difference(NamedTuple):
    """A figure that came out otherwise."""

    tick: int
    what: str  # robot and column, as in a TickRecord
    recorded: float
    now: float

    def __str__(self) -> str:
        return f"tick {self.tick}: {self.what}: {self.recorded!r} was recorded, now {self.now!r}"


@dataclass
class Hole:
    """Ticks that cannot be compared, and why."""

    first: int
    last: int
    why: str

    def __str__(self) -> str:
        return f"ticks {self.first} to {self.last} were not compared: {self.why}"


@dataclass
class Verdict:
    """What a replay found."""

    robots: int
    tolerance: float  # of a figure; 0: to the last bit
    ticks: int = 0  # compared
    commands: int = 0  # compared
    differences: list[Difference] = field(default_factory=list)
    holes: list[Hole] = field(default_factory=list)

    @property
    def equal(self) -> bool:
        """Whether everything was compared, and nothing is different."""
        return not (self.differences or self.holes)

    def lines(self) -> list[str]:
        """Return what an operator should read: the first differences, what was not compared; at last, the result."""
        found = [*map(str, self.differences[:_SHOWN_DIFFERENCES]), *map(str, self.holes)]
        exactly = f"within {self.tolerance:g}" if self.tolerance else "bit for bit"
        many = len(self.differences)
        result = f"{many} difference{'s' * (many > 1)}" if many else f"equal, {exactly}"
        return [*found, f"{self.ticks} ticks and {self.commands} commands of {self.robots} robots: {result}"]


def tolerance(recording: Recording) -> float:
    """Return how far a figure may be off: not at all where the same versions on the same processor recorded it."""
    made_by = recording.provenance
    return (
        0.0
        if made_by and made_by.same_machine(Provenance.here(recording.config, made_by.mode))
        else _OTHER_MACHINE_TOLERANCE
    )


def replay(recording: Recording, within: float) -> Verdict:
    """Drive today's controller with what the recorded ones took; ``within`` is the tolerance, 0: bit for bit.

    Raises:
        RecordingError: if no controller said anything, or a behaviour tells other figures than it did.
    """
    _same_figures(recording)
    arena, verdict = recording.config.arena.name, Verdict(len(recording.config.members), within)
    cameras = recording.config.camera_names
    dtype = TICK_RECORD.dtype(len(recording.config.members), described.size(recording.groups, len(cameras)))
    payloads = recording.messages.get(key(arena, TICK), ())
    ticks = np.frombuffer(b"".join(p for p in payloads if len(p) == dtype.itemsize), dtype=dtype)
    if not len(ticks):
        raise RecordingError("no tick of a controller was recorded: there is nothing to replay")
    names = described.names(recording.groups)
    scripted, topics = _scripted(recording), setpoint_topics(recording.config)
    takings = (
        _Takings(recording, STATE, "", RUN_STATE),
        *(_Takings(recording, POSES, name, FLEET_POSES) for name in cameras),
        *(_Takings(recording, topics[name], name, SCRIPT_WISH) for name in scripted),
    )  # fmt: skip
    for epoch in dict.fromkeys(ticks["epoch"].tolist()):
        _, once = np.unique(ticks["tick"][(of_it := np.flatnonzero(ticks["epoch"] == epoch))], return_index=True)
        recorded = ticks[of_it[once]]
        named = (*_further(recording, len(cameras)), *scripted.values())
        others = [_named(recorded["figures"], at) for at in named]
        known, now = _driven(recording.config, recorded, takings, others, verdict.holes)
        _compare_ticks(recording.config, names, recorded[known], now, verdict)
        _compare_commands(recording, recorded, known, now, verdict)
    verdict.differences.sort(key=lambda difference: difference.tick)
    return verdict


def _same_figures(recording: Recording) -> None:
    """Refuse a recording of a behaviour that tells other figures today: ticks would have other columns."""
    for then, now in zip(recording.groups, groups.descriptions(recording.config), strict=True):
        before, after = ([figure.key for figure in group.figures] for group in (then, now))
        if before != after:
            figures = " and ".join(
                f"{', '.join(keys) or 'none'} {when}" for keys, when in ((before, "in the recording"), (after, "today"))
            )
            why = f"{then.behaviour} has other figures: {figures}"
            raise RecordingError(f"group {then.name}: {why}: replay it with the version that recorded it")


class _Takings:
    """The messages of a key by their names."""

    def __init__(self, recording: Recording, topic: Topic, name: str, layout: ListLayout[Any]) -> None:
        self.topic, self.name = topic, name
        self.messages: dict[Name, bytes] = {}
        for recorded in (topic, *_EARLIER_TOPICS.get(topic, ())):
            for payload in recording.messages.get(key(recording.config.arena.name, recorded, name), ()):
                if (head := layout.decode_head(payload)) is not None:
                    self.messages.setdefault((head.epoch, head.seq), payload)


def _scripted(recording: Recording) -> dict[str, tuple[int, int]]:
    """Return the groups that scripts drive, and where in a tick's numbers their setpoints are named: epoch, number."""
    names, found = described.names(recording.groups), {}
    for group in recording.groups:
        own = [f"{group.robots[0]}: {figure}" for figure in ("wish_epoch", "wish")]
        if set(own) <= {*names}:
            found[group.name] = names.index(own[0]), names.index(own[1])
    return found


def _further(recording: Recording, cameras: int) -> list[tuple[int, int]]:
    """Return where in a tick's numbers the images of each camera but the first are named."""
    first, last = (described.size(recording.groups, count) for count in (1, cameras))
    return [(at, at + 1) for at in range(first, last, described.NAMING)]


def _named(numbers: Array, at: tuple[int, int]) -> list[Name]:
    """Return the setpoints that each tick followed, or the image that it took, by its name."""
    counts = np.nan_to_num(np.clip(numbers[:, at], 0, 2**53), nan=0.0).astype(np.int64)
    return [(int(epoch), int(seq)) for epoch, seq in counts]


class _Player:
    """Today's controller on a grid of its own, on a bus that has only what it is given."""

    def __init__(self, config: Config, grid: TickGrid, takings: tuple[_Takings, ...]) -> None:
        self._grid, self._clock = grid, SimulatedClock()
        self._clock.advance_to(grid.origin_ns)
        bus = MemoryBus(config.arena.name, self._clock, 0)
        self._ticks = bus.newest(TICK)
        self._give = [(taking, bus.publisher(taking.topic, taking.name)) for taking in takings]
        self._given = [NO_NAME] * len(takings)
        self._late: frozenset[int] = frozenset()
        rng = slices.generator(config.run.seed, "replay")
        self._controller = Controller(config, bus, self._clock, rng, judge=self._judged)

    def _judged(self, group: int, decide: Callable[[], Decision]) -> tuple[Decision, bool]:
        """Call a behaviour; whether it was late is what the record says."""
        return decide(), group in self._late

    def tick(self, index: int, taken: tuple[Name, ...], late: frozenset[int]) -> bytes | None:
        """Return the record of a tick that takes these messages; None where one of them was not recorded.

        ``late``: the groups whose behaviours took too long.

        One that the controller had already changes nothing, however often it came.
        """
        self._clock.advance_to(self._grid.instant(index))
        self._late = late
        for k, (taking, publish) in enumerate(self._give):
            if taken[k] != self._given[k] and (k < _ALWAYS or taken[k] != NO_NAME):
                payload = taking.messages.get(taken[k])
                if payload is None:
                    return None
                publish(payload)
                self._given[k] = taken[k]
        self._controller.step(self._clock.now_ns())
        return self._ticks.take()


def _driven(
    config: Config, recorded: Rows, takings: tuple[_Takings, ...], others: list[list[Name]], holes: list[Hole]
) -> tuple[NDArray[np.bool_], Rows]:
    """Replay the records of one controller, in order; returns which of them could be, and what it says of those."""
    period_ns = round(config.controller.tick_s * S)
    payloads: list[bytes | None] = []
    player, before, why = None, 0, ""
    head = ["tick", "overruns", "stamp_ns", "state_epoch", "state_seq", "poses_epoch", "poses_seq"]
    firsts = [own.start for own in groups.rows(config.groups)]
    failed = recorded["items"]["failed"][:, firsts] == Event.BEHAVIOUR_LATE
    for k, (row, late) in enumerate(zip(recorded[head], failed, strict=True)):
        tick, overruns, stamp_ns, *names = row.item()
        taken = (names[0], names[1]), (names[2], names[3]), *(records[k] for records in others)
        done = tick - overruns
        if done != before + 1 or player is None:
            if done == 1 or not any(names):
                player = _Player(config, TickGrid(stamp_ns - tick * period_ns, period_ns), takings)
            elif done != before + 1:
                missing = done - before - 1
                player, why = (
                    None,
                    f"{missing} record{'s' * (missing > 1)} before them {'are' if missing > 1 else 'is'} missing",
                )
        before = done
        payload = None if player is None else player.tick(tick, taken, frozenset(np.flatnonzero(late).tolist()))
        if payload is None and player is not None:
            player, why = None, "a message that the first of them took is missing"
        if payload is None and (not payloads or payloads[-1] is not None or holes[-1].why != why):
            holes.append(Hole(tick, tick, why))
        elif payload is None:
            holes[-1].last = tick
        payloads.append(payload)
    known = np.array([payload is not None for payload in payloads])
    return known, np.frombuffer(b"".join(payload for payload in payloads if payload is not None), dtype=recorded.dtype)


def _compare_ticks(config: Config, names: list[str], recorded: Rows, now: Rows, verdict: Verdict) -> None:
    verdict.ticks += len(recorded)
    for name in _HEAD:
        for k in np.flatnonzero(recorded[name] != now[name]):
            verdict.differences.append(Difference(int(now["tick"][k]), name, int(recorded[name][k]), int(now[name][k])))

    def compare(old: Array, new: Array, named: Callable[..., str]) -> None:
        for k, *column in np.argwhere(_different(old, new, verdict.tolerance)):
            values = float(old[k, *column]), float(new[k, *column])
            verdict.differences.append(Difference(int(now["tick"][k]), named(*column), *values))

    fields = RobotTick._fields
    compare(_columns(recorded), _columns(now), lambda row, column: f"{config.members[row].id}: {fields[column]}")
    old, new = recorded["figures"], now["figures"]
    compare(old, np.where(np.isnan(old) & np.isnan(new), old, new), names.__getitem__)


def _compare_commands(
    recording: Recording, recorded: Rows, known: NDArray[np.bool_], now: Rows, verdict: Verdict
) -> None:
    """Compare every command with its tick's wheels: its number is above that of the tick's record.

    Where the next record is missing it is unknown which are the tick's, but for each robot's first one.
    """
    done = recorded["tick"] - recorded["overruns"]
    closed = np.append(done[1:] == done[:-1] + 1, [False])
    wheels = np.full((len(recorded), len(recording.config.members), 2), np.nan)
    wheels[known] = _columns(now)[..., _WHEELS]
    for row, robot in enumerate(recording.config.members):
        given = recording.of_robot(COMMAND, robot.id)
        given = given[(given["epoch"] != 0) & (given["session"] >> 32 == recorded["epoch"][0])]
        given = given[np.argsort(given["seq"], kind="stable")]
        at = np.searchsorted(recorded["command_seq"], given["seq"]) - 1
        first = np.diff(at, prepend=-1) > 0
        counted = (at >= 0) & known[at] & (closed[at] | first)
        given, at = given[counted], at[counted]
        verdict.commands += len(given)
        old, new = np.stack([given["left_rad_s"], given["right_rad_s"]], axis=-1), wheels[at, row]
        for k, side in np.argwhere(_different(old, new, verdict.tolerance)):
            what = f"{robot.id}: command {given['seq'][k]}, {RobotTick._fields[_WHEELS[side]]}"
            tick = int(recorded["tick"][at[k]])
            verdict.differences.append(Difference(tick, what, float(old[k, side]), float(new[k, side])))


def _columns(rows: Rows) -> Array:
    """Return what records say of their robots: (K, N, columns)."""
    items = rows["items"]
    return np.ascontiguousarray(items).view(np.float64).reshape(*items.shape, len(RobotTick._fields))


def _different(old: Array, new: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return which doubles differ by more than the tolerance; with none, which have other bits."""
    bits: NDArray[np.bool_] = np.ascontiguousarray(old).view(np.uint64) != np.ascontiguousarray(new).view(np.uint64)
    return bits & ~(np.abs(old - new) <= tolerance) if tolerance else bits
