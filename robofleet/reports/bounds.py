"""What a run is judged by: figures of its summary against the bounds of its configuration.

A figure that several groups have is judged by the largest.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from robofleet.behaviours.described import JUDGED_FIGURES
from robofleet.config.tree import Bounds
from robofleet.reports.own_figures import is_number

Figures = dict[str, Any]


class Judged(NamedTuple):
    """A figure that may have a bound."""

    label: str
    unit: str
    value_of: Callable[[Figures], float | None]  # the summary's value; None: not measured
    at_least: bool = False
    own: bool = False  # whether it is a group's own, which not every behaviour has
    later: bool = False  # whether it is measured after the run: nobody judges it before

    @property
    def title(self) -> str:
        return f"{self.label}, {self.unit}" if self.unit else self.label


def part(*keys: str) -> Callable[[Figures], float | None]:
    """Return what finds a figure of the summary, below figures that may not have been measured."""
    return lambda figures: _within(figures, keys)


def of_groups(*keys: str) -> Callable[[Figures], float | None]:
    """Return what finds the largest figure of the groups that have it."""

    def value(figures: Figures) -> float | None:
        found = [_within(own, keys) for own in figures["groups"].values()]
        return max((number for number in found if number is not None), default=None)

    return value


def _within(found: Any, keys: Sequence[str]) -> float | None:
    """Return a number below keys of figures, which may be of any kind; of a list the first."""
    for key in keys:
        found = found.get(key) if isinstance(found, dict) else None
    if isinstance(found, list):
        found = found[0] if found else None
    return found if is_number(found) else None


def _own_stops(figures: Figures) -> int | None:
    return sum(not stop["by_operator"] for stop in figures["stops"]) if figures["ticks"] else None


JUDGED = {  # by the keys of run.bounds
    **{
        figure.bound: Judged(figure.label, "mm", of_groups(figure.key, figure.statistic), own=True)
        for figure in JUDGED_FIGURES
    },
    "min_gap_mm": Judged("smallest gap of bodies", "mm", part("min_gap_mm"), at_least=True),
    "min_obstacle_gap_mm": Judged("smallest gap to an obstacle", "mm", part("min_obstacle_gap_mm"), at_least=True),
    "pose_error_rms_mm": Judged("pose error, rms", "mm", part("pose_error", "rms_mm")),
    "overruns": Judged("ticks overrun", "", part("tick", "overruns")),
    "exposure_to_wheel_p99_ms": Judged("exposure to wheel, p99", "ms", part("latency_ms", "exposure_to_wheel", "p99")),
    "stops": Judged("unrequested stops of robots", "", _own_stops),
    "gap": Judged("gap to the simulation, worst ratio", "", part("gap", "worst"), later=True),
}
JUDGED_KEYS = frozenset(figure.key for figure in JUDGED_FIGURES)  # of groups' figures


def judged(figures: Figures, bounds: Bounds) -> list[Figures]:
    """Return the verdict on every figure that has a bound. One that was not measured has not met it."""
    verdicts = []
    for name, limit in bounds.model_dump(exclude_none=True).items():
        figure = JUDGED[name]
        value = figure.value_of(figures)
        if value is None and figure.later:
            continue
        met = value is not None and (value >= limit if figure.at_least else value <= limit)
        verdicts.append({"figure": name, "value": value, "limit": limit, "pass": met})
    return verdicts


def is_judged(figures: Figures, bound: Figures) -> bool:
    """Return whether a bound says something of a run: not where the run ended before its figure was measured."""
    return bound["value"] is not None or figures["outcome"] == "completed"


def failures(figures: Figures) -> list[str]:
    """Return a line for every bound of a summary that was judged and not met."""
    return [_line(bound) for bound in figures["bounds"] if not bound["pass"] and is_judged(figures, bound)]


def missed(figures: Figures) -> list[str]:
    """Return a line for every bound of a summary whose figure was measured and did not meet it."""
    return [_line(bound) for bound in figures["bounds"] if not bound["pass"] and bound["value"] is not None]


def unmeasured(figures: Figures) -> list[str]:
    """Return a line for every bound of a summary whose figure was not measured."""
    return [_line(bound) for bound in figures["bounds"] if bound["value"] is None]


def _line(bound: Figures) -> str:
    return f"{JUDGED[bound['figure']].label}: {shown(bound)}"


def unjudged(figures: Figures) -> str:
    """Return how many limits were not checked; an empty string where all were."""
    bounds = figures["bounds"]
    many = sum(not is_judged(figures, bound) for bound in bounds)
    if many and not figures["ticks"]:
        return "No limit was checked: the robots never drove."
    return f"{many} of {len(bounds)} limits were not checked: the run ended too early." if many else ""


def complaints(figures: Figures) -> list[str]:
    """Return what a command says about the bounds of a run; nothing where every one was met."""
    rest = unjudged(figures)
    return [*(f"bound not met: {line}" for line in failures(figures)), *([rest] if rest else [])]


def shown(bound: Figures) -> str:
    unit = JUDGED[bound["figure"]].unit
    value = "not measured" if bound["value"] is None else f"{bound['value']:.4g} {unit}".strip()
    return f"{value}; {'lower ' * JUDGED[bound['figure']].at_least}limit {bound['limit']:g} {unit}".strip()


def limit(bound: Figures) -> str:
    figure = JUDGED[bound["figure"]]
    return f"{'at least' if figure.at_least else 'at most'} {bound['limit']:g} {figure.unit}".strip()
