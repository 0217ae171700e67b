"""The processes of a run without a launcher: nobody ends them when one dies."""

from pathlib import Path

from robofleet.clock import Clock
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.processes import controller, tracker
from robofleet.processes.children import Children


def started(config: Config, folder: Path, clock: Clock) -> Children:
    """Start them all but the recorder, and wait until each does its work; whoever asked for them reaps them."""
    file = folder / "config.yaml"
    file.write_text(resolved_yaml(config))
    controller.compile_kernels(config)
    tracker.compile_kernels(config)
    fleet = Children(folder, file)
    try:
        for name in ("router", *(["twins"] if config.twins else [])):
            fleet.start(name, name)
        wait_ready(fleet, clock)
        for name in ("supervisor", "tracker", "controller"):
            fleet.start(name, name)
        for name, robots in config.driven.items():
            fleet.start(name, "driver", "--robots", ",".join(robots))
        wait_ready(fleet, clock)
    except BaseException:
        fleet.reap(clock)
        raise
    return fleet


def wait_ready(fleet: Children, clock: Clock) -> None:
    """Wait until every process does its work."""
    fleet.wait_ready(clock, lambda: None)
