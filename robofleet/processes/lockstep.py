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
from robofleet.comms.bus import MemoryBus
from robofleet.comms.keys import REQUEST, STATE, TICK, key
from robofleet.comms.messages import RUN_STATE, TICK_RECORD
from robofleet.config.slices import generator
from robofleet.config.tree import Config
from robofleet.processes.controller import Controller, compile_kernels
from robofleet.processes.driver import DriverProcess
from robofleet.processes.keeping import MemoryKeeping
from robofleet.processes.node import Node
from robofleet.processes.readiness import why
from robofleet.processes.supervisor import Supervisor
from robofleet.processes.tracker import Tracker
from robofleet.recording.run import Recording, Watch
from robofleet.safety.supervisor import Event, Phase, RunStatus

_ANSWER_WITHIN_NS = S  # to the request for a start
_ARMED_WITHIN_NS = 600 * S  # the supervisor gives up before
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
    """One run: build it, ``run`` it, read its ``recording``."""

    def __init__(self, config: Config) -> None:
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
        self._slots: list[_Slot] = []
        seed, clock, bus = config.run.seed, self.clock, self.bus
        for robot in config.robots:
            rng = generator(seed, "driver", robot.id)
            self._add(partial(DriverProcess, config, (robot.id,), bus, clock, rng=rng, keeping=self.keeping))
        charge_ns, rng = round(config.lockstep.tracker_delay_s * S), generator(seed, "tracker")
        self._tracker = self._add(partial(Tracker, config, bus, clock, rng=rng, charge_ns=charge_ns))
        self._add(lambda _: Supervisor(config, bus, clock, generator(seed, "supervisor")))
        self._tracker.timed = True
        self._controller = self._add(lambda _: Controller(config, bus, clock, generator(seed, "controller")))
        self._controller.timed = True
        self._tick_key, self._state_key = key(config.arena.name, TICK), key(config.arena.name, STATE)
        self._run_tick = -1
        self._status = RunStatus()

    def run(self, watch: Watch = lambda _recording, _phase: None) -> tuple[str, str | None]:
        """Arm, run for the configured time, stop, and let the robots come to rest; returns (outcome, cause)."""
        started_ns = stopwatch_ns()
        gc.freeze()
        gc.disable()
        try:
            self.bus.ask(REQUEST, "supervisor", b"start")
            self._run_until(lambda: self._status.phase is not Phase.IDLE, _ANSWER_WITHIN_NS)
            self._run_until(lambda: self._status.phase is not Phase.ARMED, _ARMED_WITHIN_NS)
            outcome = self._lap(watch)
            self.bus.ask(REQUEST, "supervisor", b"stop")
            self._run_until(lambda: False, _REST_NS)
        except KeyboardInterrupt:
            outcome = "stopped", "the operator interrupted"
        finally:
            for slot in self._slots:
                slot.node.close()
            gc.enable()
            gc.unfreeze()
        self.recording.elapsed_s = (stopwatch_ns() - started_ns) / S
        self.recording.tick_durations_ns = self._controller.durations_ns
        self.recording.tracker_durations_ns = self._tracker.durations_ns
        self.recording.trace_hash = self._hash.hexdigest()
        return outcome

    def _lap(self, watch: Watch) -> tuple[str, str | None]:
        last_tick = round(self._config.run.duration_s / self._config.controller.tick_s)
        if self._status.phase is not Phase.RUNNING:
            return "fault", f"the fleet was not ready: {why(self.recording, self._status)}"
        while self._run_tick < last_tick:
            self._run_until(lambda: self._status.phase is not Phase.RUNNING or self._run_tick >= last_tick, S)
            watch(self.recording, "running")
            if self._status.phase is not Phase.RUNNING:
                return "fault", self._status.describe(self._config.groups[0].robots)
        return "completed", None

    def _run_until(self, done: Callable[[], bool], within_ns: int) -> None:
        """Step whatever is due next, until something is true or simulated time has passed."""
        queue, clock = self._queue, self.clock
        end_ns = clock.now_ns() + within_ns
        while not done():
            if queue[0][0] > end_ns:
                clock.advance_to(end_ns)
                return
            instant_ns, _, woken, slot = heapq.heappop(queue)
            if woken or instant_ns == slot.next_ns:
                clock.advance_to(instant_ns)
                slot.step(instant_ns)
                if self._said:
                    self._observe()

    def _add(self, make: Callable[[_Slot], Node]) -> _Slot:
        slot = _Slot(len(self._slots), self._queue)
        self._slots.append(slot)
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
                self._status = RunStatus(Phase(state.phase), Event(state.cause), state.robot, state.detail)
        self._said.clear()
