"""Lockstep's event queue: each process is called at the instant that it asked for, or when a message wakes it."""

import heapq
from array import array
from collections.abc import Callable, Iterable

from robofleet.bus.bus import Bus
from robofleet.bus.keys import TRUTH
from robofleet.bus.messages import UNIT_TRUTH, UnitTruth
from robofleet.core.clock import S, SimulatedClock, stopwatch_ns
from robofleet.core.patterns import driver_role
from robofleet.nodes.node import Node
from robofleet.simulation.faults import Injection, Schedule, SteppedClock
from robofleet.simulation.faulty_bus import FaultyBus

SECOND_CONTROLLER = "second-controller"
_TRUTH_NS = round(TRUTH.period_s * S)
_IDLE_NS = 3600 * S


class Slot:
    """A process in the queue. Called with an instant it wakes the process then, beside its own schedule."""

    def __init__(self, name: str, order: int, queue: "EventQueue", make: Callable[["Slot"], Node]) -> None:
        self.name, self.order, self._queue, self._make = name, order, queue.heap, make
        self.node: Node | None = None  # None: the process is dead
        self.starts = 0
        self.stopped = False
        self.bus: FaultyBus | None = None  # of the newest start, if there are faults
        self.clock: SteppedClock | None = None  # the process's own, if it ever jumps
        self.next_ns = 0
        self.timed = False
        self.durations_ns = array("q")

    def __call__(self, instant_ns: int) -> None:
        """Wake the process at an instant."""
        heapq.heappush(self._queue, (instant_ns, self.order, True, self))

    def schedule(self, instant_ns: int) -> None:
        """Set the process's own next instant; an entry that was queued for another one is passed over."""
        self.next_ns = instant_ns
        heapq.heappush(self._queue, (instant_ns, self.order, False, self))

    def start(self, instant_ns: int) -> None:
        """Make the process, once more if it has died."""
        self.node = self._make(self)
        self.starts += 1
        self.schedule(instant_ns)

    def kill(self) -> None:
        self.node = None
        if self.bus is not None:
            self.bus.alive = False

    def step(self, instant_ns: int) -> None:
        """Step the process and queue what it asks for."""
        if self.node is None or self.stopped:
            return
        scheduled = self.next_ns == instant_ns
        ahead_ns = 0 if self.clock is None else self.clock.offset_ns()
        started_ns = stopwatch_ns() if self.timed else 0
        next_ns = self.node.step(instant_ns + ahead_ns) - ahead_ns
        if self.timed:
            self.durations_ns.append(stopwatch_ns() - started_ns)
        if scheduled or next_ns != self.next_ns:
            self.schedule(max(next_ns, instant_ns + 1))


class EventQueue:
    """The processes, and who is due next; ties go by the order in which they were added."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self.heap: list[tuple[int, int, bool, Slot]] = []
        self.slots: dict[str, Slot] = {}

    def add(self, name: str, make: Callable[[Slot], Node]) -> Slot:
        slot = self.slots[name] = Slot(name, len(self.slots), self, make)
        slot.start(self._clock.now_ns())
        return slot

    def step(self, until_ns: int) -> bool:
        """Step whoever is due next; False, and time has passed, when nobody is due until then."""
        while self.heap[0][0] <= until_ns:
            instant_ns, _, woken, slot = heapq.heappop(self.heap)
            if woken or instant_ns == slot.next_ns:
                self._clock.advance_to(instant_ns)
                slot.step(instant_ns)
                return True
        self._clock.advance_to(until_ns)
        return False


class ProcessFaults:
    """Kills, stops and starts the other processes of the queue; itself a process of it, before all others.

    A simulated robot goes on to exist while nobody drives it: its truth is then published here.
    """

    def __init__(self, schedule: Schedule, queue: EventQueue, bus: Bus, processes: Iterable[str]) -> None:
        self._schedule, self._slots = schedule, queue.slots
        names = tuple(processes)
        self._kills = {name: schedule.of("killed", process=name) for name in names}
        self._stops = {name: schedule.of("stopped", process=name) for name in names}
        self._steps = {name: schedule.of("clock_step", process=name) for name in names}
        self._second = schedule.of("second_controller")
        self._acting: set[int] = set()  # by number
        self._truths = {driver_role(unit): (unit, bus.publisher(TRUTH, unit)) for unit in schedule.units}
        self._seq = 0

    def step(self, now_ns: int) -> int:
        """Begin and end the faults that are due."""
        turned = {injection.number for injection in self._injections() if injection.acts(now_ns)} ^ self._acting
        self._acting ^= turned
        for name, slot in self._slots.items():
            if name in self._kills or name == SECOND_CONTROLLER:
                self._apply(name, slot, now_ns, turned)
        for injection in self._injections():
            injection.effects += injection.number in turned & self._acting
        orphans = [name for name in self._truths if self._slots[name].node is None or self._slots[name].stopped]
        for name in orphans:
            self._publish_truths(name, now_ns)
        times = [t for injection in self._injections() for t in (injection.start_ns, injection.end_ns) if t > now_ns]
        return int(min([*times, now_ns + (_TRUTH_NS if orphans else _IDLE_NS)]))

    def close(self) -> None:
        """Nothing to bring to rest."""

    def _injections(self) -> list[Injection]:
        tables = (self._kills, self._stops, self._steps)
        return [i for table in tables for injections in table.values() for i in injections] + [*self._second]

    def _apply(self, name: str, slot: Slot, now_ns: int, turned: set[int]) -> None:
        def acting(injections: tuple[Injection, ...]) -> bool:
            return any(injection.number in self._acting for injection in injections)

        dead = not acting(self._second) if name == SECOND_CONTROLLER else acting(self._kills[name])
        if dead and slot.node is not None:
            slot.kill()
        elif not dead and slot.node is None:
            slot.start(now_ns)
        stopped = acting(self._stops.get(name, ()))
        resumed, slot.stopped = slot.stopped and not stopped, stopped
        if resumed or any(injection.number in turned for injection in self._steps.get(name, ())):
            slot.schedule(now_ns)

    def _publish_truths(self, name: str, now_ns: int) -> None:
        unit, publish = self._truths[name]
        self._seq += 1
        publish(UNIT_TRUTH.encode(UnitTruth(self._seq, now_ns, self._schedule.truths(unit))))
