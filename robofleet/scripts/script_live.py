"""A script's run in real time: the script is one more client of the run's bus."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from robofleet.behaviours import described
from robofleet.bus.arena_file import ArenaFile, running
from robofleet.bus.credentials import Credentials
from robofleet.bus.joining import joined
from robofleet.bus.keys import NOTE, SENSORS, STATE, STATUS, TICK, WISH, Topic
from robofleet.bus.messages import RUN_STATE, TICK_RECORD
from robofleet.bus.observer import Observer, Source
from robofleet.bus.permissions import SCRIPT
from robofleet.config import groups
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.operator.asking import ask_supervisor
from robofleet.reports.after import SUMMARY
from robofleet.runs.children import ended_by
from robofleet.safety.supervisor import Phase, RunStatus
from robofleet.scripts import script_own
from robofleet.scripts.script_link import FleetError, ended, held, refuse

_JOINED_WITHIN_S = 3.0
_POLL_S = 0.02
_MESSAGE_WITHIN_S = 5.0  # of a run that is there: a tick, the supervisor's state
_READY_WITHIN_S = 300.0  # of all processes of a run that begins: they may compile kernels
_OVER_WITHIN_S = 5.0  # after the script's last setpoints
_ENDED_WITHIN_S = 120.0  # of a launcher: on a busy machine it writes the report for long
_GOODBYE_S = 0.1  # for which a script says good-bye: one word may be lost on a radio
_PARTING_WITHIN_S = 0.3  # of the parting setpoints
_OVER = Phase.IDLE, Phase.FAULT, Phase.ESTOP


class LiveLink:
    """A run that is on: an arena's, which stays when the script leaves."""

    folder: Path | None = None
    ends = False

    def __init__(
        self, config: Config, group: str, endpoint: str | Sequence[str], credentials: Credentials | None = None,
        within_s: float = _JOINED_WITHIN_S,
    ) -> None:  # fmt: skip
        """Join; FleetError where nobody answers, or where the run has other robots than the configuration."""
        self.config, self._clock = config, WallClock()
        self._came = threading.Condition()
        self._taken_ns = 0  # arrival of the tick that ``next_tick`` returned last
        try:
            self._bus = joined(config.arena.name, endpoint, SCRIPT, self._clock, within_s, self._check, credentials)
        except TimeoutError as error:
            raise FleetError(f"the run of {config.arena.name}: {error}") from error
        try:
            self._ticks = Observer(self._bus, wake=self._wake)
            self._ticks.declare([TICK], self._own_tick)
            self._observer = Observer(self._bus)  # its messages need not wake anybody
            self._observer.declare([STATE], _status)
            units = [(STATUS, unit) for unit in config.units] + [(SENSORS, unit) for unit in config.sensing]
            self._observer.declare(units, bytes)
            self._publish = self._bus.publisher(WISH, group)
            self.wish = self._publish
            self.note = self._bus.publisher(NOTE, group)
            if not self._until(lambda: self._has_new_tick() and self._newest(STATE) is not None, within_s):
                raise FleetError(f"the run of {config.arena.name} says nothing: see its logs")
            wanted = TICK_RECORD.dtype(
                len(config.members), described.size(groups.descriptions(config), len(config.camera_names))
            )
            if len(self.tick) != wanted.itemsize:
                raise FleetError(f"the run of {config.arena.name} has other robots than this configuration")
        except BaseException:
            self._bus.close()
            raise

    def begin(self) -> None:
        while self.status.phase is not Phase.RUNNING:
            self._check()
            if self.status.phase in (Phase.FAULT, Phase.ESTOP):
                raise ended(self.status, self.config)
            if self.status.phase is Phase.HOLD:
                raise held(self.status, self.config)
            self._pause()

    @property
    def status(self) -> RunStatus:
        return self._newest(STATE) or RunStatus()

    @property
    def tick(self) -> bytes:
        self._has_new_tick()
        return bytes(self._ticks[TICK])

    def next_tick(self) -> bytes:
        """Wait for a tick that was not returned yet; of several the newest."""
        with self._came:
            came = self._came.wait_for(self._has_new_tick, _MESSAGE_WITHIN_S)
        self._check()
        tick, self._taken_ns = self.tick, self._ticks.arrival_ns(TICK)
        if not came or (TICK_RECORD.head_of(tick, "run_tick") < 0 and self.status.phase in _OVER):
            raise ended(self.status, self.config)
        return tick

    def newest(self, topic: Topic, unit: str) -> bytes | None:
        payload: bytes | None = self._newest((topic, unit))
        return payload

    def ask(self, what: bytes) -> None:
        try:
            done, answer = ask_supervisor(self._bus, self._clock, what.decode(), SCRIPT)
        except TimeoutError as error:
            raise FleetError(f"{what.decode()}: {error}") from error
        if not done:
            refuse(answer, what)

    def done(self, parting: bytes) -> dict[str, Any] | None:
        """Leave; the robots stand, and the run goes on."""
        self._part(parting, lambda: False, _GOODBYE_S)
        self._bus.close()
        return None

    def failed(self, parting: bytes, why: str) -> dict[str, Any] | None:
        """Leave; the run is held."""
        self._part(parting, lambda: self.status.phase is not Phase.RUNNING)
        self._bus.close()
        return None

    def _part(self, parting: bytes, answered: Callable[[], bool], within_s: float = _PARTING_WITHIN_S) -> bool:
        """Repeat the parting setpoints until they take effect; return whether they did."""
        end_ns = self._clock.now_ns() + round(within_s * S)
        while not answered() and self._clock.now_ns() < end_ns:
            self._publish(parting)
            self._pause()
        return answered()

    def _check(self) -> None:
        """Raise where the run is gone."""

    def _until(self, true: Callable[[], bool], within_s: float) -> bool:
        end_ns = self._clock.now_ns() + round(within_s * S)
        while not true() and self._clock.now_ns() < end_ns:
            self._check()
            self._pause()
        return true()

    def _pause(self) -> None:
        self._clock.sleep_until(self._clock.now_ns() + round(_POLL_S * S))

    def _newest(self, source: Source) -> Any:
        self._observer.update(self._clock.now_ns(), [source])
        return self._observer[source]

    def _has_new_tick(self) -> bool:
        self._ticks.update(self._clock.now_ns())
        return self._ticks.arrival_ns(TICK) != self._taken_ns

    def _own_tick(self, payload: bytes) -> bytes | None:
        """Return a tick that is as large as the first one."""
        known = self._ticks[TICK] or payload
        return payload if TICK_RECORD.view(payload) is not None and len(payload) == len(known) else None

    def _wake(self, _at_ns: int) -> None:
        with self._came:
            self._came.notify_all()


def _status(payload: bytes) -> RunStatus | None:
    state = RUN_STATE.decode_head(payload)
    return None if state is None else RunStatus.read(state.phase, state.cause, state.robot, state.detail)


class OwnRun:
    """``robofleet run`` in a process of its own, without a terminal."""

    def __init__(self, config: Config, name: str, folder: Path | None) -> None:
        """Start it; without ``folder`` it leaves nothing."""
        self._kept = tempfile.TemporaryDirectory(prefix="robofleet-")
        directory = Path(self._kept.name)
        self.folder = directory / "run" if folder is None else folder
        file = directory / f"{name}.yaml"
        file.write_text(resolved_yaml(config))
        self._stderr = (directory / "stderr").open("wb")
        self._passed_on = 0  # lines of it
        theirs, self._lifeline = os.pipe()
        command = [sys.executable, "-P", "-m", script_own.__name__, str(theirs), "run", str(file), "--quiet"]
        self._process = subprocess.Popen(
            [*command, "--out", str(self.folder.absolute())], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=self._stderr, start_new_session=True, pass_fds=[theirs],
        )  # fmt: skip
        os.close(theirs)

    def check(self) -> None:
        """Raise FleetError with what it said last, where it has ended; pass on how far its start is."""
        over, lines = self.over, Path(self._stderr.name).read_text(errors="replace").splitlines(keepends=True)
        for line in lines[self._passed_on :]:
            if line.endswith("\n"):
                self._passed_on += 1
                if line.startswith("starting "):
                    print(line, end="", file=sys.stderr, flush=True)
        if over:
            lines = [line.strip() for line in lines[-5:]]
            code = self._process.returncode
            raise FleetError("\n".join(lines if lines and code >= 0 else [*lines, f"the run {ended_by(code)}"]))

    def joinable(self, arena: str) -> ArenaFile:
        """Wait until its processes can be reached, and return where; FleetError where it ends before."""
        while True:
            self.check()
            mine = [run for run in running() if run.own and (run.arena, run.pid) == (arena, self._process.pid)]
            if mine and (self.folder / "config.yaml").is_file():
                return mine[0]
            threading.Event().wait(_POLL_S)

    @property
    def over(self) -> bool:
        return self._process.poll() is not None

    def interrupt(self) -> None:
        """End it as Ctrl-C does: a controlled stop."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGINT)

    def summary(self) -> dict[str, Any] | None:
        """Wait for its end, and return what it measured; None where there is nothing."""
        try:
            self._process.wait(_ENDED_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()  # its processes end with it
            self._process.wait()
        file = self.folder / SUMMARY
        found = json.loads(file.read_text()) if file.is_file() else None
        os.close(self._lifeline)
        self._stderr.close()
        self._kept.cleanup()
        return found


class OwnRunLink(LiveLink):
    """A run of the script's own, which ends with the script."""

    ends = True

    def __init__(self, config: Config, group: str, name: str, folder: Path | None) -> None:
        """Start it, and join; FleetError where it does not come to it."""
        self._run = OwnRun(config, name, folder)
        try:
            run = self._run.joinable(config.arena.name)
            own = load_config(self._run.folder / "config.yaml")
            super().__init__(own, group, run.endpoint, within_s=_READY_WITHIN_S)
        except BaseException:
            self._run.interrupt()
            self._run.summary()
            raise
        self.folder = folder

    def _check(self) -> None:
        self._run.check()

    def begin(self) -> None:
        try:
            super().begin()
        except BaseException:
            self._end()
            raise

    def done(self, parting: bytes) -> dict[str, Any] | None:
        with suppress(FleetError):
            self._part(parting, lambda: self._run.over or self.status.phase in _OVER, _OVER_WITHIN_S)
        return self._end()

    def failed(self, parting: bytes, why: str) -> dict[str, Any] | None:
        """End the run: the robots stand at once."""
        self._part(parting, lambda: self._run.over or self.status.phase is not Phase.RUNNING)
        return self._end()

    def _end(self) -> dict[str, Any] | None:
        if self.status.phase not in _OVER:
            self._run.interrupt()
        summary = self._run.summary()
        self._bus.close()
        return summary
