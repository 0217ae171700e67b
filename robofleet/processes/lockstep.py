"""Lockstep: the steps of every process in one process, on a simulated clock and a bus in memory.

An event queue calls each step at the instant that the step itself asked for, or when a message wakes it; ties go by a
fixed order. Same seed, config, machine and versions: same bytes on the bus.
"""

import gc
import hashlib
import heapq
from collections.abc import Callable
from functools import partial

from robofleet.clock import S, SimulatedClock, stopwatch_ns
from robofleet.comms.bus import Answer, MemoryBus
from robofleet.comms.keys import REQUEST, STATE, TICK, key
from robofleet.comms.messages import RUN_STATE, TICK_RECORD
from robofleet.config.slices import generator
from robofleet.config.tree import Config
from robofleet.processes.controller import Controller, compile_kernels
from robofleet.processes.driver import DriverProcess, Witness
from robofleet.processes.keeping import MemoryKeeping
from robofleet.processes.node import Node
from robofleet.processes.readiness import missing
from robofleet.processes.supervisor import Supervisor
from robofleet.processes.tracker import Tracker
from robofleet.recording.run import Recording, Watch
from robofleet.safety.supervisor import Event, Phase, RunStatus

_READY_WITHIN_NS = 5 * S
_REST_NS = S  # after the stop: wheels come to rest


class _Slot:
    """A process in the queue. Called with an instant it wakes the process then, beside its own schedule."""

    def __init__(self, order: int, queue: "list[tuple[int, int, bool, _Slot]]") -> None:
        self.order, self._queue = order, queue
        self.node: Node
        self.next_ns = 0
        self.timed = False
        self.durations_ns: list[int] = []

    def __call__(self, instant_ns: int) -> None:
        """Wake the process at an instant."""
        heapq.heappush(self._queue, (instant_ns, self.order, True, self))

    def schedule(self, instant_ns: int) -> None:
        """Set the process's own next instant; an entry that was queued for another one is passed over."""
        self.next_ns = instant_ns
        heapq.heappush(self._queue, (instant_ns, self.order, False, self))

    def step(self, instant_ns: int) -> None:
        """Step the process and queue what it asks for."""
        scheduled = self.next_ns == instant_ns
        if self.timed:
            started_ns = stopwatch_ns()
            next_ns = self.node.step(instant_ns)
            self.durations_ns.append(stopwatch_ns() - started_ns)
        else:
            next_ns = self.node.step(instant_ns)
        if scheduled or next_ns != self.next_ns:
            self.schedule(max(next_ns, instant_ns + 1))


class Lockstep:
    """One run: build it, ``run`` it, read its ``recording``.

    Or drive it: ``request`` and ``advance`` as often as you like, look at ``status`` and ``nodes``, ``close`` it.
    """

    def __init__(self, config: Config, witness: Witness | None = None) -> None:
        """Build every process; ``witness`` is told what each gate decides."""
        compile_kernels(config)
        self._config = config
        self.clock = SimulatedClock()
        self.clock.advance_to(S)  # 0 means "never" in many fields
        self.bus = MemoryBus(config.arena.name, self.clock, round(config.lockstep.bus_delay_s * S))
        self.keeping = MemoryKeeping()
        self.recording = Recording(config)
        self._hash = hashlib.blake2b(digest_size=16)
        self._said: list[tuple[str, bytes]] = []  # by the step that is under way
        self.bus.tap(self._said.append)
        self._queue: list[tuple[int, int, bool, _Slot]] = []
        self._slots: dict[str, _Slot] = {}
        seed, clock, bus = config.run.seed, self.clock, self.bus
        for robot in config.robots:
            rng = generator(seed, "driver", robot.id)
            make = partial(DriverProcess, config, (robot.id,), bus, clock, rng=rng, keeping=self.keeping)
            self._add(f"driver-{robot.id}", partial(make, witness=witness))
        charge_ns, rng = round(config.lockstep.tracker_delay_s * S), generator(seed, "tracker")
        self._tracker = self._add("tracker", partial(Tracker, config, bus, clock, rng=rng, charge_ns=charge_ns))
        self._add("supervisor", lambda _: Supervisor(config, bus, clock, generator(seed, "supervisor")))
        self._tracker.timed = True
        self._controller = self._add(
            "controller", lambda _: Controller(config, bus, clock, generator(seed, "controller"))
        )
        self._controller.timed = True
        self._tick_key, self._state_key = key(config.arena.name, TICK), key(config.arena.name, STATE)
        self._run_tick = -1
        self.status = RunStatus()  # as the supervisor said it last

    @property
    def nodes(self) -> dict[str, Node]:
        """The processes by their names: supervisor, tracker, controller, driver-r1, ..."""
        return {name: slot.node for name, slot in self._slots.items()}

    def request(self, payload: bytes) -> Answer:
        """Ask the supervisor for something, as an operator does; take the answer after some milliseconds."""
        return self.bus.ask(REQUEST, "supervisor", payload)

    def advance(self, duration_s: float, done: Callable[[], bool] = lambda: False) -> bool:
        """Let simulated time pass, or until something is true; returns whether it became true."""
        return self._run_until(done, round(duration_s * S))

    def close(self) -> None:
        """Close every process."""
        for slot in self._slots.values():
            slot.node.close()
        self.recording.trace_hash = self._hash.hexdigest()

    def run(self, watch: Watch = lambda _recording, _phase: None) -> tuple[str, str | None]:
        """Arm, run for the configured time, stop, and let the robots come to rest; returns (outcome, cause)."""
        started_ns = stopwatch_ns()
        gc.freeze()
        gc.disable()
        try:
            self.request(b"start")
            self._run_until(lambda: self.status.phase is Phase.RUNNING, _READY_WITHIN_NS)
            outcome = self._lap(watch)
            self.request(b"stop")
            self._run_until(lambda: False, _REST_NS)
        except KeyboardInterrupt:
            outcome = "stopped", "the operator interrupted"
        finally:
            self.close()
            gc.enable()
            gc.unfreeze()
        self.recording.elapsed_s = (stopwatch_ns() - started_ns) / S
        self.recording.tick_durations_ns = self._controller.durations_ns
        self.recording.tracker_durations_ns = self._tracker.durations_ns
        return outcome

    def _lap(self, watch: Watch) -> tuple[str, str | None]:
        last_tick = round(self._config.run.duration_s / self._config.controller.tick_s)
        if self.status.phase is not Phase.RUNNING:
            why = missing(self.recording)
            return "fault", f"the fleet was not ready after {_READY_WITHIN_NS / S:.0f} s: {why}"
        while self._run_tick < last_tick:
            self._run_until(lambda: self.status.phase is not Phase.RUNNING or self._run_tick >= last_tick, S)
            watch(self.recording, "running")
            if self.status.phase is not Phase.RUNNING:
                return "fault", self.status.describe(self._config.groups[0].robots)
        return "completed", None

    def _run_until(self, done: Callable[[], bool], within_ns: int) -> bool:
        """Step whatever is due next, until something is true or simulated time has passed; returns which."""
        queue, clock = self._queue, self.clock
        end_ns = clock.now_ns() + within_ns
        while not done():
            if queue[0][0] > end_ns:
                clock.advance_to(end_ns)
                return False
            instant_ns, _, woken, slot = heapq.heappop(queue)
            if woken or instant_ns == slot.next_ns:
                clock.advance_to(instant_ns)
                slot.step(instant_ns)
                if self._said:
                    self._observe()
        return True

    def _add(self, name: str, make: Callable[[_Slot], Node]) -> _Slot:
        slot = self._slots[name] = _Slot(len(self._slots), self._queue)
        slot.node = make(slot)
        slot.schedule(self.clock.now_ns())
        return slot

    def _observe(self) -> None:
        """Keep and hash what a step said, in order, and note how far the run is."""
        update, messages = self._hash.update, self.recording.messages
        for full, payload in self._said:
            update(full.encode() + payload)
            messages[full].append(payload)
            if full == self._tick_key and (head := TICK_RECORD.decode_head(payload)) is not None:
                self._run_tick = head[3]
            elif full == self._state_key and (state := RUN_STATE.decode(payload)) is not None:
                self.status = RunStatus(Phase(state.phase), Event(state.cause), state.robot, state.detail)
        self._said.clear()
