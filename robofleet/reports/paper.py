"""What the paper says of its own platoon, and whether a run is comparable with it."""

import math
from typing import Any

import yaml
from pydantic import ValidationError

from robofleet.behaviours.paths import PathFile
from robofleet.config.files.names import SHIPPED
from robofleet.config.tree import Config

_FIGURE_KEY = "control_error_mm"  # of the figure that the paper tells
CONTROL_ERROR_MM = 5.0  # IV-C: mean of the four robots after 1.4 s, on hardware
SETTLED_S = 1.4
SPACING_M = 0.25  # IV-C: d
FASTEST_S = 9.5, 54.0  # IV-C: when the reference is fastest
_PATH = SHIPPED / "paths" / "platoon.yaml"
_ROBOTS = 4
_PATH_RATE = 0.0455  # gamma [sides/s]
_TICK_S, _ALPHA, _HORIZON_S, _POINT_AHEAD_M = 0.033, 45.0, 0.6, 0.08


def is_papers(config: Config) -> bool:
    """Return whether a configuration drives the paper's platoon: its robots, path, spacing, speed and law."""
    group, *others = config.groups
    if others or group.behaviour != "platoon":
        return False
    law = config.controller
    settings = group.settings
    used = settings.get("spacing_m"), settings.get("path_rate"), law.tick_s, law.alpha, law.horizon_s, law.point_ahead_m
    papers = SPACING_M, _PATH_RATE, _TICK_S, _ALPHA, _HORIZON_S, _POINT_AHEAD_M
    same = all(
        isinstance(ours, int | float) and math.isclose(ours, paper_value)
        for ours, paper_value in zip(used, papers, strict=True)
    )
    return same and len(group.robots) == _ROBOTS and settings.get("path") == _path()


def papers_mean(config: Config, key: str) -> float | None:
    """Return the mean that the paper tells of a group's figure; None where the run is not comparable."""
    return CONTROL_ERROR_MM if key == _FIGURE_KEY and is_papers(config) else None


def _path() -> Any:
    """Return the shipped path, which has the paper's shape; None where it is not there, or is somebody's own."""
    try:
        return PathFile.model_validate(yaml.safe_load(_PATH.read_text())).model_dump(mode="json")
    except (OSError, ValueError, yaml.YAMLError, ValidationError):
        return None
