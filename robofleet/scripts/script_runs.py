"""Begins a script's run, or joins one that is on."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from robofleet.behaviours.script import Script
from robofleet.bus.permissions import SCRIPT
from robofleet.config import groups
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.refusal import RefusedError, new_folder
from robofleet.operator.latches import refuse_latched
from robofleet.operator.requests import NoArenaError, chosen, joined_arena
from robofleet.runs import folder as folders
from robofleet.runs.check import load_checked
from robofleet.scripts.script_link import FleetError, Link, first, scripted
from robofleet.vehicles.interface import DriverError

Out = str | Path | Literal[False] | None


def opened(
    where: str | Path, changes: Sequence[str], out: Out, group: str | None, copy: str | Path | None, *,
    lockstep: bool, robots: int | None = None,
) -> Link:  # fmt: skip
    """Return a run that is on; ConfigError or FleetError where there is none."""
    file = Path(where)
    try:
        if file.suffix not in CONFIGURATIONS:
            if lockstep or changes or robots is not None:
                raise FleetError(f"{where}: the run of an arena is as it is: name a configuration, {where}.yaml")
            return _joined(str(where), group, copy)
        config = load_checked(file, changes, lockstep=lockstep, change=lambda tree: scripted(first(tree, robots)))
        if not lockstep:
            refuse_latched(config)
        mine, folder = group_of(config, group), _folder(out, file.stem)
        link: Link
        if lockstep:
            from robofleet.scripts.script_lockstep import LockstepLink  # noqa: PLC0415 - it loads all of a run

            link = LockstepLink(config, mine, file.stem, folder)
        else:
            from robofleet.scripts.script_live import OwnRunLink  # noqa: PLC0415 - it loads Zenoh

            link = OwnRunLink(config, mine, file.stem, folder)
        link.begin()
        return link
    except (RefusedError, DriverError, NoArenaError) as error:
        raise FleetError(str(error)) from None  # the words say all, and a chain of tracebacks hides them


def group_of(config: Config, wanted: str | None) -> str:
    """Return which group the script drives; FleetError where that is not clear."""
    takers = groups.taking_setpoints(config, Script)
    if wanted is None and len(takers) == 1:
        return takers[0]
    if wanted not in takers:
        known = ", ".join(takers) or "none: give one the behaviour `script`"
        complaint = "several groups take wishes: name one in `group`" if wanted is None else f"no group {wanted!r} does"
        raise FleetError(f"{complaint}: {known}")
    return wanted


def _folder(out: Out, name: str) -> Path | None:
    """Return a new folder for what a run leaves; None: it leaves nothing."""
    if out is False:
        return None
    folder = folders.new(name) if out is None else Path(out)
    new_folder(folder, "out")
    return folder


def _joined(arena: str, group: str | None, copy: str | Path | None) -> Link:
    """Return a run of this user on this computer, or of an arena of another computer that this one has joined."""
    from robofleet.scripts.script_live import LiveLink  # noqa: PLC0415

    access = joined_arena(arena)
    if access is None:
        run = chosen(arena, own=True)
        config = load_config(Path(run.folder) / "config.yaml" if copy is None else Path(copy))
        return LiveLink(config, group_of(config, group), run.endpoint)
    if copy is None:
        raise FleetError(f"{arena} is another computer's: name a copy of its configuration in `config`")
    if access.role != SCRIPT:
        raise FleetError(
            f"this computer has joined {arena} as {access.role}: join as a script: "
            f"`robofleet keys add {arena} NAME --kind {SCRIPT}` there, then bundle and `robofleet join`"
        )
    config = load_config(Path(copy))
    return LiveLink(config, group_of(config, group), access.router, access.credentials)
