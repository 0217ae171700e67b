"""A script's run in lockstep, in the script's own process: the simulated clock waits for the script."""

import gc
import threading
from pathlib import Path
from typing import Any

from robofleet.bus.keys import NOTE, TICK, WISH, Topic, key
from robofleet.config.tree import Config
from robofleet.core.clock import S, stopwatch_ns, utc_now
from robofleet.operator.ending import Ending, columns_of, result_of
from robofleet.operator.terminal.start_view import StartView
from robofleet.recording.beside import LogBeside
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.run import SHOWN, Run
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.readiness import why
from robofleet.safety.supervisor import Phase, RunStatus
from robofleet.scripts.script_link import ended, held, refuse

_ANSWER_S = 1.0
_ARMED_S = 600.0  # the supervisor's own patience is shorter
_TICK_WITHIN_S = 1.0
_REST_S = 1.0  # after the stop: wheels come to rest


class LockstepLink:
    """A run that goes on while its script waits for a tick, and at no other time."""

    ends = True

    def __init__(self, config: Config, group: str, name: str, folder: Path | None) -> None:
        """Put the run together; ``name``: the configuration's, for the summary."""
        self.config, self.folder, self._name = config, folder, name
        self._began, self._began_ns = f"{utc_now():%Y-%m-%dT%H:%M:%SZ}", stopwatch_ns()
        self._log = None if folder is None else _log(folder / FILE, config)
        try:
            with StartView() as view:
                self.run = Lockstep(config, log=self._log, starting=view)
        except BaseException:
            if self._log is not None:
                self._log.end(b"")
            raise
        self.wish = self.run.bus.publisher(WISH, group)
        self.note = self.run.bus.publisher(NOTE, group)
        self._messages = self.run.recording.messages
        self._ticks = self._messages[key(config.arena.name, TICK)]
        self._left = False

    def begin(self) -> None:
        """Arm and start; FleetError where the checks fail."""
        run = self.run
        gc.freeze()  # what was loaded so far is not looked at again
        try:
            run.request(b"start")
            run.advance(_ANSWER_S, lambda: run.status.phase is not Phase.IDLE)
            run.advance(_ARMED_S, lambda: run.status.phase is not Phase.ARMED)
            while run.status.phase is Phase.POSITIONING:
                run.advance(_ANSWER_S, lambda: run.status.phase is not Phase.POSITIONING)
            if run.status.phase is not Phase.RUNNING:
                error = ended(run.status, self.config)
                error.args = (f"the run did not begin: {why(run.recording, run.status)}",)
                raise error
        except BaseException as error:
            self.end("fault", str(error))
            raise

    @property
    def status(self) -> RunStatus:
        return self.run.status

    @property
    def tick(self) -> bytes:
        return self._ticks[-1]

    def next_tick(self) -> bytes:
        """Let simulated time pass until the next tick."""
        if self.folder is not None:
            self.run.recording.keep_newest(SHOWN)  # all of it is in the file
        ticks, count, run = self._ticks, len(self._ticks), self.run
        phase = run.status.phase
        if phase is Phase.HOLD:
            raise held(run.status, self.config)  # nobody else could resume it
        if phase is not Phase.RUNNING or not run.advance(_TICK_WITHIN_S, lambda: len(ticks) > count):
            raise ended(run.status, self.config)
        return ticks[-1]

    def newest(self, topic: Topic, unit: str) -> bytes | None:
        payloads = self._messages.get(key(self.config.arena.name, topic, unit))
        return payloads[-1] if payloads else None

    def ask(self, what: bytes) -> None:
        """Ask the supervisor, and let the time pass in which it answers and the controller hears of it."""
        answer, reply = self.run.request(what), b""

        def answered() -> bool:
            nonlocal reply
            reply = answer.take() or reply
            return bool(reply)

        self.run.advance(_ANSWER_S, answered)
        if not reply.startswith(b"ok"):
            refuse(reply.decode() or "the supervisor does not answer", what)
        self.run.advance(2 * self.config.controller.tick_s)

    def done(self, parting: bytes) -> dict[str, Any]:
        run = self.run
        if run.status.phase is Phase.RUNNING:
            self.wish(parting)
            run.advance(_ANSWER_S, lambda: run.status.phase is not Phase.RUNNING)
        phase = run.status.phase
        if phase in (Phase.RUNNING, Phase.IDLE):  # other groups may have more to do
            return self.end("completed", None)
        return self.end("stopped" if phase is Phase.HOLD else "fault", run.status.describe(self.config.ids))

    def failed(self, parting: bytes, why: str) -> dict[str, Any]:
        phase = self.run.status.phase
        self.wish(parting)
        return self.end("fault" if phase in (Phase.FAULT, Phase.ESTOP) else "stopped", why)

    def end(self, outcome: str, cause: str | None) -> dict[str, Any]:
        """End the run as it has come out; returns the summary, which is written where the run is kept."""
        run, recording = self.run, self.run.recording
        try:
            run.request(b"stop")
            run.advance(_REST_S)
        finally:
            run.close()
            gc.unfreeze()
            recording.outcome, recording.cause = outcome, cause
            recording.elapsed_s = (stopwatch_ns() - self._began_ns) / S
            self._close_log(recording.ending())
        columns = Run(recording) if self.folder is None else columns_of(self.config, self.folder)
        columns.recording.dropped = recording.dropped
        how = {"mode": "lockstep", "outcome": outcome, "cause": cause, "began": self._began}
        result = result_of(columns, name=self._name, **how)
        if self.folder is not None:
            ending = Ending(self.config, self.folder, result)
            ending.write_summary("it is in `fleet.summary` alone")
            ending.write_report()
        return result.summary

    def _close_log(self, ending: bytes) -> None:
        if self._log is not None:
            self._log.end(ending)
            self.run.recording.dropped = self._log.dropped


def _log(file: Path, config: Config) -> RunLog | LogBeside:
    """Return what writes the run's file: a fork, which takes no time of the run, unless the script has threads.

    OSError where the file cannot be written.
    """
    if threading.active_count() > 1:  # a notebook's: a fork of those is none that works
        return RunLog(file, config, batched=True)
    return LogBeside(file, config)
