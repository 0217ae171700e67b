"""What is refused of a pose source before a run: one that is unknown, cannot work, or does not answer."""

from collections.abc import Iterator

from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.plugins import PluginError, load
from robofleet.nodes.pose_sources import POSES


def complaints(config: Config, *, lockstep: bool = False) -> Iterator[Complaint]:
    """Return what cannot work: (dotted path, what is wrong and how to mend it). Nothing is opened."""
    source = config.tracker.source
    try:
        found = load(POSES, source)
    except PluginError as error:
        yield "tracker.source", str(error)
        return
    in_lockstep = getattr(found, "works_in_lockstep", None)
    if lockstep and source != "camera" and not (in_lockstep is not None and in_lockstep(config)):
        yield "tracker.source", f"{source!r} keeps real time, and lockstep does not: run without --lockstep"
    yield from getattr(found, "refusals", _none)(config)


def unreachable(config: Config) -> list[Complaint]:
    """Ask the source of poses who is there; returns who does not answer."""
    return list(getattr(load(POSES, config.tracker.source), "unreachable", _none)(config))


def _none(_config: Config) -> tuple[Complaint, ...]:
    return ()
