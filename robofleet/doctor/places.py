"""Where a run writes and where its processes meet: room on the disk, the state folder, the bus's folder, the arena."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from robofleet.bus import arena_file
from robofleet.bus.endpoint import check_router, settled
from robofleet.bus.private_folder import PlaceError, private_folder
from robofleet.doctor.findings import Finding, Mark, ok
from robofleet.doctor.needs import Needs
from robofleet.nodes.unit.state_store import state_folder
from robofleet.runs.folder import RUNS
from robofleet.safety.monitor import LEAST_FREE_BYTES

_BYTES_A_MINUTE = 11_000_000  # of a recording with pictures


def disk(needs: Needs) -> Iterator[Finding]:
    """Room for the recording of this run, and whether its folder can be made here."""
    if not needs.whole_run:
        return
    runs = RUNS.absolute()
    folder = _nearest(runs)
    needed = LEAST_FREE_BYTES + round(needs.duration_s / 60 * _BYTES_A_MINUTE)
    free = shutil.disk_usage(folder).free
    says = f"{free / 1e9:.1f} GB are free in {folder}; a run of {needs.duration_s:.0f} s needs {needed / 1e9:.2f} GB"
    if not os.access(folder, os.W_OK | os.X_OK):
        cure = "start robofleet in a folder of yours, or name one with --out"
        yield Finding("disk", Mark.MISSING, f"{folder} cannot be written to", cure)
    elif free < needed:
        yield Finding("disk", Mark.MISSING, says, "make room, or record elsewhere with --out")
    else:
        yield ok("disk", says)


def state(_needs: Needs) -> Iterator[Finding]:
    """The folder in which drivers keep leases and latches."""
    folder = state_folder()
    nearest = _nearest(folder)
    if nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK):
        yield ok("state folder", f"{folder} can be written to")
    else:
        cure = f"make {nearest} a folder that you may write to, or name another one in XDG_STATE_HOME"
        yield Finding("state folder", Mark.MISSING, f"{folder}: {nearest} cannot be written to", cure)


def bus(needs: Needs) -> Iterator[Finding]:
    """The folder of the bus's socket is this user's alone; what is asked for can be listened at."""
    try:
        if needs.config is None:
            yield ok("bus", f"{private_folder()} can be entered by this user only")
            return
        config = settled(needs.config, listen=needs.whole_run)
        if needs.whole_run:  # else the router of the run may be there
            check_router(config)
        yield ok("bus", f"{config.bus.endpoint} can be used")
    except PlaceError as error:
        says, _, cure = str(error).partition(": ")
        yield Finding("bus", Mark.MISSING, says, cure)


def arena(needs: Needs) -> Iterator[Finding]:
    """The runs that are on; an arena has one at a time."""
    found = arena_file.found()
    for trouble in found.troubles:
        yield Finding("arena", Mark.WARN, trouble)
    for run in found.runs:
        says = f"{run.arena} has a run of {run.user} in {run.folder} since {run.started}"
        mine = needs.config is not None and run.arena == needs.config.arena.name
        cure = f"end it before you start another one there: Ctrl-C, or `kill {run.pid}`"
        yield Finding("arena", Mark.MISSING if mine else Mark.OK, says, cure if mine else "")


def _nearest(folder: Path) -> Path:
    """Return the folder itself, or the nearest one above it that is there."""
    return next(parent for parent in (folder, *folder.parents) if parent.exists())
