"""Layouts for viewers: they name channels and fields that the run's file has, and all robots."""

import json
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from robofleet.config import groups
from robofleet.config.load import load_config
from robofleet.recording.run import Recording
from robofleet.recording.scenes.drawn import Drawn
from robofleet.recording.scenes.robot_ticks import MESSAGE, PACKAGE
from robofleet.recording.scenes.scene import Scene
from robofleet.reports.layouts import foxglove
from robofleet.reports.layouts.layouts import VIEWERS
from robofleet.reports.layouts.plots import tabs
from tests.command import robofleet
from tests.recording import make_layouts, recorded

PLOTTED = {
    "centre_error_mm", "estimated_path_error_mm", "estimated_spacing_mm",
    "path_error_mm", "timed_error_mm", "control_error_mm", "spacing_mm", "left_commanded_rad_s", "left_measured_rad_s",
    "right_commanded_rad_s", "right_measured_rad_s", "x_m", "y_m", "psi_rad", "pose_error_mm", "exposure_to_tick_ms",
    "exposure_to_wheel_ms",
}  # fmt: skip


@pytest.fixture
def fields_of(run_file: Path) -> dict[str, set[str]]:
    """Return the fields of each protobuf channel of the run's file."""
    summary, _ = recorded.index(run_file)
    fields: dict[str, set[str]] = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        if schema.encoding == "protobuf":
            kinds = {f"{f.package}.{m.name}": m for f in FileDescriptorSet.FromString(schema.data).file
                     for m in f.message_type}  # fmt: skip
            fields[channel.topic] = {field.name for field in kinds[schema.name].field}
    return fields


def written(viewer: str, run_file: Path, tmp_path: Path) -> bytes:
    out = tmp_path / "layout"
    result = robofleet("layout", viewer, run_file.parent, "--out", out)
    assert result.exit_code == 0, result.output
    assert str(out) in result.output
    return out.read_bytes()


@pytest.mark.parametrize("viewer", VIEWERS)
def test_without_a_name_it_is_beside_the_run_and_named_after_its_viewer(
    viewer: str, run_file: Path, tmp_path: Path
) -> None:
    shutil.copy(run_file, tmp_path)
    assert robofleet("layout", viewer, tmp_path).exit_code == 0
    (layout,) = {*tmp_path.iterdir()} - {tmp_path / run_file.name}
    assert layout.stem == viewer
    assert layout.suffix in {".json", ".xml", ".rbl"}


def leaves(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in {"row", "column"}
        assert 0 < layout["splitPercentage"] < 100
        yield from leaves(layout["first"])
        yield from leaves(layout["second"])


@pytest.mark.parametrize("viewer", ["foxglove", "lichtblick"])
def test_a_layout_of_panels_shows_each_once_and_plots_what_is_there(
    viewer: str, run_file: Path, tmp_path: Path, fields_of: dict[str, set[str]]
) -> None:
    layout = json.loads(written(viewer, run_file, tmp_path))
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    shown = [
        *leaves(layout["layout"]),
        *(leaf for tab in panels["Tab!plots"]["tabs"] for leaf in leaves(tab["layout"])),
    ]
    assert sorted(shown) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    assert {path.rpartition(".")[2] for path in paths} == PLOTTED | {"lost", "filtered", "saturated", "failed"}
    for path in paths:
        topic, _, field = path.rpartition(".")
        assert field in fields_of[topic]
    scene = next(panel for own, panel in panels.items() if own.startswith("3D!"))
    assert set(scene["topics"]) | {panels["RosOut!log"]["topicToRender"]} <= set(fields_of)
    assert "Image!camera" not in panels, "nobody looks in this run"


def test_pictures_are_shown_of_a_run_with_a_camera() -> None:
    config = load_config(recorded.PLATOON)
    image = json.loads(foxglove.layout(Recording(config)))["configById"]["Image!camera"]["imageMode"]
    topics = {channel.topic for channel in Scene(config, ()).channels}
    assert {image["imageTopic"], *image["annotations"]} <= topics


def test_plotjuggler_finds_the_file_and_every_curve(
    run_file: Path, tmp_path: Path, fields_of: dict[str, set[str]]
) -> None:
    root = ET.fromstring(written("plotjuggler", run_file, tmp_path))
    assert root.get("version") == "2.3.8"
    file = root.find("previouslyLoaded_Datafiles/fileInfo")
    assert file is not None
    assert Path(file.get("filename", "")) == run_file
    parameters = file.find("plugin[@ID='DataLoad MCAP']/parameters")
    assert parameters is not None
    loaded = parameters.get("selected_topics", "").split(";")
    curves = [curve.get("name", "") for curve in root.iter("curve")]
    assert {curve.rpartition("/")[2] for curve in curves} == PLOTTED
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        assert topic in loaded
        assert field in fields_of[topic]
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.get("count", "")) == len(splitter.get("sizes", "").split(";"))


@pytest.mark.long
def test_rerun_reads_the_blueprint_and_has_what_it_names(run_file: Path, tmp_path: Path) -> None:
    from rerun.chunk import McapReader, RrdReader

    (tmp_path / "run.rbl").write_bytes(written("rerun", run_file, tmp_path))
    (store,) = RrdReader(tmp_path / "run.rbl").blueprints()
    assert store.application_id == "robofleet"
    mapped: list[dict[str, str]] = []
    for chunk in RrdReader(tmp_path / "run.rbl").stream(store=store):
        batch = chunk.to_record_batch()
        if "VisualizerInstruction:component_map" in batch.schema.names:
            maps = batch.column("VisualizerInstruction:component_map").to_pylist()
            mapped += [{"of": chunk.entity_path, **component} for row in maps for component in row]
    held: dict[str, set[str]] = {}
    for chunk in McapReader(run_file).stream():
        if chunk.entity_path.startswith("/robots/") and chunk.entity_path.endswith("/tick") and not chunk.is_static:
            schema = chunk.to_record_batch().schema
            message = schema.field(f"{PACKAGE}.{MESSAGE}:message").type.value_type
            held[chunk.entity_path] = {field.name for field in message}
    lines = {
        (line.topic, line.field)
        for tab in tabs(Recording(recorded.config()))
        for plot in tab.plots
        for line in plot.lines
    }
    assert {component["source_component"] for component in mapped} == {f"{PACKAGE}.{MESSAGE}:message"}
    assert {
        (topic, component["selector"][1:]) for component in mapped for topic in held if topic in component["of"]
    } == lines
    assert all(field in held[topic] for topic, field in lines)


def test_an_unknown_viewer_is_refused_in_a_line(run_file: Path) -> None:
    result = robofleet("layout", "vlc", run_file)
    assert result.exit_code == 2
    assert all(viewer in result.output for viewer in VIEWERS)
    assert result.output.count("\n") == 1


def test_a_file_that_is_no_recording_has_no_layout(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"something")
    result = robofleet("layout", "foxglove", tmp_path)
    assert result.exit_code == 2
    assert not (tmp_path / "foxglove.json").exists()


def test_layouts_of_the_repository_are_those_of_the_platoon_and_name_channels_that_it_has() -> None:
    config = load_config(recorded.PLATOON)
    fields = {
        channel.topic: {field.name for file in FileDescriptorSet.FromString(channel.description).file
                        for message in file.message_type for field in message.field}
        for channel in Drawn(config, groups.descriptions(config)).channels
    }  # fmt: skip
    for file, layout in make_layouts.layouts():
        assert file.read_bytes() == layout, "python -m tests.recording.make_layouts"
        named = {name.decode() for name in re.findall(rb'["; ](/[\w/]+(?:\.\w+)?)', layout)}
        assert len(named) > len(config.robots)
        for name in named - set(fields):
            topic, field = re.split(r"[./](?=\w+$)", name)
            assert field in fields[topic], f"{file.name} names {name}"
