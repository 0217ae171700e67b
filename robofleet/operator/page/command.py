"""``robofleet web``: which run is meant, and whether it is over."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from robofleet.bus.arena_file import ArenaFile, Search, running
from robofleet.bus.endpoint import listens
from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.core.refusal import RefusedError
from robofleet.operator.page.verdict import REPORT, verdict_of
from robofleet.operator.requests import chosen

_CONFIG = "config.yaml"
_POLL_NS = S // 4


class There(NamedTuple):
    """The run whose page is served."""

    config: Config
    folder: Path
    run: ArenaFile | None  # None: its processes were started one by one


def there(named: str | None, load: Callable[[Path], Config]) -> There:
    """Return the run that is meant: of an arena, or of a configuration; RefusedError where it has ended."""
    file = None if named is None else Path(named)
    if file is None or not (file.exists() or file.suffix):
        run = chosen(named, own=True)
        folder = Path(run.folder)
        return There(load(folder / _CONFIG), folder, run)
    file = file / _CONFIG if file.is_dir() else file
    config, folder = load(file), file.absolute().parent
    mine = [*Search(config.arena.name).own()]
    if mine and Path(mine[0].folder) == folder:
        return There(config, folder, mine[0])
    if (verdict := verdict_of(folder)) is not None:
        raise RefusedError(f"the run in {folder} has ended: {verdict.headline}{_report(folder)}")
    if mine:  # its own file, resolved: this one may have been changed meanwhile
        return There(load(Path(mine[0].folder) / _CONFIG), Path(mine[0].folder), mine[0])
    return There(config, folder, None)


class Over:
    """Whether a run's launcher is gone, or its router: that is the last process it ends."""

    def __init__(self, page_run: There) -> None:
        self._endpoint, self._run, self._clock = page_run.config.bus.endpoint, page_run.run, WallClock()
        self._met = self._over = False
        self._looked_ns = 0

    def __call__(self) -> bool:
        """Look, four times a second at most."""
        now_ns = self._clock.now_ns()
        if self._run is not None and not self._over and now_ns - self._looked_ns >= _POLL_NS:
            self._looked_ns = now_ns
            meets = listens(self._endpoint)
            self._met = self._met or meets is True
            self._over = self._run not in running(self._run.arena) or (self._met and meets is False)
        return self._over


def how_ended(config: Config, folder: Path) -> str:
    """Return how a run ended, and where it is kept, in a line."""
    verdict = verdict_of(folder)
    how = f": {verdict.headline}" if verdict is not None else ""
    return f"the run of {config.arena.name} has ended{how}{_report(folder)}"


def _report(folder: Path) -> str:
    return f"; its report: {folder / REPORT}" if (folder / REPORT).is_file() else f"; it is kept in {folder}"
