"""Drivers, cameras, pose sources and behaviours are found by name: an entry point of a group, or ``module:Class``.

The module of ``module:Class`` is an installed one, or a file beside the configuration: ``reach`` makes that loadable.
"""

import difflib
import os
import sys
import traceback
from functools import cache
from importlib import import_module, invalidate_caches
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_KINDS = {"robofleet.poses": "source of poses"}  # where the group's name is not that of one of it in the plural
_NONE = "none: install robofleet, or add it as `module:Class`"


class PluginError(Exception):
    """No such driver, camera or behaviour; the message says which there are."""


def load(group: str, name: str) -> Any:
    """Return the class called ``name``."""
    points = _points(group)
    if ":" not in name and name not in points:
        near = difflib.get_close_matches(name, points, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known(group)) or _NONE}"
        raise PluginError(
            f"there is no {_KINDS.get(group) or group.rpartition('.')[2].removesuffix('s')} {name!r}: {hint}"
        )
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute) if ":" in name else points[name].load()
    except Exception as error:
        mend = "mend its name, or install its package"
        if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
            mend += f", or put {error.name}.py beside the configuration"
        elif (place := _raised_in(error)) is not None:
            mend = f"mend {place}"
        raise PluginError(f"{name!r} cannot be loaded: {error}: {mend}") from error
    if not isinstance(found, type):
        raise PluginError(f"{name!r} is not a class: mend its name")
    return found


def known(group: str) -> list[str]:
    """Return the names of a group's installed classes."""
    return sorted(_points(group))


def _raised_in(error: Exception) -> str | None:
    """Return the file and line of a module that raised while it was loaded; None: it was not found at all."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno} of {error.filename}"
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "importlib" not in frame.filename]
    return f"line {frames[-1].lineno} of {frames[-1].filename}" if len(frames) > 1 else None


def reach(folder: Path, name: str) -> bool:
    """Make a class loadable, here and in the processes started from here; False: its module is not in that folder.

    Installed modules go first, so that no file beside a configuration hides one; PluginError where one hides the file.
    """
    module = name.partition(":")[0].partition(".")[0]
    if ":" not in name or not module.isidentifier():
        return False
    files = [folder / f"{module}.py", folder / module / "__init__.py"]
    own = next((file.resolve() for file in files if file.is_file()), None)
    if own is None:
        return False
    place = str(folder.resolve())
    if place not in sys.path:
        sys.path.append(place)
        invalidate_caches()
    given = os.environ.get("PYTHONPATH", "")
    if place not in given.split(os.pathsep):
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (given, place)))
    found = sys.modules[module].__file__ if module in sys.modules else _origin(module)
    if found is None or Path(found).resolve() != own:
        raise PluginError(f"{name!r}: Python has another module {module!r} ({found or 'built in'}): rename {own}")
    return True


def _origin(module: str) -> str | None:
    spec = find_spec(module)
    return None if spec is None or not spec.has_location else spec.origin


@cache
def _points(group: str) -> dict[str, EntryPoint]:
    """Return a group's entry points by name. They are read once: to find them, every installed package is opened."""
    return {point.name: point for point in entry_points(group=group)}
