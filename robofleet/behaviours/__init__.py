"""What groups of robots do: the interface, and one file a behaviour."""

from robofleet.behaviours.interface import (
    Behaviour,
    Bound,
    Decision,
    Dots,
    Figure,
    Flow,
    Line,
    Measure,
    Past,
    Refusal,
    Shape,
    Situation,
    Start,
    Team,
    Wish,
    WishKind,
)
from robofleet.core.settings import Model as Settings

__all__ = [
    "Behaviour", "Bound", "Decision", "Dots", "Figure", "Flow", "Line", "Measure", "Past", "Refusal", "Settings",
    "Shape", "Situation", "Start", "Team", "Wish", "WishKind",
]  # fmt: skip
