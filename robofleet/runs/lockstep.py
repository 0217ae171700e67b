"""Lockstep: the steps of every process in one process, on a simulated clock and a bus in memory.

An event queue calls each step at the instant that the step itself asked for, or when a message wakes it; ties go by a
fixed order. Same seed, config, machine and versions: same bytes on the bus.
"""

import gc
import hashlib
from collections.abc import Callable, Collection
from functools import partial

import numpy as np

from robofleet.bus.bus import Answer, Bus, MemoryBus
from robofleet.bus.keys import REQUEST, STATE, TICK, key
from robofleet.bus.messages import RUN_STATE, TICK_RECORD
from robofleet.config.slices import generator
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S, SimulatedClock, stopwatch_ns
from robofleet.core.compiling import on_stderr
from robofleet.core.starting import Start, Starting, followed
from robofleet.nodes.node import Node
from robofleet.nodes.unit.gated_robot import Probe
from robofleet.nodes.unit.state_store import MemoryStateStore
from robofleet.recording.beside import LogBeside
from robofleet.recording.log import RunLog
from robofleet.recording.run import Recording, Watch
from robofleet.runs import table
from robofleet.runs.event_queue import SECOND_CONTROLLER, EventQueue, ProcessFaults, Slot
from robofleet.runs.readiness import why
from robofleet.safety.supervisor import Event, Phase, RunStatus
from robofleet.simulation.faults import Schedule, SteppedClock
from robofleet.simulation.faulty_bus import FaultyBus

_ANSWER_WITHIN_NS = S  # to the request for a start
_ARMED_WITHIN_NS = 600 * S  # the supervisor's own patience is shorter
_TIMED = table.CONTROLLER, table.TRACKER
_LOADING_S, _CHECKS_S = 0.2, 0.5  # of a start, as measured: a process, and the checks on the simulated clock
_REST_NS = S  # after the stop: wheels come to rest
_OVER = frozenset(Phase) - {Phase.RUNNING, Phase.PARKING}  # nobody is there who resumes a held run
_UNDER_WAY = {Phase.POSITIONING: "positioning", Phase.PARKING: "parking"}


class Lockstep:
    """One run: build it, ``run`` it, read its ``recording``.

    Or drive it: ``request`` and ``advance`` as often as you like, look at ``status`` and ``nodes``, ``close`` it.
    """

    def __init__(
        self, config: Config, probe: Probe | None = None, log: RunLog | LogBeside | None = None,
        starting: Callable[[Starting], None] | None = None,
    ) -> None:  # fmt: skip
        """Build every process; ``probe`` is told what each gate decides, ``log`` keeps what is said.

        ``starting`` is called again and again meanwhile, from a thread. None: lines on stderr, where kernels compile.
        """
        self._config = config
        self.clock = SimulatedClock()
        self.clock.advance_to(S)  # 0 means "never" in many fields
        self.bus = MemoryBus(config.arena.name, self.clock, round(config.lockstep.bus_delay_s * S))
        self.state_store = MemoryStateStore()
        self.recording = Recording(config)
        self._hash = hashlib.blake2b(digest_size=16)
        self._messages: list[tuple[str, bytes]] = []  # by the step that is under way
        self.bus.tap(self._messages.append)
        self.faults = Schedule(config, self.clock) if config.faults else None
        self._queue = EventQueue(self.clock)
        self._probe, self._log = probe, log
        self._say = on_stderr()
        self._start: Start | None = None
        if starting is None:
            self._add_processes()
        else:
            names = [process.name for process in table.in_lockstep(config)]
            self._start = Start(names, loading_s=_LOADING_S, checks_s=_CHECKS_S, cores=1)
            with followed(self._start, starting):
                self._add_processes()
        self._tick_key, self._state_key = key(config.arena.name, TICK), key(config.arena.name, STATE)
        self._run_tick = -1
        self.status = RunStatus()  # as the supervisor said it last

    def _add_processes(self) -> None:
        config, queue, faults = self._config, self._queue, self.faults
        if faults is not None:
            names = table.injectable(config)
            queue.add("faults", lambda _: ProcessFaults(faults, queue, self.bus, names))
        for process in table.in_lockstep(config):
            queue.add(process.name, partial(self._made, process)).timed = process.row in _TIMED
        if faults is not None and faults.of("second_controller"):
            second = table.Process(SECOND_CONTROLLER, table.CONTROLLER, ())
            queue.add(SECOND_CONTROLLER, partial(self._made, second)).kill()

    def _made(self, process: table.Process, slot: Slot) -> Node:
        """Put a process together, between edges that take no real time."""
        make = process.row.make
        assert make is not None
        bus, clock = self._edges(slot)
        say = self._say if self._start is None else partial(self._start.compiles, process.name)
        node = make(
            table.Edges(
                process.config(self._config), bus, clock, slot, self._rng(slot, process), self.state_store,
                say, process.robots, self.faults, probe=self._probe,
            )
        )  # fmt: skip
        if self._start is not None:
            self._start.ready(process.name)
        return node

    def _edges(self, slot: Slot) -> tuple[Bus, Clock]:
        """Return a process's bus and clock."""
        if self.faults is None:
            return self.bus, self.clock
        clock: Clock = self.clock
        if self.faults.of("clock_step", process=slot.name):
            clock = slot.clock = SteppedClock(self.clock, self.faults, slot.name)
        slot.bus = FaultyBus(self.bus, self.faults, slot.name, clock, simulated_router=True)
        return slot.bus, clock

    def _rng(self, slot: Slot, process: table.Process) -> np.random.Generator:
        """Return a process's randomness: another one for every start."""
        again = (f"start-{slot.starts}",) if slot.starts else ()
        named = ("driver", *process.robots) if process.robots else (slot.name,)
        return generator(self._config.run.seed, *named, *again)

    @property
    def nodes(self) -> dict[str, Node]:
        """The processes by their names: supervisor, tracker, controller, driver-r1, ..."""
        return {name: slot.node for name, slot in self._queue.slots.items() if slot.node is not None}

    @property
    def backlog(self) -> int:
        """Steps that are queued."""
        return len(self._queue.heap)

    def request(self, payload: bytes) -> Answer:
        """Ask the supervisor for something, as an operator does; take the answer after some milliseconds."""
        return self.bus.ask(REQUEST, "supervisor", payload)

    def advance(self, duration_s: float, done: Callable[[], bool] = lambda: False) -> bool:
        """Let simulated time pass, or until something is true; returns whether it became true."""
        return self._run_until(done, round(duration_s * S))

    def close(self) -> None:
        """Close every process."""
        for node in self.nodes.values():
            node.close()
        self.recording.trace_hash = self._hash.hexdigest()

    def run(self, watch: Watch = lambda _recording, _phase: None) -> tuple[str, str | None]:
        """Arm, run for the configured time, stop, and let the robots come to rest; returns (outcome, cause)."""
        started_ns = stopwatch_ns()
        gc.freeze()
        gc.disable()
        try:
            self.request(b"start")
            self._run_until(lambda: self.status.phase is not Phase.IDLE, _ANSWER_WITHIN_NS)
            self._run_until(lambda: self.status.phase is not Phase.ARMED, _ARMED_WITHIN_NS)
            outcome = self._lap(watch)
            self.request(b"stop")
            self._run_until(lambda: False, _REST_NS)
        except KeyboardInterrupt:
            outcome = "stopped", "the operator interrupted"
        finally:
            self.close()
            gc.enable()
            gc.unfreeze()
        self.recording.outcome, self.recording.cause = outcome
        self.recording.elapsed_s = (stopwatch_ns() - started_ns) / S
        self.recording.tick_durations_ns = self._queue.slots["controller"].durations_ns
        trackers = [self._queue.slots[name].durations_ns for name in self._config.trackers]
        self.recording.tracker_durations_ns = [duration_ns for each in trackers for duration_ns in each]
        return outcome

    def _lap(self, watch: Watch) -> tuple[str, str | None]:
        if self.status.phase not in (Phase.RUNNING, Phase.POSITIONING):
            return "fault", why(self.recording, self.status)

        def until(done: Callable[[], bool]) -> None:
            while not done():
                phase = _UNDER_WAY.get(self.status.phase, "running")
                self._run_until(done, S)
                watch(self.recording, phase)

        until(lambda: self.status.phase is not Phase.POSITIONING)
        return self.lap(until, _OVER)

    def lap(self, until: Callable[[Callable[[], bool]], object], over: Collection[Phase]) -> tuple[str, str | None]:
        """Let a run go on that has begun, to its end; returns (outcome, cause).

        ``until`` lets time pass until something is true; ``over``: the phases that end the run.
        """
        last_tick = round(self._config.run.duration_s / self._config.controller.tick_s)
        ends = frozenset({*over, Phase.PARKING})
        until(lambda: self._run_tick >= last_tick or self.status.phase in ends)
        if self._config.run.end == "park" and self.status.phase is Phase.RUNNING:
            self.request(b"park")
            answered_ns = self.clock.now_ns() + _ANSWER_WITHIN_NS
            until(lambda: self.status.phase is not Phase.RUNNING or self.clock.now_ns() >= answered_ns)
        if self.status.phase is Phase.PARKING:
            until(lambda: self.status.phase in (*over, Phase.RUNNING))
        parked = self.status.phase is Phase.IDLE and self.status.cause in (Event.ACCOMPLISHED, Event.PARKED)
        if self.status.phase in over and not parked:
            return "fault", self.status.describe(self._config.ids)
        return "completed", None

    def _run_until(self, done: Callable[[], bool], within_ns: int) -> bool:
        """Step whatever is due next, until something is true or simulated time has passed; returns which."""
        step, end_ns = self._queue.step, self.clock.now_ns() + within_ns
        while not done():
            if not step(end_ns):
                return False
            if self._messages:
                self._observe()
        return True

    def _observe(self) -> None:
        """Keep and hash what a step said, in order, and note how far the run is."""
        add, messages = self.recording.add, self._messages
        if self._log is not None:
            self._log.add_all(messages, self.clock.now_ns())
        for full, payload in messages:
            self._hash.update(full.encode())
            self._hash.update(payload)
            add(full, payload)
            if full == self._tick_key and (run_tick := TICK_RECORD.head_of(payload, "run_tick")) is not None:
                self._run_tick = run_tick
            elif full == self._state_key and (state := RUN_STATE.decode_head(payload)) is not None:
                self.status = RunStatus.read(state.phase, state.cause, state.robot, state.detail) or self.status
                if self.faults is not None and not self.faults.begun and self.status.phase is Phase.RUNNING:
                    self.faults.begin(self.clock.now_ns())
                    self._queue.slots["faults"].schedule(self.clock.now_ns())
        self._messages.clear()
