"""Runs a platoon in real time: starts the processes, arms, runs, stops, and leaves nothing behind."""

import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robofleet.clock import Clock, S, WallClock
from robofleet.comms.keys import STATE, STATUS, TICK, everything, key
from robofleet.comms.messages import ROBOT_STATUS, RUN_STATE, TICK_RECORD
from robofleet.comms.requests import asked
from robofleet.comms.zenoh_bus import ZenohBus
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.processes import controller, tracker
from robofleet.processes.readiness import missing
from robofleet.recording.run import Recording, Watch
from robofleet.safety.supervisor import Event, Phase, RunStatus

_READY_WITHIN_S = 30.0
_ARMED_WITHIN_S = 5.0
_REST_WITHIN_S = 1.0
_EXIT_WITHIN_S = 1.2
_POLL_S = 0.05
_STREAM = 65536  # messages; a minute of a fleet of four
_AT_REST_RAD_S = 0.01
_LAST_LINES = 5
_CHILD_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}


class RunError(Exception):
    """The run ended by a fault; the message is its cause."""


class InterruptedRunError(Exception):
    """The operator asked for the end; ``at_once`` when asked twice."""


@dataclass
class Child:
    """One process, and this end of its lifeline."""

    name: str
    process: "subprocess.Popen[bytes]"
    lifeline: socket.socket
    log: Path
    ready: bool = False

    def last_lines(self) -> str:
        """Return the end of what it wrote."""
        lines = self.log.read_text(errors="replace").strip().splitlines()[-_LAST_LINES:]
        return "".join(f"\n    {line}" for line in lines)


@dataclass
class Fleet:
    """The processes of a run, in the order of their start."""

    folder: Path
    config_file: Path
    children: list[Child] = field(default_factory=list)

    def start(self, name: str, *arguments: str) -> None:
        """Start ``robofleet NAME CONFIG ...`` as a new interpreter."""
        ours, theirs = socket.socketpair()
        log = self.folder / f"{name}.log"
        with theirs, log.open("wb") as output:
            command = [sys.executable, "-m", "robofleet", arguments[0], str(self.config_file), *arguments[1:]]
            process = subprocess.Popen(
                [*command, "--lifeline", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                env=os.environ | _CHILD_ENVIRONMENT,
            )
        self.children.append(Child(name, process, ours, log))

    def wait_ready(self, clock: Clock, interrupts: "_Interrupts") -> None:
        """Return when every child has said that it is ready."""
        deadline_ns = clock.now_ns() + round(_READY_WITHIN_S * S)
        while waiting := [child for child in self.children if not child.ready]:
            self.check()
            if interrupts.count:
                raise InterruptedRunError
            if clock.now_ns() > deadline_ns:
                names = ", ".join(child.name for child in waiting)
                raise RunError(f"{names}: not ready after {_READY_WITHIN_S:.0f} s")
            readable, _, _ = select.select([child.lifeline for child in waiting], [], [], _POLL_S)
            for child in waiting:
                if child.lifeline in readable and child.lifeline.recv(64):
                    child.ready = True

    def check(self) -> None:
        """Raise RunError with its name and last lines if a child has died."""
        for child in self.children:
            code = child.process.poll()
            if code is not None:
                how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
                raise RunError(f"the {child.name} was {how}{child.last_lines()}")

    def reap(self, clock: Clock) -> None:
        """End every child: the router last, so that the others can take their leave; kill what does not answer."""
        others, routers = self.children[1:], self.children[:1]
        for group in (others, routers):
            for child in group:
                child.lifeline.close()
            deadline_ns = clock.now_ns() + round(_EXIT_WITHIN_S * S)
            for child in group:
                try:
                    child.process.wait(max(0.0, (deadline_ns - clock.now_ns()) / S))
                except subprocess.TimeoutExpired:
                    child.process.kill()
                    child.process.wait()
        self.children.clear()


class _Interrupts:
    """Ctrl-C, SIGTERM, a closed terminal and Ctrl-Z (a stopped launcher would leave the robots driving), counted."""

    count = 0

    def __call__(self, _number: int, _frame: object) -> None:
        self.count += 1


@contextmanager
def _interrupts() -> Iterator[_Interrupts]:
    interrupts = _Interrupts()
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
    before = {number: signal.signal(number, interrupts) for number in signals}
    try:
        yield interrupts
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Launcher:
    """One run in real time. ``run`` returns (outcome, cause); the messages are in ``recording``."""

    def __init__(self, config: Config, folder: Path, watch: Watch) -> None:
        self._config, self._folder, self._watch = config, folder, watch
        self._clock = WallClock()
        self.recording = Recording(config)
        arena = config.arena.name
        self._state_key, self._tick_key = key(arena, STATE), key(arena, TICK)
        self._status_keys = [key(arena, STATUS, robot.id) for robot in config.platoon]
        self._phase = "starting"

    def run(self) -> tuple[str, str | None]:
        """Start everything, run for the configured time, stop, reap."""
        config_file = self._folder / "config.yaml"
        config_file.write_text(resolved_yaml(self._config))
        logs = self._folder / "log"
        logs.mkdir()
        fleet = Fleet(logs, config_file)
        with _interrupts() as interrupts:
            try:
                self._start(fleet, interrupts)
                return self._drive(fleet, interrupts)
            except RunError as error:
                return "fault", str(error)
            except InterruptedRunError:
                return "stopped", "the operator interrupted"
            finally:
                fleet.reap(self._clock)

    def _start(self, fleet: Fleet, interrupts: _Interrupts) -> None:
        self._watch(self.recording, "compiling")
        controller.compile_kernels(self._config)
        tracker.compile_kernels(self._config)
        self._watch(self.recording, "starting")
        fleet.start("router", "router")
        fleet.wait_ready(self._clock, interrupts)
        for name in ("supervisor", "tracker", "controller"):
            fleet.start(name, name)
        for robot in self._config.robots:
            fleet.start(f"driver-{robot.id}", "driver", "--robots", robot.id)
        fleet.wait_ready(self._clock, interrupts)

    def _drive(self, fleet: Fleet, interrupts: _Interrupts) -> tuple[str, str | None]:
        bus = ZenohBus(self._config.arena.name, self._config.bus.endpoint, "launcher", self._clock)
        try:
            self._stream = bus.stream(everything(self._config.arena.name), _STREAM)
            self._phase = "arming"
            try:
                asked(bus, self._clock, "supervisor", b"start")
            except TimeoutError as error:
                raise RunError(str(error)) from error
            self._arm(fleet, interrupts)
            started_ns = self._clock.now_ns()
            outcome, cause = self._lap(fleet, interrupts)
            self.recording.elapsed_s = (self._clock.now_ns() - started_ns) / S
            self._phase = "stopping"
            if interrupts.count < 2:  # asked twice: the lifelines are cut at once, and every driver stops its wheels
                self._stop(bus, fleet)
            return outcome, cause
        finally:
            bus.close()

    def _arm(self, fleet: Fleet, interrupts: _Interrupts) -> None:
        deadline_ns = self._clock.now_ns() + round(_ARMED_WITHIN_S * S)
        while (state := self._newest(self._state_key, RUN_STATE)) is None or state.phase != Phase.RUNNING:
            self._poll(fleet)
            if interrupts.count:
                raise InterruptedRunError
            if self._clock.now_ns() > deadline_ns:
                raise RunError(f"the fleet was not ready after {_ARMED_WITHIN_S:.0f} s: {missing(self.recording)}")

    def _lap(self, fleet: Fleet, interrupts: _Interrupts) -> tuple[str, str | None]:
        """Watch the run until its time is over, the operator interrupts, or the supervisor stops it."""
        last_tick = round(self._config.run.duration_s / self._config.controller.tick_s)
        self._phase = "running"
        while True:
            self._poll(fleet)
            if interrupts.count:
                return "stopped", "the operator interrupted"
            state = self._newest(self._state_key, RUN_STATE)
            if state.phase != Phase.RUNNING:
                status = RunStatus(Phase(state.phase), Event(state.cause), state.robot, state.detail)
                outcome = "fault" if status.phase is Phase.FAULT else "stopped"
                return outcome, status.describe(self._config.groups[0].robots)
            tick = self._newest(self._tick_key, TICK_RECORD)
            if tick is not None and tick.run_tick >= last_tick:
                return "completed", None

    def _stop(self, bus: ZenohBus, fleet: Fleet) -> None:
        """Ask for the stop and wait until every wheel is at rest."""
        try:
            asked(bus, self._clock, "supervisor", b"stop")
        except TimeoutError:
            return
        deadline_ns = self._clock.now_ns() + round(_REST_WITHIN_S * S)
        while self._clock.now_ns() < deadline_ns and not self._at_rest():
            self._poll(fleet)

    def _poll(self, fleet: Fleet) -> None:
        self._clock.sleep_until(self._clock.now_ns() + round(_POLL_S * S))
        for full, payload in self._stream.drain():
            self.recording.add(full, payload)
        fleet.check()
        self._watch(self.recording, self._phase)

    def _newest(self, full: str, layout: Any) -> Any:
        messages = self.recording.messages.get(full)
        return layout.decode(messages[-1]) if messages else None

    def _at_rest(self) -> bool:
        statuses = [self._newest(full, ROBOT_STATUS) for full in self._status_keys]
        return all(
            status is not None and max(abs(status.left_rad_s), abs(status.right_rad_s)) < _AT_REST_RAD_S
            for status in statuses
        )
