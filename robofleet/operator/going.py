"""``robofleet go``: robots go to poses by themselves, as a run of its own."""

import math
import re

from robofleet.config.load import Typed
from robofleet.core.refusal import RefusedError

_GOAL = re.compile(r"([a-z][a-z0-9_-]*)=([^,=]+),([^,=]+),([^,=]+)")
_PATIENCE_S = 600.0  # a robot crosses any shipped arena in 20 s; many of them wait for each other


def overrides(goals: list[str]) -> list[str]:
    """Return what changes a configuration into one that goes to ``ROBOT=X,Y,DEG``; RefusedError for another text."""
    poses: dict[str, str] = {}
    for text in goals:
        found = _GOAL.fullmatch(text)
        try:
            robot, *numbers = found.groups() if found else ("",)
            x, y, heading = map(float, numbers)
            if not math.isfinite(x + y + heading):
                raise ValueError(text)
        except ValueError:
            raise RefusedError(f"{text}: write ROBOT=X,Y,DEG in metres and degrees, as r1=0.5,0.2,90") from None
        if robot in poses:
            raise RefusedError(f"{text}: {robot} has a goal already: name each robot once")
        poses[robot] = f"{{x_m: {x!r}, y_m: {y!r}, heading_deg: {heading!r}}}"
    where = ", ".join(f"{robot}: {pose}" for robot, pose in poses.items())
    group = f"{{name: go, behaviour: go_to, robots: [{', '.join(poses)}], settings: {{goals: {{{where}}}}}}}"
    return [
        Typed(f"groups=[{group}]", " ".join(goals)),
        f"run.duration_s={_PATIENCE_S}",
        "run.begin=where_they_stand",
        "run.end=where_they_stand",
        "run.bounds={}",
    ]
