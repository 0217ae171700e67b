"""The gap over days: one row for each recording, and which robot's predictions grew worse since when."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.figure import Figure

from robofleet.calibration.report import Report
from robofleet.calibration.robots.results import Rows
from robofleet.core.figures import COLOURS, QUIET, STYLE
from robofleet.reports.predicted import Gap, GapFigure


@dataclass(frozen=True)
class Day:
    """One recording's gap."""

    run: str
    date: str
    gap: Gap


def table(days: Sequence[Day]) -> Rows:
    """Return a row for each recording: the worst figure, and the worst robot."""
    rows: list[tuple[str, ...]] = []
    for day in days:
        worst, robots = day.gap.worst, day.gap.robots
        own = max(robots, key=lambda each: each.figure.growth[0], default=None)
        robot = ("-", "-") if own is None else (own.robot, f"{own.figure.growth[0]:.2f}")
        rows.append((day.date, day.run, f"{worst.ratio:.2f}", worst.name, *robot))
    return ("date", "recording", "gap", "worst figure", "worst robot", "its ratio"), rows


def worn(days: Sequence[Day]) -> list[str]:
    """Return a line for each robot whose predictions are worse than on the first day, and have been since some day.

    Worse: the interval of its ratio lies above that of its first recording.
    """
    lines = []
    for robot in dict.fromkeys(each.robot for day in days for each in day.gap.robots):
        own = [(day, figure) for day in days if (figure := _own(day, robot)) is not None]
        first, since = own[0][1], None
        for day, figure in reversed(own[1:]):
            if figure.growth[1] <= first.growth[2]:
                break
            since = day
        if since is not None:
            lines.append(
                f"{robot}: since {since.run} its predictions are worse than in {days[0].run}: {first.recorded:.1f} mm "
                f"then, {own[-1][1].recorded:.1f} mm now ({first.name}): its wheels wear, or its load changed"
            )
    return lines


def page(days: Sequence[Day]) -> Report:
    """Return the page of ``robofleet gap`` over several recordings."""
    report, lines = Report("The gap over days"), worn(days)
    report.verdict(
        "No robot's predictions grew worse." if not lines else f"Grown worse: {'; '.join(lines)}.", good=not lines
    )
    report.table(*table(days))
    report.figure(
        _figure(days),
        "Above: the worst ratio of each recording. Below: how far each robot is from where the commands alone put it, "
        "against the same of the simulation, with 95 % intervals.",
    )
    return report


def _own(day: Day, robot: str) -> GapFigure | None:
    return next((each.figure for each in day.gap.robots if each.robot == robot), None)


def _figure(days: Sequence[Day]) -> Figure:
    robots = dict.fromkeys(each.robot for day in days for each in day.gap.robots)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.4), layout="constrained")
        worst, own = figure.subplots(2, 1, sharex=True)
        worst.plot(range(len(days)), [day.gap.worst.ratio for day in days], ".-", color=QUIET)
        worst.set(ylabel="gap")
        for k, robot in enumerate(robots):
            known = [(x, growth.growth) for x, day in enumerate(days) if (growth := _own(day, robot)) is not None]
            x, (ratio, low, high) = [each for each, _ in known], zip(*(each for _, each in known), strict=True)
            colour = COLOURS[k % len(COLOURS)]
            own.plot(x, ratio, ".-", color=colour, label=robot)
            own.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
        own.set(ylabel="a robot's ratio", xticks=range(len(days)))
        own.set_xticklabels([day.date.partition("T")[0] for day in days], rotation=30, ha="right")
        own.legend(loc="upper left", ncols=4)
    return figure
