"""The viewers by their names: each one's file, and how to open a run with it."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from robofleet.recording.run import Recording
from robofleet.reports.layouts import foxglove, plotjuggler, rerun_blueprint


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
        "plotjuggler.xml",
        lambda recording, run: plotjuggler.layout(recording, run.absolute()),
        ("plotjuggler --layout {layout}",),
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
