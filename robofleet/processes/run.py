"""A run as the operator sees it: the live view, the terminal's keys, and the summary in the end."""

from pathlib import Path
from typing import Any

from robofleet.clock import WallClock
from robofleet.config.tree import Config
from robofleet.processes.launcher import Launcher
from robofleet.processes.live import LiveView
from robofleet.processes.lockstep import Lockstep
from robofleet.processes.terminal import Terminal
from robofleet.recording.metrics import summary


def in_lockstep(config: Config, name: str, *, quiet: bool) -> dict[str, Any]:
    """Run on a simulated clock and return the summary."""
    with LiveView(config, WallClock(), Terminal(), quiet=quiet) as view:
        run = Lockstep(config)
        outcome, cause = run.run(view)
    return summary(run.recording, name=name, mode="lockstep", outcome=outcome, cause=cause)


def in_real_time(
    config: Config, name: str, folder: Path, *, quiet: bool, reset: bool, take_over: bool, web: bool
) -> dict[str, Any]:
    """Run with real processes and return the summary."""
    with Terminal() as terminal, LiveView(config, WallClock(), terminal, quiet=quiet) as view:
        run = Launcher(config, folder, view, terminal, reset=reset, take_over=take_over, web=web)
        outcome, cause = run.run()
    return summary(run.recording, name=name, mode="realtime", outcome=outcome, cause=cause)
