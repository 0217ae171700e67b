"""A run as the operator sees it: the live view, the terminal's keys, and the summary in the end."""

import threading
from collections.abc import Mapping
from contextlib import closing
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from robofleet.config.tree import Config
from robofleet.core.clock import WallClock, utc_now
from robofleet.core.refusal import RefusedError
from robofleet.core.starting import Starting
from robofleet.operator.ending import Result, columns_of, result_of
from robofleet.operator.terminal.live import LiveView
from robofleet.operator.terminal.terminal import Terminal, hangup_interrupts
from robofleet.recording.beside import LogBeside
from robofleet.recording.log import FILE
from robofleet.recording.run import SHOWN, Recording, Run, Watch
from robofleet.runs.companion import PageWanted
from robofleet.runs.launcher import Launcher
from robofleet.vehicles.interface import DriverError

if TYPE_CHECKING:
    from robofleet.runs.lockstep import Lockstep


def in_lockstep(config: Config, name: str, folder: Path, *, quiet: bool) -> Result:
    from robofleet.runs.lockstep import Lockstep  # noqa: PLC0415 - it loads all that its processes need

    began = _now()
    terminal = Terminal()
    view_of = LiveView(config, WallClock(), terminal, quiet=quiet)
    with hangup_interrupts(), view_of as view, closing(LogBeside(folder / FILE, config)) as log:

        def show(starting: Starting) -> None:
            terminal.starting = starting
            view(nothing, "starting")

        nothing = Recording(config)
        try:
            run = Lockstep(config, log=log, starting=show)
            terminal.starting = None
        except DriverError as error:
            raise RefusedError(str(error)) from error

        def watch(recording: Recording, phase: str) -> None:
            view(recording, phase)
            recording.keep_newest(SHOWN)  # all of it is in the file

        outcome, cause = driven(run, watch)
        log.end(run.recording.ending())
    columns = columns_of(config, folder)
    columns.recording.dropped = log.dropped
    return result_of(columns, name=name, mode="lockstep", outcome=outcome, cause=cause, began=began)


def driven(run: "Lockstep", watch: Watch) -> tuple[str, str | None]:
    """Run to the end and return (outcome, cause): a driver that fails is a fault of the run."""
    try:
        outcome, cause = run.run(watch)
    except* DriverError as raised:  # of a step, or of closing afterwards
        outcome, cause = "fault", _first(raised)
        run.recording.outcome, run.recording.cause = outcome, cause
    return outcome, cause


def _now() -> str:
    """Return the date, UTC, for the summary: no message and no file of a run in lockstep depends on it."""
    return f"{utc_now():%Y-%m-%dT%H:%M:%SZ}"


def _first(raised: BaseException) -> str:
    while isinstance(raised, BaseExceptionGroup):
        raised = raised.exceptions[0]
    return str(raised)


def in_real_time(
    config: Config, name: str, folder: Path, *, quiet: bool, reset: bool, take_over: bool, web: PageWanted | None,
    viewers: Mapping[str, str] | None = None,
) -> Result:  # fmt: skip
    began = _now()
    with Terminal() as terminal, LiveView(config, WallClock(), terminal, quiet=quiet) as view:
        run = Launcher(
            config, folder, view, terminal, reset=reset, take_over=take_over, web=web, viewers=viewers
        )  # fmt: skip
        threading.Thread(target=import_module, args=("robofleet.reports.after",), daemon=True).start()  # takes a second
        outcome, cause = run.run()
        view(run.recording, "summary")
        columns = columns_of(config, folder) if run.began or outcome != "stopped" else Run(Recording(config))
        columns.recording.elapsed_s = run.recording.elapsed_s
        result = result_of(columns, name=name, mode="realtime", outcome=outcome, cause=cause, began=began)
        view(run.recording, outcome)
    return result
