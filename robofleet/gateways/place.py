"""The run that a gateway serves, and whether it goes on: of this computer, or of an arena that this one has joined."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from robofleet.core.clock import S
from robofleet.core.refusal import RefusedError

if TYPE_CHECKING:
    from robofleet.bus.credentials import Credentials
    from robofleet.bus.zenoh_bus import ZenohBus
    from robofleet.config.tree import Config
    from robofleet.core.clock import Clock

ConfigCopy = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="A copy of the run's configuration, if the run is on another computer."),
]


class ArenaAccess(NamedTuple):
    """Where a run is."""

    endpoint: str | tuple[str, ...]
    credentials: "Credentials | None"  # None: a run of this computer
    role: str  # in which this user meets it
    folder: Path | None = None  # of the run, as its arena file has it, where it is this computer's


def run_of(arena: str | None, copy: Path | None) -> "tuple[Config, ArenaAccess]":
    """Return the run that is meant; ``copy``: of its configuration, where it is elsewhere.

    BadInputError where there is none, or it is not clear which."""
    from robofleet.bus.permissions import OPERATOR  # noqa: PLC0415
    from robofleet.config.load import load_config  # noqa: PLC0415
    from robofleet.operator.requests import chosen, joined_arena  # noqa: PLC0415

    joined = joined_arena(arena)
    if joined is None:
        run = chosen(arena, own=True)
        folder = Path(run.folder)
        return load_config(folder / "config.yaml"), ArenaAccess(run.endpoint, None, OPERATOR, folder)
    if copy is None:
        raise RefusedError(f"{joined.arena} is another computer's: name a copy of its configuration in --config")
    return load_config(copy), ArenaAccess(joined.router, joined.credentials, joined.role)


JOINED_WITHIN_S = 3.0  # the bus of a run that is on


def joined_bus(
    config: "Config", access: ArenaAccess, role: str, clock: "Clock", within_s: float = JOINED_WITHIN_S,
    look: Callable[[], None] | None = None,
) -> "ZenohBus":  # fmt: skip
    """Return a run's bus, to be closed; TimeoutError where nobody answers. ``look`` is called meanwhile."""
    from robofleet.bus.joining import joined  # noqa: PLC0415

    return joined(config.arena.name, access.endpoint, role, clock, within_s, look, access.credentials)


@contextmanager
def answering(config: "Config") -> Iterator[None]:
    """End with exit code 1 and a line where a run's bus does not answer (TimeoutError)."""
    try:
        yield
    except TimeoutError as error:
        print(f"the run of {config.arena.name}: {error}", file=sys.stderr)
        raise typer.Exit(1) from error


def joined_otherwise(config: "Config", access: ArenaAccess, role: str) -> str | None:
    """Return why the router lets through no setpoints from here, and how to mend it; None where it does."""
    if access.credentials is None or access.role == role:
        return None
    arena = config.arena.name
    return (
        f"this computer has joined {arena} as {access.role}, whose commands reach no robot: join as {role}: "
        f"`robofleet keys add {arena} NAME --kind {role}` there, then bundle and `robofleet join`"
    )


def is_over(config: "Config", access: ArenaAccess) -> bool:
    """Return whether a run has ended whose supervisor is silent."""
    from robofleet.bus.arena_file import running  # noqa: PLC0415

    mine = config.arena.name, str(access.folder)
    return access.credentials is not None or all((run.arena, run.folder) != mine for run in running(config.arena.name))


_SUPERVISOR_SILENT_NS = 3 * S  # then it is asked whether there is a run


class Served:
    """The run whose supervisor is heard first."""

    def __init__(self, ended: Callable[[], bool], now_ns: int) -> None:
        """``ended`` tells of a silent run whether it has ended."""
        self._ended, self._heard_ns = ended, now_ns
        self._epoch, self._newest = 0, 0  # of supervisors; 0: none was heard

    def take(self, epoch: int, now_ns: int) -> None:
        self._newest = epoch
        self._epoch, self._heard_ns = self._epoch or self._newest, now_ns

    def is_over(self, now_ns: int) -> bool:
        """Return whether another run has begun, or this one has ended."""
        return self._newest != self._epoch or (now_ns - self._heard_ns > _SUPERVISOR_SILENT_NS and self._ended())
