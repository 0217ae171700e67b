"""Drivers and cameras are found by name: an entry point of a group, or ``module:Class``."""

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any


class PluginError(Exception):
    """No such driver or camera; the message says which there are."""


def load(group: str, name: str) -> Any:
    """Return the class called ``name``."""
    if ":" in name:
        module, _, attribute = name.partition(":")
        try:
            return getattr(import_module(module), attribute)
        except (ImportError, AttributeError, TypeError, ValueError) as error:
            raise PluginError(f"{name!r} cannot be loaded: {error}: mend its name, or install its package") from error
    found = {point.name: point for point in entry_points(group=group)}
    if name not in found:
        known = ", ".join(sorted(found)) or "none; is robofleet installed (pip install -e .)?"
        raise PluginError(f"no {group} entry point {name!r} (installed: {known})")
    return found[name].load()
