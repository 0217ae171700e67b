"""Begins a script's run, or joins one that is on."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from robofleet.clock import utc_now
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.processes.check import load_checked
from robofleet.processes.refusal import RefusedError, new_folder
from robofleet.processes.script_link import FleetError, Link, scripted
from robofleet.vehicles.interface import DriverError

Out = str | Path | Literal[False] | None


def opened(
    where: str | Path, changes: Sequence[str], out: Out, group: str | None, copy: str | Path | None, *, lockstep: bool
) -> Link:
    """Return a run that is on; ConfigError or FleetError where there is none."""
    file = Path(where)
    try:
        if file.suffix not in (".yaml", ".yml"):
            raise FleetError(f"{where}: not yet")
        config = load_checked(file, changes, lockstep=lockstep, change=scripted)
        return _in_lockstep(config, group_of(config, group), file.stem, _folder(out, file.stem))
    except (RefusedError, DriverError) as error:
        raise FleetError(str(error)) from error


def group_of(config: Config, wanted: str | None) -> str:
    """Return which group the script drives; FleetError where that is not clear."""
    there = groups.scripted(config)
    if wanted is None and len(there) == 1:
        return there[0]
    if wanted not in there:
        known = ", ".join(there) or "none: give one the behaviour `script`"
        asked = "several groups take wishes: name one in `group`" if wanted is None else f"no group {wanted!r} does"
        raise FleetError(f"{asked}: {known}")
    return wanted


def _folder(out: Out, name: str) -> Path | None:
    """Return a new folder for what a run leaves; None: it leaves nothing."""
    if out is False:
        return None
    folder = Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{name}" if out is None else Path(out)
    new_folder(folder, "out")
    return folder


def _in_lockstep(config: Config, group: str, name: str, folder: Path | None) -> Link:
    from robofleet.processes.script_lockstep import LockstepLink  # noqa: PLC0415 - it loads all that a run needs

    link = LockstepLink(config, group, name, folder)
    link.begin()
    return link
