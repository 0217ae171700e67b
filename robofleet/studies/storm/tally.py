"""Plays many seeds in parallel, and counts effects of each kind of fault and events of the supervisor."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, redirect_stderr
from functools import partial
from io import StringIO

from robofleet.config.tree import Config
from robofleet.nodes.controller import compile_kernels
from robofleet.safety.supervisor import Event
from robofleet.studies.engine import Engine
from robofleet.studies.storm.episode import Episode, play
from robofleet.studies.storm.ledger import Violation
from robofleet.studies.storm.schedule import KINDS

_REPEAT_EVERY = 25  # seeds: one is played twice
MANY = 200  # seeds after which every kind of fault must have come, and every reaction been seen
SOME = 5  # faults of a kind after which one must have had an effect: one alone may come while the fleet stands
REACTIONS = (
    Event.STOP_REQUESTED, Event.HOLD_REQUESTED, Event.RESUME_REQUESTED, Event.ESTOP_REQUESTED, Event.RESET,
    Event.DRIVER_SILENT, Event.DRIVER_RESTARTED, Event.CONTROLLER_SILENT, Event.CONTROLLER_RESTARTED,
    Event.TICKS_OVERRUN, Event.TRACKER_SILENT, Event.TRACKER_RESTARTED, Event.DISK_FULL, Event.CAMERA_STALLED,
    Event.CAMERA_FROZEN, Event.WIRED_STOP, Event.BATTERY_LOW, Event.TAG_LATE, Event.TAG_LOST, Event.TAG_TWICE,
    Event.GATE_LATCHED, Event.RUNAWAY, Event.WHEEL_STALLED,
)  # fmt: skip


class Tally:
    """Counts over seeds."""

    def __init__(self) -> None:
        self.seeds = 0
        self.simulated_s = 0.0
        self.longest_queue = 0
        self.crowded = 0
        self.scheduled: Counter[str] = Counter()  # faults
        self.injected: Counter[str] = Counter()  # their effects
        self.events: Counter[Event] = Counter()  # seeds in which each was a recorded cause
        self.failed: list[Episode] = []
        self.unplayed: list[str] = []  # seeds of which nothing is known, and why

    def add(self, episode: Episode) -> None:
        self.seeds += 1
        self.simulated_s += episode.simulated_s
        self.longest_queue = max(self.longest_queue, episode.longest_queue)
        self.crowded += episode.crowded
        self.scheduled.update(fault.kind for fault in episode.plan.faults)
        self.injected.update(episode.injected)
        self.events.update(episode.events)
        if episode.violations:
            self.failed.append(episode)

    def shortfalls(self) -> Iterator[str]:
        """Yield what a storm of so many seeds must have done and has not."""
        for kind in KINDS:
            if self.scheduled[kind] >= (1 if self.seeds >= MANY else SOME) and not self.injected[kind]:
                yield f"{kind} was scheduled {self.scheduled[kind]} times and had no effect"
            elif self.seeds >= MANY and not self.scheduled[kind]:
                yield f"{kind} never occurred"
        for event in REACTIONS if self.seeds >= MANY else ():
            if not self.events[event]:
                yield f"{event.name} was never a cause"


def storm(config: Config, seeds: Sequence[int], engine: Engine, watch: Callable[[Tally, Episode], None]) -> Tally:
    """Play all the seeds; ``watch`` is called after each."""
    compile_kernels(config)  # once, on disk, before every worker wants the same
    tally = Tally()
    with closing(engine.each(partial(examine, config), seeds)) as results:
        for index, episode, failure in results:
            if episode is None:
                tally.unplayed.append(f"seed {seeds[index]} could not be played: {failure}")
            else:
                tally.add(episode)
                watch(tally, episode)
    return tally


def examine(config: Config, seed: int) -> Episode:
    """Play a seed, and one in some twice: the same seed must leave the same messages."""
    with redirect_stderr(StringIO()):  # processes complain as they should: thousands of lines
        episode = play(config, seed)
        again = play(config, seed).trace_hash if seed % _REPEAT_EVERY == 0 else episode.trace_hash
    if again != episode.trace_hash:
        different = Violation("the same seed left other messages", 0.0, "", f"{episode.trace_hash} and {again}")
        return episode._replace(violations=(*episode.violations, different))
    return episode
