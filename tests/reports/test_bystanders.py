"""A run beside which a robot was parked: where it is drawn, and what it is counted for."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import CAMERA, POSES, TICK, TRUTH, key, named
from robofleet.bus.messages import FLEET_POSES, FleetPoses, TagPose
from robofleet.config.tree import Config
from robofleet.core.clock import SimulatedClock
from robofleet.operator.page import frames
from robofleet.operator.page.hearing import Hearing
from robofleet.recording.columns import CSV, write_csv
from robofleet.recording.run import Recording, Run
from robofleet.recording.scenes.scene import Scene
from robofleet.reports import report
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from tests.recording import recorded
from tests.recording.recorded import PLATOON

PLACE = (1.0, 0.1)


def parked() -> Config:
    robots = yaml.safe_load(PLATOON.read_text())["robots"]
    start = {"x_m": PLACE[0], "y_m": PLACE[1], "heading_deg": 90.0}
    robots.insert(
        1, {"id": "p1", "tag": 9, "vehicle": "gternal", "start": start}
    )  # the group's come first all the same
    return recorded.config(f"robots={json.dumps(robots)}", "run.duration_s=1", "run.settle_s=0", "tracker.truth={}")


@pytest.fixture(scope="module")
def run() -> Lockstep:
    drive = Lockstep(parked())
    assert drive.run() == ("completed", None)
    return drive


def without_truth(recording: Recording) -> Recording:
    """Return what a laboratory's run leaves: nobody knows the truth."""
    estimated = Recording(recording.config)
    for full, payload in recorded.in_order(recording):
        topic = named(full)
        if topic is None or topic[0] is not TRUTH:
            estimated.add(full, payload)
    return estimated


def figures(recording: Recording) -> dict[str, Any]:
    return summary(recording, name="x", mode="lockstep", outcome="completed", cause=None)


def test_it_is_counted_as_a_bystander_and_has_no_errors(run: Lockstep) -> None:
    s = figures(run.recording)
    assert (s["robots"], s["bystanders"]) == (["r1", "r2", "r3", "r4"], ["p1"])
    assert len(s["control_error_mm"]["per_robot_mean"]) == 4
    assert s["tracker"]["false_ids"] == 0
    assert s["tracker"]["measured_fraction"] <= 1.0
    assert Run(run.recording).robots == ["r1", "r2", "r3", "r4"]
    assert figures(without_truth(run.recording))["min_gap_mm"] is None


@pytest.mark.parametrize("truth", [True, False])
def test_it_stands_where_it_was_seen(run: Lockstep, truth: bool) -> None:
    recording = run.recording if truth else without_truth(run.recording)
    (pose,) = Run(recording).standing()
    assert pose == pytest.approx([*PLACE, np.pi / 2], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("truth", [True, False])
def test_its_report_is_written(run: Lockstep, truth: bool, tmp_path: Path) -> None:
    recording = run.recording if truth else without_truth(run.recording)
    assert "p1" in report.write(Run(recording), figures(recording), tmp_path).read_text()
    write_csv([Run(recording)], tmp_path / CSV)
    assert ",p1," not in (tmp_path / CSV).read_text()


def test_viewers_draw_it_where_it_stands(run: Lockstep) -> None:
    scene = Scene(run.recording.config, run.recording.groups)
    at, bodies = [], set()
    for number, (full, payload) in enumerate(recorded.in_order(run.recording)):
        for topic, message in scene.update(full, payload, number * 10**6):
            if topic == "/tf":
                transforms = FrameTransforms.FromString(message).transforms
                at += [(t.translation.x, t.translation.y) for t in transforms if t.child_frame_id == "p1"]
            elif topic == "/fleet":
                bodies |= {entity.id for entity in SceneUpdate.FromString(message).entities}
    assert at == [pytest.approx(PLACE, abs=1e-6)] * len(at)
    assert len(at) > 10
    assert bodies == {"r1", "r2", "r3", "r4", "p1"}


def test_the_page_shows_it_where_it_stands(run: Lockstep) -> None:
    config, groups, clock = run.recording.config, run.recording.groups, SimulatedClock()
    clock.advance_to(10**9)
    bus = MemoryBus(config.arena.name, clock, 0)
    hearing = Hearing(config, bus, clock, lambda _: None)
    bus.publisher(TICK)(run.recording.messages[key("platoon", TICK)][-1])
    seen = tuple(TagPose(9, 0, coasted_ns, 0.5, 0.25, 1.0 + coasted_ns) for coasted_ns in (0, 7))
    bus.publisher(POSES, CAMERA)(FLEET_POSES.encode(FleetPoses(1, 1, 1, 5, 6, 1, 0, 0, 0, seen)))
    hearing.hear()
    hearing.hear_the_rest()
    hello = frames.hello(config, groups, Path("folder"))
    assert [(robot["id"], robot["driven"]) for robot in hello["robots"]][-2:] == [("r4", True), ("p1", False)]
    frame = frames.tick(hearing, config, groups, 1, 10**9, "")
    rows = [dict(zip(frames.COLUMNS, row, strict=True)) for row in frame["robots"]]
    assert len(rows) == 5
    assert (rows[4]["x_m"], rows[4]["y_m"], rows[4]["psi_rad"]) == (0.5, 0.25, 1.0)
    assert {rows[4][name] for name in ("point_x_m", "reference_x_m", "left_rad_s")} == {None}
    assert not any(rows[4]["figures"] or ())
    assert rows[3]["x_m"] is not None
