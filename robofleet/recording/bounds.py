"""What a run is judged by: figures of its summary against the bounds of its configuration."""

from collections.abc import Callable
from typing import Any, NamedTuple

from robofleet.config.tree import Bounds

Figures = dict[str, Any]


class Judged(NamedTuple):
    """A figure that may have a bound."""

    label: str
    unit: str
    of: Callable[[Figures], float | None]  # the summary's value; None: not measured
    at_least: bool = False


def part(*keys: str) -> Callable[[Figures], float | None]:
    """Return what finds a figure of the summary, below figures that may not have been measured."""

    def value(figures: Figures) -> Any:
        found: Any = figures
        for key in keys:
            found = None if found is None else found[key]
        return found

    return value


def _leaders_timed(figures: Figures) -> float | None:
    timed = figures["timed_error_mm"]
    leader: float | None = None if timed is None else timed["per_robot_mean"][0]
    return leader


JUDGED = {  # by the keys of run.bounds
    "control_error_mean_mm": Judged("control error, mean", "mm", part("control_error_mm", "mean")),
    "timed_error_mean_mm": Judged("leader's timed error, mean", "mm", _leaders_timed),
    "path_error_mean_mm": Judged("path error, mean", "mm", part("path_error_mm", "mean")),
    "spacing_max_deviation_mm": Judged("largest spacing error", "mm", part("spacing_m", "max_deviation_mm")),
    "min_gap_mm": Judged("smallest gap of bodies", "mm", part("min_gap_mm"), at_least=True),
    "pose_error_rms_mm": Judged("pose error, rms", "mm", part("pose_error", "rms_mm")),
    "overruns": Judged("ticks overrun", "", part("tick", "overruns")),
    "exposure_to_wheel_p99_ms": Judged("exposure to wheel, p99", "ms", part("latency_ms", "exposure_to_wheel", "p99")),
    "stops": Judged("stops of a robot", "", lambda figures: len(figures["stops"]) if figures["ticks"] else None),
}


def judged(figures: Figures, bounds: Bounds) -> list[Figures]:
    """Return the verdict on every figure that has a bound. One that was not measured has not met it."""
    verdicts = []
    for name, limit in bounds.model_dump(exclude_none=True).items():
        figure = JUDGED[name]
        value = figure.of(figures)
        met = value is not None and (value >= limit if figure.at_least else value <= limit)
        verdicts.append({"figure": name, "value": value, "limit": limit, "pass": met})
    return verdicts


def failures(figures: Figures) -> list[str]:
    """Return a line for every bound of a summary that was not met."""
    return [f"{JUDGED[bound['figure']].label}: {shown(bound)}" for bound in figures["bounds"] if not bound["pass"]]


def shown(bound: Figures) -> str:
    """Return a verdict's value and limit in words."""
    figure = JUDGED[bound["figure"]]
    value = "not measured" if bound["value"] is None else f"{bound['value']:.4g} {figure.unit}".strip()
    return f"{value}, {'at least' if figure.at_least else 'at most'} {bound['limit']:g} asked for"
