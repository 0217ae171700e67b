"""A bus as one process sees it through a bad network: the faults act where messages are received."""

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import numpy as np

from robofleet.bus.bus import Arrival, Bus, BySender, Publish, Request, Stream, Subscription, Wake
from robofleet.bus.keys import COMMAND, ENABLE, POSES, STATE, STATUS, TICK, TRUTH, AnyLayout, Topic, named, said_by
from robofleet.bus.layouts import ListLayout
from robofleet.bus.messages import TICK_RECORD, UNIT_TRUTH
from robofleet.core.clock import MS, Clock, S
from robofleet.simulation.faults import Injection, Schedule, struck

_TOPICS = {"cmd": COMMAND, "enable": ENABLE, "status": STATUS, "poses": POSES, "state": STATE, "tick": TICK}
_OF_ONE_UNIT = (COMMAND, ENABLE, STATUS)
_STAMPED: dict[Topic, ListLayout[Any]] = {
    TRUTH: UNIT_TRUTH,
    TICK: TICK_RECORD,
}  # by these stamps a simulated world and its camera are timed
_MOST_HELD = 1024  # messages of one subscription
_APART_NS = 30_000  # between messages that were held back: what a router needs for each
_COPY_AFTER_NS = MS
_P99_SIGMA = 2.3263


class FaultyBus:
    """Wraps the bus of one process. ``simulated_router``: lockstep has no router to kill or to stop but this one."""

    def __init__(
        self, bus: Bus, schedule: Schedule, process: str, clock: Clock, *, simulated_router: bool = False
    ) -> None:
        self._bus, self._schedule, self._process, self._clock = bus, schedule, process, clock
        self._simulated_router = simulated_router
        self.listen, self.listen_by_sender, self.ask, self.close = bus.listen, bus.listen_by_sender, bus.ask, bus.close
        self.alive = True  # a killed process's subscriptions wake nobody

    def publisher(self, topic: Topic, name: str = "") -> Publish:
        publish, layout = self._bus.publisher(topic, name), _STAMPED.get(topic)
        if layout is None or not self._clock_steps:
            return publish

        def restamped(payload: bytes) -> None:
            changed = bytearray(payload)
            np.ndarray((1,), layout.head_dtype, changed)["stamp_ns"] -= self._ahead_ns()
            publish(bytes(changed))

        return restamped

    def newest(self, topic: Topic, name: str = "", wake: Wake | None = None) -> Subscription:
        woken = self._guarded(wake)
        fate = _Fate(self._schedule, self._process, topic, name, self._cuts(topic, name))
        if fate.harmless and self._simulated_router and not self._clock_steps:
            return self._bus.newest(topic, name, woken)
        subscription = _FaultySubscription(self._schedule, topic, fate, woken, self._ahead_ns)
        self._bus.listen(topic, name, subscription.put)
        return subscription

    def newest_by_sender(self, topic: Topic, name: str) -> BySender:
        fate = _Fate(self._schedule, self._process, topic, name, self._cuts(topic, name))
        if fate.harmless and self._simulated_router and not self._clock_steps:
            return self._bus.newest_by_sender(topic, name)
        senders = BySender(lambda: _FaultySubscription(self._schedule, topic, fate, None, self._ahead_ns))
        self._bus.listen_by_sender(topic, name, senders.put)
        return senders

    def stream(self, *expressions: str, capacity: int) -> Stream:
        """Subscribe to one key; of a simulated world no network lies between."""
        (expression,) = expressions
        found = named(expression)
        if found is None or found[0] is TRUTH:
            return self._bus.stream(expression, capacity=capacity)
        fate = _Fate(self._schedule, self._process, *found, self._cuts(*found))
        stream = _FaultyStream(self._schedule, found[0], fate, None, self._ahead_ns)
        stream.key = expression
        self._bus.listen(*found, stream.put)
        return stream

    def serve(self, topic: Topic, name: str, wake: Wake | None = None) -> Callable[[], Request | None]:
        """Return the function that takes the next request that comes through."""
        take, cuts = self._bus.serve(topic, name, self._guarded(wake)), self._cuts(topic, name)
        now_ns = self._schedule.now_ns

        def through() -> Request | None:
            while (request := take()) is not None and struck(cuts, now_ns()):
                pass
            return request

        return through if cuts else take

    @property
    def _clock_steps(self) -> bool:
        return bool(self._schedule.of("clock_step", process=self._process))

    def _ahead_ns(self) -> int:
        return self._clock.now_ns() - self._schedule.now_ns()

    def _guarded(self, wake: Wake | None) -> Wake | None:
        if wake is None or not self._schedule.of("killed", process=self._process):
            return wake
        return lambda instant_ns: wake(instant_ns) if self.alive else None

    def _cuts(self, topic: Topic, name: str) -> tuple[Injection, ...]:
        """Return the cuts that lie between this process and the sender of a topic."""
        senders = said_by(topic, name)
        cuts = tuple(
            cut
            for cut in self._schedule.of("network_cut")
            if any(sender in cut.fault.processes for sender in senders) != (self._process in cut.fault.processes)
        )
        return cuts + (self._schedule.of("killed", "stopped", process="router") if self._simulated_router else ())


class _FaultySubscription:
    """Messages of one key, after what the faults did to them."""

    def __init__(
        self, schedule: Schedule, topic: Topic, fate: "_Fate", wake: Wake | None, ahead_ns: Callable[[], int]
    ) -> None:
        self._schedule, self._topic, self._fate, self._ahead_ns = schedule, topic, fate, ahead_ns
        self._wake: Wake = wake or (lambda _: None)
        self._coming: deque[tuple[int, bytes]] = deque(maxlen=_MOST_HELD)
        self._held: list[tuple[int, int, bytes]] = []  # when it is there, in which order, what
        self._order = count()
        self.arrival_ns = 0
        self.dropped = 0

    def put(self, arrival_ns: int, payload: bytes) -> None:
        """Take what the network brings, from any thread."""
        self.dropped += len(self._coming) == _MOST_HELD
        self._coming.append((arrival_ns, payload))
        self._wake(arrival_ns)

    def take(self) -> bytes | None:
        pending = self._there()
        if not pending:
            return None
        self.arrival_ns, newest = pending[-1]
        return newest

    def _there(self) -> list[tuple[int, bytes]]:
        """Return when each message that is there arrived, and it; the newest last."""
        now_ns = self._schedule.now_ns()
        while self._coming and self._coming[0][0] <= now_ns:
            arrival_ns, payload = self._coming.popleft()
            if not self._schedule.begun:
                self._schedule.hear(self._topic, payload, arrival_ns)
            for release_ns, what in self._fate.of(arrival_ns, payload):
                if len(self._held) < _MOST_HELD:
                    heapq.heappush(self._held, (release_ns, next(self._order), what))
                    if release_ns > now_ns:
                        self._wake(release_ns)
        pending = []
        while self._held and self._held[0][0] <= now_ns:
            there_ns, _, payload = heapq.heappop(self._held)
            pending.append((there_ns + self._ahead_ns(), payload))
        return pending


class _FaultyStream(_FaultySubscription):
    """All messages of one key."""

    key: str

    def drain(self) -> list[Arrival]:
        return [Arrival(at_ns, self.key, payload) for at_ns, payload in self._there()]


class _Fate:
    """What becomes of the messages on one key on their way to one process."""

    def __init__(self, schedule: Schedule, process: str, topic: Topic, name: str, cuts: tuple[Injection, ...]) -> None:
        self._rng = schedule.rng(process, topic.key, name)
        self._layout = topic.layout
        self._cuts = cuts
        self._behind: bytes | None = None
        self._held_until_ns = 0
        unit = name if topic in _OF_ONE_UNIT else None
        mine = [i for i in schedule.of(*_ACTS) if topic in map(_TOPICS.__getitem__, i.fault.topics)]
        self._faults = [i for i in mine if i.fault.robot in (None, *schedule.units.get(unit or "", ()))]
        self._bursts = {
            i.number: _Bursts(schedule.rng("bursts", str(i.number), unit or ""), i.fault.share, i.fault.burst_s)
            for i in self._faults
            if i.fault.kind == "lost" and i.fault.burst_s
        }

    @property
    def harmless(self) -> bool:
        """Whether nothing will ever happen to them."""
        return not (self._faults or self._cuts)

    def of(self, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        """Return what arrives in the place of a message, and when."""
        for cut in self._cuts:
            if cut.strike(arrival_ns):
                return self._held_back(cut, payload)
        if arrival_ns < self._held_until_ns:  # what was held back goes first
            self._held_until_ns += _APART_NS
            return [(self._held_until_ns, payload)]
        arriving = [(arrival_ns, payload)]
        for injection in self._faults:
            if injection.acts(arrival_ns) and arriving:
                after = _ACTS[injection.fault.kind](self, injection, *arriving[0])
                injection.effects += after != arriving[:1]
                arriving[:1] = after
        return arriving

    def _held_back(self, cut: Injection, payload: bytes) -> list[tuple[int, bytes]]:
        if not (getattr(cut.fault, "held_back", False) or cut.fault.kind == "stopped") or math.isinf(cut.end_ns):
            return []
        self._held_until_ns = max(self._held_until_ns + _APART_NS, int(cut.end_ns))
        return [(self._held_until_ns, payload)]

    def _lost(self, injection: Injection, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        bursts = self._bursts.get(injection.number)
        if bursts is not None:
            lost = bursts.down(arrival_ns - int(injection.start_ns))
        else:
            lost = self._rng.random() < injection.fault.share
        return [] if lost else [(arrival_ns, payload)]

    def _late(self, injection: Injection, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        median_s, p99_s = injection.fault.median_s, injection.fault.p99_s
        late_s = median_s * (p99_s / median_s) ** (self._rng.standard_normal() / _P99_SIGMA)
        return [(arrival_ns + round(late_s * S), payload)]

    def _duplicated(self, injection: Injection, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        twice = self._rng.random() < injection.fault.share
        return [(arrival_ns, payload), (arrival_ns + _COPY_AFTER_NS, payload)][: 1 + twice]

    def _reordered(self, injection: Injection, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        before, self._behind = self._behind, None
        if before is not None:
            return [(arrival_ns, payload), (arrival_ns + _APART_NS, before)]
        if self._rng.random() < injection.fault.share:
            self._behind = payload  # until the next one was there
            return []
        return [(arrival_ns, payload)]

    def _not_a_number(self, injection: Injection, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        if self._rng.random() < injection.fault.share:
            payload = _with_nan(self._layout, payload)
        return [(arrival_ns, payload)]

    def _malformed(self, injection: Injection, arrival_ns: int, payload: bytes) -> list[tuple[int, bytes]]:
        if self._rng.random() < injection.fault.share:
            cut_short, too_long, other_version = payload[: len(payload) // 2], payload + b"\0", b"\xff" + payload[1:]
            payload = (cut_short, too_long, other_version)[self._rng.integers(3)]
        return [(arrival_ns, payload)]


def _with_nan(layout: AnyLayout | None, payload: bytes) -> bytes:
    """Return a message with NaN in place of a float: the first one of its head, else the last one of its last item."""
    changed = bytearray(payload)
    if isinstance(layout, ListLayout) and (arrays := layout.arrays(payload)) is not None:
        offsets = 0, layout.head_dtype.itemsize
        head, items = (np.ndarray(p.shape, p.dtype, changed, at) for p, at in zip(arrays, offsets, strict=True))
        if floats := [name for name in layout.head_dtype.names or () if layout.head_dtype[name].kind == "f"]:
            head[floats[0]] = math.nan
        elif len(items) and layout.item_floats:
            layout.floats(items)[-1, -1] = math.nan
    return bytes(changed)


_ACTS = {
    "lost": _Fate._lost,
    "late": _Fate._late,
    "duplicated": _Fate._duplicated,
    "reordered": _Fate._reordered,
    "not_a_number": _Fate._not_a_number,
    "malformed": _Fate._malformed,
}


class _Bursts:
    """When a link is down. Every process draws the same: what is lost, is lost in the air."""

    def __init__(self, rng: np.random.Generator, share: float, longest_s: float) -> None:
        self._intervals = self._drawn(rng, longest_s * S, longest_s * S / 2 * (1 / share - 1))
        self._from_ns, self._to_ns = next(self._intervals)

    def down(self, since_ns: int) -> bool:
        """Return whether the link is down at an instant, counted from the fault's start; never an earlier one."""
        while since_ns >= self._to_ns:
            self._from_ns, self._to_ns = next(self._intervals)
        return self._from_ns <= since_ns

    @staticmethod
    def _drawn(rng: np.random.Generator, longest_ns: float, mean_gap_ns: float) -> Iterator[tuple[float, float]]:
        to_ns = 0.0
        while True:  # gaps have a least length: two bursts must not make one that is longer than the longest
            from_ns = to_ns + mean_gap_ns * rng.uniform(0.5, 1.5)
            to_ns = from_ns + longest_ns * rng.uniform()
            yield from_ns, to_ns
