"""The processes of a run without a launcher: nobody ends them when one dies."""

from pathlib import Path

from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import Clock
from robofleet.runs import table
from robofleet.runs.children import Children


def started(config: Config, folder: Path, clock: Clock) -> Children:
    """Start them all but the recorder, and wait until each does its work; whoever asked for them reaps them."""
    file = folder / "config.yaml"
    file.write_text(resolved_yaml(config))
    fleet = Children(folder, file)
    try:
        start_all(config, fleet, clock)
    except BaseException:
        fleet.reap(clock)
        raise
    return fleet


def start_all(config: Config, fleet: Children, clock: Clock) -> None:
    """Start them, and wait until each does its work."""
    for first in (True, False):
        for process in table.processes(config):
            if process.row.first is first and process.row is not table.RECORDER:
                fleet.start(process.name, *process.command)
        wait_ready(fleet, clock)


def wait_ready(fleet: Children, clock: Clock) -> None:
    """Wait until every process does its work."""
    fleet.wait_ready(clock, lambda: None)
