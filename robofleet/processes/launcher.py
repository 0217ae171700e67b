"""Runs a platoon in real time: starts the processes, arms, runs, stops, and leaves nothing behind."""

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from robofleet.clock import MS, S, WallClock
from robofleet.comms.bus import Answer
from robofleet.comms.keys import CAMERA, PICTURE, REQUEST, STATE, STATUS, TICK, key
from robofleet.comms.messages import ROBOT_STATUS, RUN_STATE, TICK_RECORD, RunState
from robofleet.comms.requests import asked
from robofleet.comms.zenoh_bus import ZenohBus
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.processes import controller, tracker
from robofleet.processes.arena_file import twin_port
from robofleet.processes.child_faults import ChildFaults
from robofleet.processes.children import Child, Children, RunError
from robofleet.processes.estop import emergency_stop
from robofleet.processes.readiness import missing
from robofleet.processes.terminal import EMERGENCY_KEYS, Interrupts, Terminal, interrupts
from robofleet.recording.causes import run_cause
from robofleet.recording.channels import keys
from robofleet.recording.run import Recording, Watch
from robofleet.safety.advice import advised
from robofleet.safety.arming import Stage
from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import Event, Phase

_REST_WITHIN_NS = S
_SILENT_NS = 2 * S
_POLL_NS = 50 * MS
_ATTENDED_NS = 200 * MS
_STREAM = 65536  # messages; half a minute of a fleet of four
_SHOWN = 512  # messages of a key, for the live view
_AT_REST_RAD_S = 0.01
_PHASES = {Phase.ARMED: "arming", Phase.RUNNING: "running", Phase.HOLD: "held"}
_EMERGENCY = "emergency stop"
_TWICE = 2
_ASKED_BY_KEY = {"a": b"arm", "s": b"start", "h": b"hold", "r": b"resume"}

Outcome = tuple[str, str | None]


class InterruptedRunError(Exception):
    """The operator asked for the end: a controlled stop."""


class EmergencyError(Exception):
    """The operator asked for the emergency stop, or is gone; the message says how that was seen."""


class Launcher:
    """One run in real time. ``run`` returns (outcome, cause); ``recording`` has the newest messages, a file all.

    ``reset`` clears the latches that an earlier run left; ``take_over`` takes the robots from a controller that still
    has them, if they stand; ``web`` opens the operator's page, which the run does not need.
    """

    def __init__(
        self,
        config: Config,
        folder: Path,
        watch: Watch,
        terminal: Terminal,
        *,
        reset: bool = False,
        take_over: bool = False,
        web: bool = False,
    ) -> None:
        self._config, self._folder, self._watch, self._terminal = config, folder, watch, terminal
        self._reset, self._take_over, self._web = reset, take_over, web
        self._clock = WallClock()
        self.recording = Recording(config)
        self._arena, self._robots = config.arena.name, config.ids
        self._state_key, self._tick_key = key(self._arena, STATE), key(self._arena, TICK)
        self._picture_key = key(self._arena, PICTURE, CAMERA)
        self._status_keys = [key(self._arena, STATUS, robot) for robot in self._robots]
        # started first and ended last: the recorder keeps how the others end, a twin answers until its driver is closed
        self._first = ("router", "recorder", *(("twins",) if config.twins else ()))
        self._phase = "starting"
        self._ending = False
        self._attended_ns = 0  # when the supervisor was told last that the operator is there
        self._heard_ns = 0  # when the supervisor was heard last
        self._answer: Answer | None = None  # to what a key asked
        self._counted = Interrupts()
        self._page: Child | None = None

    def run(self) -> Outcome:
        """Start everything, run for the configured time, stop, reap."""
        config_file = self._folder / "config.yaml"
        config_file.write_text(resolved_yaml(self._config))
        logs = self._folder / "log"
        logs.mkdir()
        fleet = Children(logs, config_file)
        with interrupts() as self._counted, ExitStack() as held:
            try:
                outcome = self._outcome_of(fleet, held)
                self.recording.outcome, self.recording.cause = outcome
                return outcome
            finally:
                fleet.reap(self._clock, but=len(self._first))
                fleet.reap(self._clock, last_word=self.recording.ending())
                for robot in self._config.twins:  # one that was killed has left its port
                    twin_port(self._arena, robot.id).unlink(missing_ok=True)

    def _outcome_of(self, fleet: Children, held: ExitStack) -> Outcome:
        try:
            self._start(fleet)
            return self._drive(fleet, held)
        except RunError as error:
            return "fault", str(error)
        except (InterruptedRunError, EmergencyError) as why:
            return "stopped", str(why)

    def _start(self, fleet: Children) -> None:
        self._watch(self.recording, "compiling")
        for name in self._first:  # they have no kernels
            fleet.start(name, name)
        controller.compile_kernels(self._config)
        tracker.compile_kernels(self._config)
        self._watch(self.recording, "starting")
        fleet.wait_ready(self._clock, self._listen)
        if self._web:
            self._page = fleet.start("web", "web", needed=False)
        for name in ("supervisor", "tracker"):
            fleet.start(name, name)
        fleet.start("controller", "controller", *(["--takeover"] if self._take_over else []))
        ours = self._config.driven if self._config.drivers.started_by == "run" else {}
        for name, robots in ours.items():
            fleet.start(name, "driver", "--robots", ",".join(robots))
        fleet.wait_ready(self._clock, self._listen)

    def _drive(self, fleet: Children, held: ExitStack) -> Outcome:
        bus = ZenohBus(self._arena, self._config.bus.endpoint, "launcher", self._clock)
        held.callback(bus.close)  # after the router has ended: leaving one that is stopped takes many seconds
        self._bus, self._fleet = bus, fleet
        self._faults = ChildFaults(self._config, self._clock, fleet)
        self._terminal.emergency = self._stop_now
        held.callback(setattr, self._terminal, "emergency", lambda: None)
        try:
            self._stream = bus.stream(*keys(self._config), capacity=_STREAM)
            self._heard_ns = self._clock.now_ns()
            try:
                return self._ended(*self._follow())
            except InterruptedRunError as why:
                return self._ended("stopped", str(why))
        except EmergencyError as why:
            return self._emergency(str(why))

    def _follow(self) -> Outcome:
        """See the run through its checks and its laps; returns how it ended."""
        waits = self._config.run.start == "operator"
        self._phase = "waiting" if waits else "arming"
        if self._reset:
            self._ask(b"reset")
        if not waits:
            self._ask(b"start")
        last_tick = round(self._config.run.duration_s / self._config.controller.tick_s)
        phases, began_ns = {Phase.IDLE: self._phase, **_PHASES}, 0
        before = (Phase.IDLE, Phase.ARMED) if waits else (Phase.IDLE,)  # who waits for a start may stop the checks
        try:
            while (state := self._polled()) is None or state.phase in phases:
                if state is not None:
                    proved = state.phase == Phase.ARMED and state.stage == Stage.DONE
                    self._enter("armed" if proved else phases[Phase(state.phase)])
                    phases = phases if state.phase in before else _PHASES
                if self._phase == "running":
                    self._faults.begin()
                    began_ns = began_ns or self._clock.now_ns()
                    tick = self._newest(self._tick_key, TICK_RECORD)
                    if tick is not None and tick.run_tick >= last_tick:
                        return "completed", None
        finally:
            self.recording.elapsed_s = (self._clock.now_ns() - began_ns) / S if began_ns else 0.0
        return self._outcome(state)

    def _enter(self, phase: str) -> None:
        if phase != self._phase:
            self._phase, self._terminal.note = phase, ""

    def _outcome(self, state: RunState) -> Outcome:
        cause = advised(run_cause(state, self._robots), state.cause)
        if state.phase == Phase.ESTOP:
            self._listen()  # it may be our own operator's
            raise EmergencyError(cause)
        if self._stopped_at_gates():  # past the supervisor, which names something else first
            raise EmergencyError(f"at the gates; {cause}")
        if state.cause == Event.ARMED_TOO_LONG:
            cause = f"{cause}: {missing(self.recording)}"
        return ("stopped" if state.phase == Phase.IDLE else "fault"), cause

    def _ended(self, outcome: str, cause: str | None) -> Outcome:
        """Ask for the controlled stop and wait until every wheel is at rest; then it is over."""
        self._phase, self._ending = "stopping", True
        try:
            asked(self._bus, self._clock, "supervisor", b"stop", self._listen)
            self._rest()
        except TimeoutError:  # then nobody renews the permissions, and the gates close
            pass
        return outcome, cause

    def _emergency(self, why: str) -> Outcome:
        """Latch every gate; a robot that does not say so is named, and its lifeline is cut at once."""
        self._phase = _EMERGENCY
        self._watch(self.recording, self._phase)
        stopped = emergency_stop(self._bus, self._clock, self._robots)
        next_step = ""
        if not stopped.silent:
            with suppress(RunError):  # whoever is silent or gone: every gate is latched
                self._rest()
            next_step = ": look at the robots, then start with --reset"
        return "stopped", f"emergency stop ({why}); {stopped.describe()}{next_step}"

    def _rest(self) -> None:
        deadline_ns = self._clock.now_ns() + _REST_WITHIN_NS
        while self._clock.now_ns() < deadline_ns and not self._at_rest():
            self._polled()

    def _ask(self, what: bytes) -> None:
        try:
            answer = asked(self._bus, self._clock, "supervisor", what, self._polled)
        except TimeoutError as error:
            raise RunError(str(error)) from error
        if not answer.startswith(b"ok"):
            latched = any((status := self._newest(k, ROBOT_STATUS)) and status.latch for k in self._status_keys)
            way_out = ": `robofleet run --reset` does it" if latched and what == b"start" else ""
            why = answer.decode(errors="replace").removeprefix("refused: ")
            raise RunError(f"{what.decode()} was refused: {why}{way_out}")

    def _polled(self) -> RunState | None:
        """Take what came, do what the operator asks, show it; returns the run's newest state."""
        keys = self._terminal.keys(self._clock, self._clock.now_ns() + _POLL_NS)
        if self._phase != _EMERGENCY:
            self._obey(keys)
            self._ask_by_key(keys)
            self._heed()
            self._attend()
        for at_ns, full, payload in self._stream.drain():
            if full != self._picture_key:
                self.recording.add(full, payload)
            if full == self._state_key:
                self._heard_ns = at_ns
        self.recording.keep_newest(_SHOWN)
        self._faults.step()
        self._fleet.check()
        if self._page is not None:
            gone = "the page is gone, the run goes on: `robofleet web` opens another one"
            self._terminal.page = gone if self._page.died else f"the operator's page: {self._page.said}"
        if self._clock.now_ns() - self._heard_ns > _SILENT_NS:
            silent = f"the supervisor went silent: see {self._folder}/log/supervisor.log"
            raise EmergencyError(f"at the gates; {silent}") if self._stopped_at_gates() else RunError(silent)
        self._watch(self.recording, self._phase)
        state: RunState | None = self._newest(self._state_key, RUN_STATE)
        return state

    def _heed(self) -> None:
        """Raise what the terminal's signals ask for."""
        counted, attended = self._counted, self._config.run.attended
        if attended and (counted.hung_up or self._terminal.lost):
            raise EmergencyError("the operator's terminal is gone")
        if counted.count >= _TWICE:
            raise EmergencyError("interrupted twice")
        if counted.count and not self._ending:
            raise InterruptedRunError("the operator interrupted")

    def _obey(self, keys: str) -> None:
        """Raise what the keys ask for."""
        if EMERGENCY_KEYS.intersection(keys):
            raise EmergencyError("by key")
        if "q" in keys and not self._ending:
            raise InterruptedRunError("the operator ended it")

    def _listen(self) -> None:
        """Raise what signals and keys ask for, where the run waits for something else."""
        self._heed()
        self._obey(self._terminal.keys(self._clock, self._clock.now_ns()))

    def _stop_now(self) -> None:
        """Stop every robot, from the thread that hears the keys: the run's own one hears of it when it can."""
        with suppress(Exception):  # the bus is being left
            emergency_stop(self._bus, self._clock, self._robots)

    def _ask_by_key(self, keys: str) -> None:
        for pressed in keys:
            if pressed in _ASKED_BY_KEY:
                self._answer = self._bus.ask(REQUEST, "supervisor", _ASKED_BY_KEY[pressed])
        if self._answer is not None and (answer := self._answer.take()) is not None:
            self._terminal.note, self._answer = answer.decode(errors="replace"), None

    def _attend(self) -> None:
        """Tell the supervisor that the operator is there: the dead man's handle."""
        now_ns = self._clock.now_ns()
        if self._config.run.attended and self._terminal.present and now_ns - self._attended_ns >= _ATTENDED_NS:
            self._attended_ns = now_ns
            self._bus.ask(REQUEST, "supervisor", b"attended")

    def _newest(self, full: str, layout: Any) -> Any:
        messages = self.recording.messages.get(full)
        return layout.decode(messages[-1]) if messages else None

    def _stopped_at_gates(self) -> bool:
        """Whether an emergency stop has reached a gate."""
        statuses = [self._newest(full, ROBOT_STATUS) for full in self._status_keys]
        return any(status is not None and status.latch == Latch.EMERGENCY_STOP for status in statuses)

    def _at_rest(self) -> bool:
        statuses = [self._newest(full, ROBOT_STATUS) for full in self._status_keys]
        return all(
            status is not None and max(abs(status.left_rad_s), abs(status.right_rad_s)) < _AT_REST_RAD_S
            for status in statuses
        )
