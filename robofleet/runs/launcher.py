"""Runs a platoon in real time: starts the processes, arms, runs, stops, and leaves nothing behind."""

import signal
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

from robofleet.bus.arena_file import twin_port
from robofleet.bus.bus import Answer
from robofleet.bus.keys import BUSY, NEWS, POSES, REQUEST, STATE, STATUS, TICK, key
from robofleet.bus.messages import BusyMachine, RunState
from robofleet.bus.requests import asked, on
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config import slices
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S, WallClock
from robofleet.core.errors import RobofleetError
from robofleet.core.files import write_text
from robofleet.core.starting import Start
from robofleet.nodes.machine import Silence
from robofleet.recording.run import SHOWN, Recording, Watch
from robofleet.recording.state_words import state_words
from robofleet.runs import table
from robofleet.runs.children import Children, RunError
from robofleet.runs.companion import ENDS, Companion, PageWanted
from robofleet.runs.console import EMERGENCY_KEYS, ENDING, READY, Console, Interrupts
from robofleet.runs.readiness import missing
from robofleet.safety.arming import Stage
from robofleet.safety.busy import GONE_NS, SPOILT
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import CAUSES, Event, Phase
from robofleet.simulation.faults import Schedule

# Of a start, as measured on two cores: a process until it is there, on one of them; the checks, and more of each robot.
_LOADING_S, _CHECKS_S, _CHECKS_OF_ROBOT_S = 1.1, 3.0, 0.09
_HANDED_WITHIN_NS = 10 * S  # they join within a second of the router's start, and open their ports
_REST_WITHIN_NS = S
_SILENT_NS = 2 * S
_POLL_NS = 50 * MS
_LOAD_WITHIN_NS = S // 2
_ANSWER_WITHIN_NS = 15 * S  # to a start: nothing moves before, and a busy machine is slow to tell who is there
_ATTENDED_NS = 200 * MS
_STREAM_MESSAGES = 65536  # half a minute of a fleet of four
_AT_REST_RAD_S = 0.01
_PHASES = {
    Phase.ARMED: "arming",
    Phase.POSITIONING: "positioning",
    Phase.RUNNING: "running",
    Phase.PARKING: "parking",
    Phase.HOLD: "held",
}
_EMERGENCY = "emergency stop"
_ENDS = {"fault": "ended by a fault"}
_TWICE = 2
_REQUESTS_BY_KEY = {"a": b"arm", "s": b"start", "h": b"hold", "r": b"resume"}

Outcome = tuple[str, str | None]


class InterruptedRunError(RobofleetError):
    """Raised where the operator asks for the end of a run: a controlled stop."""


class EmergencyError(RobofleetError):
    """Raised where the operator asks for the emergency stop, or is gone. The message says how that was seen."""


class Launcher:
    """One run in real time. ``run`` returns (outcome, cause); ``recording`` has the newest messages, a file all.

    ``reset`` clears the latches that an earlier run left; ``take_over`` takes the robots from a controller that still
    has them, if they stand; ``web`` opens the operator's page, and ``viewers`` says where each command serves
    its viewers (HOST:PORT): the run needs neither.
    """

    def __init__(
        self, config: Config, folder: Path, watch: Watch, console: Console, *, reset: bool = False,
        take_over: bool = False, web: PageWanted | None = None, viewers: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        self._config, self._folder, self._watch, self._console = config, folder, watch, console
        self._reset, self._take_over, self._web, self._served = reset, take_over, web, viewers or {}
        self._clock = WallClock()
        self.recording = Recording(config)
        self.began = False  # every process was ready: there is something to read and to judge
        self._arena, self._robots = config.arena.name, config.ids
        self._state_key = key(self._arena, STATE)
        started = table.started_by("run", config)
        self._trackers = tuple(config.trackers) if len(config.trackers) > 1 else ()  # one of them may die
        # ended last: the recorder keeps how the others end, a twin answers until its driver is closed
        self._first = [process for process in started if process.row.first]
        self._others = [process for process in started if not process.row.first]
        self._phase = "starting"
        self._ending = False
        self._reached_ticks = 0  # of the run, which the holds do not count
        self._attended_ns = 0  # when the supervisor was told last that the operator is there
        self._silence = Silence(self._clock.now_ns())  # of the supervisor
        self._answer: Answer | None = None  # to what a key asked
        self._interrupts: Interrupts
        self._begun = Start(
            [process.name for process in started], loading_s=_LOADING_S,
            checks_s=_CHECKS_S + _CHECKS_OF_ROBOT_S * len(self._robots),
        )  # fmt: skip
        self._companions: list[Companion] = []

    def run(self) -> Outcome:
        """Start everything, run for the configured time, stop, reap."""
        config_file = self._folder / "config.yaml"
        write_text(config_file, resolved_yaml(self._config))  # a script that waits for it never reads half of it
        logs = self._folder / "log"
        logs.mkdir()
        fleet = Children(logs, config_file)
        with self._console.interrupts() as self._interrupts, ExitStack() as held:
            try:
                outcome = self._outcome_of(fleet, held)
                self.recording.outcome, self.recording.cause = outcome
                self._tell_end(*outcome)
                self._phase = ENDING
                self._watch(self.recording, ENDING)
                return outcome
            finally:
                self._console.starting = None
                for companion in self._companions:
                    companion.end()
                fleet.reap(self._clock, but=len(self._first))
                fleet.reap(self._clock, last_word=self.recording.ending())
                for companion in self._companions:
                    companion.leave(self._clock)
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
        self._show_start()
        for process in self._first:
            if process.row is not table.RECORDER:
                fleet.start(process.name, *process.command)
        self._start_companions(fleet)

        def wait() -> None:
            self._listen()
            for child in fleet.children:
                if child.ready:
                    self._begun.ready(child.name)
                elif child.progress is not None:
                    self._begun.compiles(child.name, child.progress)
            self._show_start()

        fleet.wait_ready(self._clock, wait)
        fleet.start(table.RECORDER.name, *table.RECORDER.command)  # it may compile kernels, too
        for process in self._others:
            taking = ["--takeover"] if self._take_over and process.row is table.CONTROLLER else []
            fleet.start(process.name, *process.command, *taking)
        for child in fleet.children:
            if child.name == table.SUPERVISOR.name:
                self._silence.of(child.process.pid)
        fleet.wait_ready(self._clock, wait)  # controller and tracker compile their kernels at the same time

    def _start_companions(self, fleet: Children) -> None:
        console = self._console
        if self._web is not None:
            page = fleet.started(table.PAGE.name, (table.PAGE.name, "--host", self._web.host))
            found = partial(console.page_found, browser=self._web.browser)
            self._companions.append(Companion(page, found, console.page_gone))
        for viewer, at in self._served.items():
            child = fleet.started(viewer, (viewer, "--at", at))
            gone = partial(console.viewers_gone, viewer, child.log)
            self._companions.append(Companion(child, partial(console.viewers_found, viewer), gone))

    def _show_start(self, *, over: bool = False) -> None:
        """Show how far the start is, on the page too."""
        self._console.starting = None if over else self._begun.look()
        for companion in self._companions:
            companion.tell(self._console.starting.encode() if self._console.starting else "started")
        self._watch(self.recording, self._phase)

    def _tell_end(self, outcome: str, cause: str | None) -> None:
        """Say on the page how the run ends: nobody has judged it yet."""
        reached_s = self._reached_ticks * self._config.controller.tick_s
        how = f" after {reached_s:.1f} s" if cause is None else f": {cause.splitlines()[0]}"
        for companion in self._companions:
            companion.tell(f"{ENDS}{_ENDS.get(outcome, outcome)}{how}")

    def _drive(self, fleet: Children, held: ExitStack) -> Outcome:
        bus = ZenohBus(self._arena, self._config.bus.endpoint, "launcher", self._clock)
        held.callback(bus.close)  # after the router has ended: leaving one that is stopped takes many seconds
        self._bus, self._fleet = bus, fleet
        self._phase = READY
        self._watch(self.recording, READY)  # who loads something for the run to come does it now
        self.began = True
        self._faults = ChildFaults(self._config, self._clock, fleet)
        self._console.emergency = self._stop_now
        held.callback(setattr, self._console, "emergency", lambda: None)
        try:
            self._stream = bus.stream(*self._streamed_keys(), capacity=_STREAM_MESSAGES)
            held.callback(self._silence.close)
            self._silence.heard(self._clock.now_ns())
            try:
                return self._ended(*self._follow())
            except InterruptedRunError as why:
                return self._ended("stopped", f"{why}{self._held()}")
        except EmergencyError as why:
            return self._emergency(str(why))

    def _streamed_keys(self) -> list[str]:
        """Return the keys of what is shown and judged during a run: the recorder hears the rest."""
        common = [key(self._arena, topic) for topic in (TICK, STATE, BUSY)]
        seen = [key(self._arena, topic, camera) for camera in self._config.camera_names for topic in (POSES, NEWS)]
        return [*common, *seen, *(key(self._arena, STATUS, unit) for unit in self._config.units)]

    def _follow(self) -> Outcome:
        """See the run through its checks and its laps; returns how it ended."""
        waits = self._config.run.start == "operator"
        self._wait_for_daemons()
        if self._reset:
            self._ask(b"reset")
        self._phase = "waiting" if waits else "arming"
        if not waits:
            self._begun.checks("the checks begin")
        self._show_start(over=waits)
        if not waits:
            self._ask(b"start")
        last_tick = round(self._config.run.duration_s / self._config.controller.tick_s)
        phases, began_ns, over = {Phase.IDLE: self._phase, **_PHASES}, 0, False
        before = (Phase.IDLE, Phase.ARMED) if waits else (Phase.IDLE,)  # who waits for a start may stop the checks
        try:
            while (state := self._polled()) is None or state.phase in phases:
                if state is not None:
                    proved = state.phase == Phase.ARMED and state.stage == Stage.DONE
                    self._enter("armed" if proved else phases[Phase(state.phase)])
                    self._look_at_checks(state)
                    phases = phases if state.phase in before else _PHASES
                if self._phase == "running":
                    self._faults.begin()
                    began_ns = began_ns or self._clock.now_ns()
                    tick = self.recording.newest(TICK)
                    self._reached_ticks = max(self._reached_ticks, -1 if tick is None else tick.run_tick)
                    if self._reached_ticks >= last_tick and not over:
                        if self._config.run.end != "park":
                            return "completed", None
                        over = True
                        self._ask(b"park")
                over = over or (state is not None and state.cause == Event.OFF_TO_PARK)
        finally:
            self.recording.elapsed_s = (self._clock.now_ns() - began_ns) / S if began_ns else 0.0
        if state.cause == Event.ACCOMPLISHED or (over and state.cause == Event.PARKED):
            return "completed", None
        return self._outcome(state)

    def _look_at_checks(self, state: RunState) -> None:
        """Show the checks as the end of the start, until wheels drive or the run waits for its operator."""
        if self._phase == "arming":
            self._begun.checks(state_words(state, None, self._robots).check if state.phase == Phase.ARMED else "checks")
            self._show_start()
        elif self._console.starting is not None:
            self._show_start(over=True)

    def _wait_for_daemons(self) -> None:
        """Return when every robot's own computer has this run's configuration, or does not take it in time."""
        build, end_ns = slices.build(self._config), self._clock.now_ns() + _HANDED_WITHIN_NS

        def handed(unit: str) -> bool:
            status = self.recording.newest(STATUS, unit)
            return status is not None and status.build == build

        while not all(map(handed, self._config.daemons)) and self._clock.now_ns() < end_ns:
            self._polled()

    def _enter(self, phase: str) -> None:
        if phase != self._phase:
            self._phase, self._console.note = phase, ""

    def _outcome(self, state: RunState) -> Outcome:
        cause = state_words(state, self._load_behind(state), self._robots).advice
        if state.phase == Phase.ESTOP:
            self._listen()  # it may be our own operator's
            raise EmergencyError(cause)
        if self._stopped_at_gates():  # past the supervisor, which names something else first
            raise EmergencyError(f"at the gates; {cause}")
        if state.cause == Event.ARMED_TOO_LONG:
            cause = f"{cause}: {missing(self.recording)}"
        return ("stopped" if state.phase == Phase.IDLE else "fault"), f"{cause}{self._refused()}"

    def _refused(self) -> str:
        """Return what robots' own computers said instead of taking this run's configuration."""
        if not self._config.daemons:
            return ""
        answers: list[str] = []
        with suppress(OSError):
            answers = (self._folder / "log" / "supervisor.log").read_text(errors="replace").splitlines()
        lines = [line for line in answers if line.partition(": ")[0] in self._config.daemons and ": refused: " in line]
        return "".join(f"; {line}" for line in dict.fromkeys(lines))

    def _held(self) -> str:
        """Return why the fleet stands on hold; an empty string where it does not."""
        state = self.recording.newest(STATE)
        held = state is not None and state.phase == Phase.HOLD
        words = state_words(state, self.recording.newest(BUSY), self._robots) if held else None
        return f"; the fleet was on hold: {words.cause}" if words else ""

    def _load_behind(self, state: RunState) -> BusyMachine | None:
        """Return what is known of the machine's load; where that may explain how the run ended, it may come late."""
        deadline_ns = self._clock.now_ns() + _LOAD_WITHIN_NS
        while True:
            busy: BusyMachine | None = self.recording.newest(BUSY)
            explained = busy is None or state.cause not in SPOILT or busy.cause == state.cause
            if explained or self._clock.now_ns() > deadline_ns:
                return busy
            self._polled()

    def _ended(self, outcome: str, cause: str | None) -> Outcome:
        """Ask for the controlled stop and wait until every wheel is at rest; then it is over."""
        self._phase, self._ending = "stopping", True
        self._tell_end(outcome, cause)
        try:
            asked(self._bus, self._clock, "supervisor", b"stop", self._listen)
            self._rest()
        except TimeoutError:  # then nobody renews the permissions, and the gates close
            pass
        return outcome, cause

    def _emergency(self, why: str) -> Outcome:
        """Latch every gate; name each robot that does not confirm it, and cut its lifeline."""
        self._phase = _EMERGENCY
        self._watch(self.recording, self._phase)
        stopped = self._console.emergency_stop(self._bus, self._clock, self._config.units)
        if not stopped.silent:
            with suppress(RunError):  # whoever is silent or gone: every gate is latched
                self._rest()
        by = "" if why == CAUSES[Event.ESTOP_REQUESTED] else f" ({why})"
        return "stopped", f"emergency stop{by}; {stopped.describe()}"

    def _rest(self) -> None:
        deadline_ns = self._clock.now_ns() + _REST_WITHIN_NS
        while self._clock.now_ns() < deadline_ns and not self._at_rest():
            self._polled()

    def _ask(self, what: bytes) -> None:
        try:
            answer = asked(self._bus, self._clock, "supervisor", what, self._polled, within_ns=_ANSWER_WITHIN_NS)
        except TimeoutError as error:
            raise RunError(str(error)) from error
        if not answer.startswith(b"ok"):
            why = answer.decode(errors="replace").removeprefix("refused: ")
            way_out = (
                ": the same command with --reset does it" if what == b"start" and why.endswith("then reset") else ""
            )
            raise RunError(f"{what.decode()} was refused: {why}{way_out}")

    def _polled(self) -> RunState | None:
        """Take what came, do what the operator asks, show it; returns the run's newest state."""
        keys = self._console.keys(self._clock, self._clock.now_ns() + _POLL_NS)
        if self._phase != _EMERGENCY:
            self._obey(keys)
            if self._phase != READY:  # a key's request must not overtake the reset of the command line
                self._ask_by_key(keys)
            self._heed()
            self._attend()
        heard_ns = 0
        for at_ns, full, payload in self._stream.drain():
            self.recording.add(full, payload)
            if full == self._state_key:
                heard_ns = at_ns
        if heard_ns:
            self._silence.heard(heard_ns)
        self.recording.keep_newest(SHOWN)
        self._faults.step()
        self._fleet.check(spare=self._trackers)
        for companion in self._companions:
            companion.look()
        self._hear_of_silence()
        self._watch(self.recording, self._phase)
        state: RunState | None = self.recording.newest(STATE)
        return state

    def _hear_of_silence(self) -> None:
        """Raise that the supervisor is silent; a simulated run waits longer where the machine's load explains it."""
        now_ns = self._clock.now_ns()
        if (lasts_ns := self._silence.lasts_ns(now_ns)) <= _SILENT_NS:
            return
        load = self._silence.load(now_ns)
        if load and self._config.simulated and lasts_ns <= GONE_NS:
            return
        why = f" (this machine was busy: {load})" if load else ""
        silent = f"the supervisor went silent{why}: see {self._folder}/log/supervisor.log"
        raise EmergencyError(f"at the gates; {silent}") if self._stopped_at_gates() else RunError(silent)

    def _heed(self) -> None:
        counted, attended = self._interrupts, self._config.run.attended
        if attended and (counted.hung_up or self._console.lost):
            raise EmergencyError("the operator's terminal is gone")
        if counted.count >= _TWICE:
            raise EmergencyError("interrupted twice")
        if counted.count and not self._ending:
            raise InterruptedRunError("the operator interrupted")

    def _obey(self, keys: str) -> None:
        if EMERGENCY_KEYS.intersection(keys):
            raise EmergencyError("by key")
        if "q" in keys and not self._ending:
            raise InterruptedRunError("the operator ended it")

    def _listen(self) -> None:
        """Raise what signals and keys ask for, where the run waits for something else; show what there is to show."""
        self._heed()
        self._obey(self._console.keys(self._clock, self._clock.now_ns()))
        self._watch(self.recording, self._phase)

    def _stop_now(self) -> None:
        """Stop every robot, from the thread that hears the keys: the run's own one hears of it when it can."""
        with suppress(Exception):  # the bus is being left
            self._console.emergency_stop(self._bus, self._clock, self._config.units)

    def _ask_by_key(self, keys: str) -> None:
        for pressed in keys:
            if pressed in _REQUESTS_BY_KEY:
                payload = _REQUESTS_BY_KEY[pressed]
                self._answer = self._bus.ask(on(payload), "supervisor", payload)
        if self._answer is not None and (answer := self._answer.take()) is not None:
            self._console.note, self._answer = answer.decode(errors="replace"), None

    def _attend(self) -> None:
        """Tell the supervisor that the operator is there: the dead man's handle."""
        now_ns = self._clock.now_ns()
        if self._config.run.attended and self._console.present and now_ns - self._attended_ns >= _ATTENDED_NS:
            self._attended_ns = now_ns
            self._bus.ask(REQUEST, "supervisor", b"attended")

    def _stopped_at_gates(self) -> bool:
        statuses = [self.recording.newest_status(robot) for robot in self._robots]
        return any(status is not None and status.latch == Latch.EMERGENCY_STOP for status in statuses)

    def _at_rest(self) -> bool:
        statuses = [self.recording.newest_status(robot) for robot in self._robots]
        return all(
            status is not None and max(abs(status.left_rad_s), abs(status.right_rad_s)) < _AT_REST_RAD_S
            for status in statuses
        )


class ChildFaults:
    """Applies the configuration's timed faults to the children. Times count from ``begin``."""

    def __init__(self, config: Config, clock: Clock, children: Children) -> None:
        self._clock, self._children = clock, children
        self._schedule = Schedule(config, clock)
        self._acting: set[int] = set()  # by number

    def begin(self) -> None:
        """Note that the fleet is running; only the first time counts."""
        self._schedule.begin(self._clock.now_ns())

    def step(self) -> None:
        now_ns = self._clock.now_ns()
        for injection in self._schedule.of("killed", "stopped"):
            acts = injection.acts(now_ns)
            if acts == (injection.number in self._acting):
                continue
            self._acting ^= {injection.number}
            name = injection.fault.process
            if injection.fault.kind == "stopped":
                self._children.signal(name, signal.SIGSTOP if acts else signal.SIGCONT)
            elif acts:
                self._children.kill(name)
            else:
                self._children.start_again(name)
