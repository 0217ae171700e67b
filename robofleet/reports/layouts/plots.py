"""What every viewer's layout plots: a robot's columns as lines in the robot's colour."""

from collections.abc import Iterator
from typing import NamedTuple

from robofleet.core.figures import robot_colours
from robofleet.recording.columns import own_name
from robofleet.recording.gauge import Gauge
from robofleet.recording.run import Recording
from robofleet.recording.scenes.robot_ticks import topic


class Line(NamedTuple):
    """A field of a robot's channel."""

    topic: str
    field: str
    label: str
    colour: str  # #rrggbb


class Plot(NamedTuple):
    """Lines on the same axes."""

    title: str
    lines: tuple[Line, ...]


class Tab(NamedTuple):
    """Plots that are seen at once."""

    title: str
    plots: tuple[Plot, ...]


_TABS = {
    "Wheels": {
        "Left wheel, rad/s": {"commanded": "left_commanded_rad_s", "measured": "left_measured_rad_s"},
        "Right wheel, rad/s": {"commanded": "right_commanded_rad_s", "measured": "right_measured_rad_s"},
    },
    "Poses": {
        "x, m": {"": "x_m"},
        "y, m": {"": "y_m"},
        "Heading, rad": {"": "psi_rad"},
        "Pose error of the filter, mm": {"": "pose_error_mm"},
    },
    "Latency": {
        "Exposure to tick, ms": {"": "exposure_to_tick_ms"},
        "Exposure to wheel, ms": {"": "exposure_to_wheel_ms"},
    },
}


def tabs(recording: Recording) -> tuple[Tab, ...]:
    """Return what is plotted of a run: each group's own first."""
    robots = [robot.id for robot in recording.config.members]
    colours = dict(zip(robots, robot_colours(len(robots)), strict=True))
    own = [Tab(gauge.group.name, tuple(_own(gauge, colours))) for gauge in recording.gauges]
    rest = [
        Tab(name, tuple(Plot(title, _lines(colours, fields)) for title, fields in plots.items()))
        for name, plots in _TABS.items()
    ]
    return (*(tab for tab in own if tab.plots), *rest)


def _own(gauge: Gauge, colours: dict[str, str]) -> Iterator[Plot]:
    """Yield a plot for each of a group's own columns."""
    for name, curve in gauge.columns.items():
        if curve.live:
            rows, _ = curve.columns[name]
            robots = [gauge.group.robots[row] for row in rows]
            lines = tuple(Line(topic(robot), own_name(name), robot, colours[robot]) for robot in robots)
            yield Plot(curve.title + (f", {curve.unit}" if curve.unit else ""), lines)


def _lines(colours: dict[str, str], fields: dict[str, str]) -> tuple[Line, ...]:
    return tuple(
        Line(topic(robot), field, f"{robot} {words}".strip(), colour)
        for robot, colour in colours.items()
        for words, field in fields.items()
    )
