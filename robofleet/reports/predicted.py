"""The gap of a run to its simulation, as ``robofleet gap`` leaves it beside the recording."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robofleet.core.files import read_plain
from robofleet.reports.pages import Page

FILE = "gap.json"

_LARGEST_BYTES = 1 << 20
_MOST = 1000
Finite = Annotated[float, Field(allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=200)]


class GapFigure(BaseModel):
    """One figure of a recorded run and of the simulated one. ``ratio`` >= 1, whichever is larger; with its interval."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Text
    unit: Text
    recorded: Finite
    simulated: Finite
    ratio: Finite
    low: Finite
    high: Finite

    @property
    def growth(self) -> tuple[float, float, float]:
        """The recorded value by the simulated one, whichever is larger, and its interval."""
        if self.recorded >= self.simulated:
            return self.ratio, self.low, self.high
        return 1.0 / self.ratio, 1.0 / self.high, 1.0 / self.low


class RobotGap(BaseModel):
    """One robot's own figure: how far it was from where the commands alone put it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: Text
    figure: GapFigure


class Gap(BaseModel):
    """What ``gap.json`` holds."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    figures: Annotated[tuple[GapFigure, ...], Field(min_length=1, max_length=_MOST)]
    not_identified: Annotated[tuple[Text, ...], Field(max_length=_MOST)] = ()
    robots: Annotated[tuple[RobotGap, ...], Field(max_length=_MOST)] = ()
    reference: Annotated[dict[Text, Text], Field(max_length=_MOST)] = {}
    """Hash of each robot's file, by which it was simulated."""

    @property
    def worst(self) -> GapFigure:
        """The figure with the largest ratio."""
        return max(self.figures, key=lambda figure: figure.ratio)


def load(folder: Path) -> Gap | None:
    """Return the gap of a run's folder; None where nobody measured it."""
    try:
        return Gap.model_validate_json(read_plain(folder / FILE, _LARGEST_BYTES))
    except (OSError, ValidationError):
        return None


def figures(gap: Gap) -> dict[str, Any]:
    """Return what ``summary.json`` has of a gap."""
    return {"worst": round(gap.worst.ratio, 4), "figure": gap.worst.name, **gap.model_dump(mode="json")}


def section(page: Page, gap: Gap) -> None:
    """Add the section about predicted and observed figures."""
    page.section(
        "Predicted and observed",
        f"The same configuration and seed, simulated with the identified robots: the gap is {gap.worst.ratio:.2f} "
        f"({gap.worst.name}). A ratio is the larger value by the smaller one, each with the figure's resolution added; "
        "its interval (95 %) comes from resampled pieces of both runs.",
    )
    if gap.not_identified:
        page.note(f"Simulated as their vehicle, for nobody identified them: {', '.join(gap.not_identified)}.")
    page.table(
        ("figure", "unit", "observed", "predicted", "ratio", "95 %"),
        [
            (each.name, each.unit, each.recorded, each.simulated, each.ratio, f"{each.low:.2f} to {each.high:.2f}")
            for each in sorted(gap.figures, key=lambda each: -each.ratio)
        ],
    )
