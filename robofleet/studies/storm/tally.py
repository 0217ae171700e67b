"""The totals of a storm: effects of each kind of fault, and each event of the supervisor."""

from collections import Counter
from collections.abc import Iterator

from robofleet.safety.supervisor import Event
from robofleet.studies.storm.episode import Episode
from robofleet.studies.storm.schedule import KINDS

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
                yield f"{kind} was scheduled {self.scheduled[kind]} times and never had an effect"
            elif self.seeds >= MANY and not self.scheduled[kind]:
                yield f"{kind} never came"
        for event in REACTIONS if self.seeds >= MANY else ():
            if not self.events[event]:
                yield f"{event.name} was never the cause of anything"
