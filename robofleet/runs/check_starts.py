"""What is said of starts before anything moves: as each group's behaviour judges them."""

import math
from collections.abc import Iterator

from robofleet.behaviours.interface import Start
from robofleet.config import groups
from robofleet.config.tree import Config


def rows(config: Config) -> list[tuple[str, str, str, str]]:
    """Return what a table of proofs says of the starts: (what, value, limit, how much of it is used)."""
    settle_s = config.run.spacing_settle_s
    found: list[tuple[str, str, str, str]] = []
    for start in _judged(config):
        found += start.rows
        if start.arrived_s:
            late_s = max(start.arrived_s)
            takes = f"{late_s:.1f} s" if math.isfinite(late_s) else "over 25 s"
            note = "ok" if late_s <= settle_s else "slow"
            found.append(("the time until every robot is where it is to be", takes, f"{settle_s:g} s", note))
    return found


def warnings(config: Config) -> Iterator[str]:
    """Yield what works and may take long, a line each."""
    settle_s = config.run.spacing_settle_s
    for start in _judged(config):
        for late_s, warning in () if start.jam else start.warnings:
            if late_s > settle_s:
                yield f"{warning}; figures count after {settle_s:g} s (run.spacing_settle_s)"


def _judged(config: Config) -> Iterator[Start]:
    """Yield what each behaviour says of its robots' starts, where all of them have one."""
    for behaviour in groups.behaviours(config):
        poses = [pose for pose in behaviour.team.starts if pose is not None]
        if len(poses) == len(behaviour.team):
            yield behaviour.start(poses)
