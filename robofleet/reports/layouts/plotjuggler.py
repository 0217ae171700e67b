"""A layout of PlotJuggler: an XML file that names the run's file, the topics to load, and the curves of each plot."""

import xml.etree.ElementTree as ET
from pathlib import Path

from robofleet.recording.run import Recording
from robofleet.recording.scenes.robot_ticks import topic
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
