"""Hints at the file that was probably meant, where a name is of no file or of a folder."""

import difflib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

SHIPPED = Path(__file__).parents[2] / "configs"
_ENDS = (".yaml", ".yml")
_MOST_NAMES_IN_LINE = 5


def guide(name: str) -> Path:
    """Return where a guide of this installation stands: relative to the current folder where it is below that."""
    file, here = (SHIPPED / name).resolve(), Path.cwd()
    return file.relative_to(here) if file.is_relative_to(here) else file


def missing(file: Path) -> str:
    """Return what to say of a file that is not there: the nearest one that is, else those of its folder."""
    found = _beside(file) or _below(file) or _shipped(file)
    if found is not None:
        return f"there is no such file: did you mean {found}?"
    if others := _configurations(file.parent):
        return f"there is no such file: in {file.parent} are {_listed(path.name for path in others)}"
    return "there is no such file: name a configuration, for example configs/platoon.yaml"


def nearest(file: Path) -> Path | None:
    """Return the file of the same folder whose name is nearest; None where none is near."""
    return _near(file.name, _configurations(file.parent))


def in_folder(folder: Path) -> str:
    """Return what to name instead of a folder."""
    others = _configurations(folder)
    first = [path for path in others if path.name == "config.yaml"]  # of a run's folder
    return f"name a file in it: {_listed(map(str, first or others))}" if others else "name a file"


def _beside(file: Path) -> Path | None:
    """Return a near name in the same folder, or the same one in a folder with a near name."""
    if (found := nearest(file)) is not None:
        return found
    with suppress(OSError):
        if not file.parent.exists():
            folders = [path for path in file.parent.parent.iterdir() if path.is_dir()]
            near = _near(file.parent.name, folders)
            return near and _near(file.name, _configurations(near))
    return None


def _below(file: Path) -> Path | None:
    """Return a file of this name one folder further down."""
    with suppress(OSError):
        folders = sorted(path for path in file.parent.iterdir() if path.is_dir())
        return next((path for folder in folders for path in _configurations(folder) if path.name == file.name), None)
    return None


def _shipped(file: Path) -> Path | None:
    path = SHIPPED / f"{file.stem}.yaml"
    return path if path.is_file() else None


def _configurations(folder: Path) -> list[Path]:
    with suppress(OSError):
        return sorted(path for path in folder.iterdir() if path.suffix in _ENDS and path.is_file())
    return []


def _near(name: str, paths: Iterable[Path]) -> Path | None:
    """Return the path whose name is nearest, whatever its letters' case and with or without its end."""
    known = {key: path for path in paths for key in (path.name.casefold(), path.stem.casefold())}
    found = difflib.get_close_matches(name.casefold(), known, n=1)
    return known[found[0]] if found else None


def _listed(names: Iterable[str]) -> str:
    first = list(names)
    return ", ".join(first[:_MOST_NAMES_IN_LINE]) + (
        f" and {len(first) - _MOST_NAMES_IN_LINE} more" if len(first) > _MOST_NAMES_IN_LINE else ""
    )
