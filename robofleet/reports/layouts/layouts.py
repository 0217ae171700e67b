"""The viewers by their names: each one's file, and how to open a run with it."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from robofleet.recording.run import Recording
from robofleet.recording.scenes.robot_ticks import topic
from robofleet.reports.layouts import foxglove, rerun_blueprint
from robofleet.reports.layouts.plots import Plot, Tab, tabs

_VERSION = "2.3.8"  # of the layout's format, in every PlotJuggler 3


def layout(recording: Recording, run: Path) -> bytes:
    """Return the layout of a run's file; only the robots' ticks are loaded."""
    root = ET.Element("root", version=_VERSION)
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for tab in tabs(recording):
        _add_tab(window, tab)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    files = ET.SubElement(root, "previouslyLoaded_Datafiles")
    file = ET.SubElement(files, "fileInfo", filename=str(run), prefix="")
    topics = ";".join(topic(robot.id) for robot in recording.config.members)
    ET.SubElement(file, "selected_datasources", value=topics)
    loader = ET.SubElement(file, "plugin", ID="DataLoad MCAP")
    ET.SubElement(
        loader, "parameters", use_timestamp="0", use_mcap_log_time="1", clamp_large_arrays="0", max_array_size="500",
        selected_topics=topics,
    )  # fmt: skip
    ET.indent(root, " ")
    text: bytes = ET.tostring(root, "utf-8", xml_declaration=True)
    return text + b"\n"


def _add_tab(window: ET.Element, tab: Tab) -> None:
    container = ET.SubElement(ET.SubElement(window, "Tab", tab_name=tab.title, containers="1"), "Container")
    count = len(tab.plots)
    sizes = ";".join([f"{1 / count:.6f}"] * count)
    splitter = ET.SubElement(container, "DockSplitter", orientation="-", count=str(count), sizes=sizes)
    for plot in tab.plots:
        _add_plot(ET.SubElement(splitter, "DockArea", name=plot.title), plot)


def _add_plot(area: ET.Element, plot: Plot) -> None:
    drawn = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
    ET.SubElement(drawn, "range", left="0", right="1", bottom="0", top="1")  # it zooms out when it has the data
    ET.SubElement(drawn, "limitY")
    for line in plot.lines:
        ET.SubElement(drawn, "curve", name=f"{line.topic}/{line.field}", color=line.colour)


class Viewer(NamedTuple):
    """A program that opens a run's file."""

    file: str  # name of its layout's
    make: Callable[[Recording, Path], bytes]  # of a run, and the file of its recording
    opening: tuple[str, ...]  # lines that say what to do with {layout} and {run}


VIEWERS = {
    "foxglove": Viewer(
        "foxglove.json",
        lambda recording, _: foxglove.layout(recording),
        ("In Foxglove open the local file {run}. Then: Layouts, Import from file, {layout}",),
    ),
    "lichtblick": Viewer(
        "lichtblick.json",
        lambda recording, _: foxglove.layout(recording),
        ("In Lichtblick open the local file {run}. Then: Layouts, Import from file, {layout}",),
    ),
    "plotjuggler": Viewer(
        "plotjuggler.xml", lambda recording, run: layout(recording, run.absolute()), ("plotjuggler --layout {layout}",)
    ),
    "rerun": Viewer(
        "rerun.rbl",
        lambda recording, _: rerun_blueprint.layout(recording),
        (
            f"rerun mcap convert --application-id {rerun_blueprint.APPLICATION} -o {{run}}.rrd {{run}}",
            "rerun {run}.rrd {layout}",
        ),
    ),
}
