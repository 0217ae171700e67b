"""Drivers and cameras are found by name: an entry point of a group, or ``module:Class``."""

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any


class PluginError(Exception):
    """No such driver or camera; the message says which there are."""


def load(group: str, name: str) -> Any:
    """Return the class called ``name``."""
    points = {point.name: point for point in entry_points(group=group)}
    if ":" not in name and name not in points:
        known = ", ".join(sorted(points)) or "none; is robofleet installed (pip install -e .)?"
        raise PluginError(f"no {group} entry point {name!r} (installed: {known})")
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute) if ":" in name else points[name].load()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise PluginError(f"{name!r} cannot be loaded: {error}: mend its name, or install its package") from error
    if not isinstance(found, type):
        raise PluginError(f"{name!r} is no class: mend its name")
    return found
