"""Drivers, cameras, pose sources and behaviours are found by name: an entry point of a group, or ``module:Class``.

The module of ``module:Class`` is an installed one, or a file beside the configuration: ``reach`` makes that loadable.
Its folder is searched last, here and in the processes of a run: no file in it hides a module that is installed.
"""

import difflib
import json
import os
import sys
import traceback
from functools import cache
from importlib import import_module, invalidate_caches
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from robofleet.core.errors import RobofleetError

_KINDS = {"robofleet.poses": "source of poses"}  # where the group's name is not that of one of it in the plural
_NONE = "none: install robofleet, or add it as `module:Class`"
_INSTALLED = "/lib/python"  # in the paths of Python's own modules, and of packages
_HANDED = "ROBOFLEET_MODULES"  # environment of the processes started from here: the folders to search last, as JSON


class PluginError(RobofleetError):
    """Raised where no driver, camera, pose source or behaviour has the name. The message says which there are."""


def load(group: str, name: str) -> Any:
    """Return the class called ``name``."""
    for folder in _handed():
        _search(folder)
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
        where = _raised_in(error)
        mend = "mend its name, or install its package"
        if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
            mend += f", or put {error.name}.py beside the configuration"
        elif where is None and ":" not in name:
            mend = "install its package again (in a checkout: pip install -e .)"
        elif isinstance(error, ImportError) and (error.name or "").startswith("robofleet."):
            mend = f"mend {where or 'its name'}: import it from `robofleet` itself, whose modules move (UPGRADING.md)"
        elif where is not None:
            mend = f"mend {where}"
        reason = str(error).partition("\n")[0]
        raise PluginError(f"{name!r} cannot be loaded: {reason}: {mend}") from error
    if not isinstance(found, type):
        raise PluginError(f"{name!r} is not a class: mend its name")
    settings = getattr(found, "Settings", BaseModel)
    if not (isinstance(settings, type) and issubclass(settings, BaseModel)):
        raise PluginError(f"{name!r} has Settings that are no pydantic model: derive them from pydantic.BaseModel")
    return found


def known(group: str) -> list[str]:
    return sorted(_points(group))


def lacks(kind: type, *methods: str) -> str:
    """Return which methods a class does not have, in words; empty where it has all."""
    return " and ".join(f"no {method}" for method in methods if not hasattr(kind, method))


def blamed(error: Exception) -> str:
    """Return what a plug-in has raised, and where to mend it."""
    return f"raised {type(error).__name__}: {error}: mend {_raised_in(error) or 'its class'}"


def _raised_in(error: Exception) -> str | None:
    """Return the file and line, outside installed packages if there is one, that raised; None: nothing was loaded."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno} of {error.filename}"
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "importlib" not in frame.filename]
    own = [frame for frame in frames[1:] if _INSTALLED not in frame.filename]
    return f"line {(own or frames)[-1].lineno} of {(own or frames)[-1].filename}" if len(frames) > 1 else None


def reach(folder: Path, name: str) -> bool:
    """Make a class loadable, here and in the processes started from here; False: its module is not in that folder.

    Installed modules go first, so that no file beside a configuration hides one; PluginError where one hides the file.
    A module that stands elsewhere is found by those processes where it is found here: beside a script, for example.
    """
    module = name.partition(":")[0].partition(".")[0]
    if ":" not in name or not module.isidentifier():
        return False
    files = [folder / f"{module}.py", folder / module / "__init__.py"]
    own = next((file.resolve() for file in files if file.is_file()), None)
    if own is not None:
        _search(str(folder.resolve()))
    found = _file_of(module)
    if own is not None and (found is None or found.resolve() != own):
        raise PluginError(f"{name!r}: Python has another module {module!r} ({found or 'built in'}): rename {own}")
    if found is not None:
        _hand(found.parents[found.name == "__init__.py"].resolve())
    return own is not None


def _search(folder: str) -> None:
    """Let modules be found in a folder, after all others."""
    if folder not in sys.path:
        sys.path.append(folder)
        invalidate_caches()


def _hand(folder: Path) -> None:
    """Let the processes started from here search a folder, if it is searched here."""
    if folder in (Path(directory).resolve() for directory in sys.path) and str(folder) not in (handed := _handed()):
        os.environ[_HANDED] = json.dumps([*handed, str(folder)])


def _handed() -> list[str]:
    try:
        folders = json.loads(os.environ.get(_HANDED, "[]"))
    except ValueError:
        folders = None
    if not isinstance(folders, list) or not all(isinstance(folder, str) for folder in folders):
        raise PluginError(f"{_HANDED} of the environment is no list of folders, as robofleet writes it: unset it")
    return folders


def _file_of(module: str) -> Path | None:
    """Return the file of a module; None: it is built in, or there is none."""
    if module in sys.modules:
        origin = getattr(sys.modules[module], "__file__", None)
    else:
        spec = find_spec(module)
        origin = spec.origin if spec is not None and spec.has_location else None
    return None if origin is None else Path(origin)


@cache
def _points(group: str) -> dict[str, EntryPoint]:
    """Return a group's entry points by name. They are read once: to find them, every installed package is opened."""
    return {point.name: point for point in entry_points(group=group)}
