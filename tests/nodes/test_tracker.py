"""The tracker's step alone: when it looks, and how it says when that was."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, POSES, TICK
from robofleet.bus.messages import TagPose, TickRecord
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S
from robofleet.nodes.tracker import SeenLog
from robofleet.tracking.sources import Observation
from tests.nodes.tracker_stand import TICK_NS, TrackerStand
from tests.shipped import PLATOON

Make = Callable[..., Any]
LEAD_NS = 18 * MS


@pytest.fixture
def stand_of(bench_of: Make, platoon_of: Make) -> Callable[..., TrackerStand]:
    exact = ["tracker.truth={delay_s: 0.005}", f"camera.trigger_lead_s={LEAD_NS / S}"]
    return lambda *overrides: TrackerStand(bench_of(platoon_of(*exact, *overrides)))


def test_nothing_is_seen_before_the_first_trigger(stand_of: Make) -> None:
    stand = stand_of("tracker.source=truth")
    stand.bench.run(stand.node, S)
    assert stand.bench.heard(POSES, CAMERA) == []


@pytest.mark.parametrize("source", ["truth", "camera"])
def test_a_trigger_of_the_ticks_exposes_exactly_its_lead_before_them(stand_of: Make, source: str) -> None:
    stand = stand_of(f"tracker.source={source}")
    frames = stand.run(S // 2)
    exposures = [frame.exposure_ns - stand.origin_ns for frame in frames]
    assert {(at + LEAD_NS) % TICK_NS for at in exposures} == {0}
    assert set(np.diff(exposures)) == {TICK_NS}
    assert len(frames) >= S // 2 // TICK_NS - 2
    for frame, at in zip(frames, exposures, strict=True):
        assert frame.echo_tick * TICK_NS + frame.since_tick_ns == at
        assert frame.since_tick_ns == TICK_NS - LEAD_NS


@pytest.mark.parametrize("source", ["truth", "camera"])
def test_a_camera_of_its_own_rate_drifts_against_the_ticks(stand_of: Make, source: str) -> None:
    stand = stand_of(f"tracker.source={source}", "camera.trigger=free")
    frames = [frame for frame in stand.run(S) if frame.echo_tick]
    assert set(np.diff([frame.exposure_ns for frame in frames])) == {round(S / 30)}
    since = [frame.since_tick_ns for frame in frames]
    assert len(set(since)) > 20
    assert max(since) - min(since) > 5 * MS
    for frame in frames:
        assert stand.origin_ns + frame.echo_tick * TICK_NS + frame.since_tick_ns == frame.exposure_ns
        assert stand.bench.now_ns >= frame.exposure_ns


@pytest.mark.parametrize(("source", "mm"), [("truth", 1e-6), ("camera", 1.0)])
def test_robots_are_where_they_were_at_mid_exposure(stand_of: Make, source: str, mm: float) -> None:
    stand = stand_of(f"tracker.source={source}")
    frames = stand.run(S // 2)[3:]
    for frame in frames:
        for robot, pose in zip(stand.bench.config.robots, sorted(frame.poses), strict=True):
            assert pose.tag == robot.tag
            x, y, psi = stand.pose(robot, frame.exposure_ns)
            assert np.hypot(pose.x_m - x, pose.y_m - y) * 1e3 < mm
            assert pose.psi_rad == pytest.approx(psi, abs=0.02)


@pytest.mark.parametrize("late_ms", [20, 40, 60, 500])
def test_a_tick_that_came_late_is_not_mistaken_for_one_before_the_first(stand_of: Make, late_ms: int) -> None:
    stand = stand_of("tracker.source=truth")
    stand.bench.wait(late_ms * MS)
    stamp_ns = stand.bench.now_ns - late_ms * MS
    stand.bench.say(TICK, TickRecord(1, 1, 1, -1, stamp_ns, *[0] * 11, (), ()))
    stand.bench.run(stand.node, S // 10)
    (frame,) = stand.bench.heard(POSES, CAMERA)
    assert frame.exposure_ns == stamp_ns + TICK_NS - LEAD_NS
    assert frame.echo_tick in (0, 1), "0: not known, which is not used"


def test_sequence_numbers_are_without_a_gap(stand_of: Make) -> None:
    frames = stand_of("tracker.source=truth").run(S)
    assert [frame.seq for frame in frames] == list(range(1, len(frames) + 1))


def test_a_tracker_says_what_it_looks_for_and_sees(tmp_path: Path) -> None:
    lines: list[str] = []
    files = f"camera.files={{path: '{tmp_path}'}}"
    log = SeenLog(load_config(PLATOON, ["camera.source=files", "camera.trigger=free", files]), lines.append)
    assert lines[0] == "overhead: poses from files, 1280 x 720 px; looks for tags 1 to 4"
    assert lines[1].endswith(f"poses without a run: `robofleet track {tmp_path}`")
    for now_s, tags in ((0, ()), (1, (1, 2, 3)), (10, (1, 2, 3)), (11, (1, 2, 3)), (25, (1, 2, 3, 4))):
        log.look(Observation(1, tuple(TagPose(tag, 0, 0, 0.0, 0.0, 0.0) for tag in tags), 0), now_s * S)
    assert lines[2:] == ["sees tags none; not 1 to 4", "sees tags 1 to 3; not 4", "sees tags 1 to 4"]
