"""The tracker's step alone: when it looks, how it says when that was, and whose camera it looks through."""

import threading
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import Any, ClassVar

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, POSES, TICK
from robofleet.bus.messages import TickRecord
from robofleet.core.clock import MS, S
from robofleet.simulation.scene import scene_renderer
from robofleet.tracking.sources import CameraContext, Frame
from tests.nodes.tracker_stand import TICK_NS, TrackerStand

Make = Callable[..., Any]
LEAD_NS = 18 * MS


class Stand(TrackerStand):
    """``woken`` is set when something wakes the tracker."""

    def __init__(self, bench: Any) -> None:
        self.woken = threading.Event()
        super().__init__(bench, wake=lambda _: self.woken.set())


@pytest.fixture
def stand_of(bench_of: Make, platoon_of: Make) -> Callable[..., Stand]:
    exact = ["tracker.truth={delay_s: 0.005}", f"camera.trigger_lead_s={LEAD_NS / S}"]
    return lambda *overrides: Stand(bench_of(platoon_of(*exact, *overrides)))


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


class BlockingCamera:
    """A camera as a user writes one: its read waits, and it stands in no package."""

    feed: ClassVar[SimpleQueue[Frame | None]]
    closed: ClassVar[int]
    context: ClassVar[CameraContext]

    def __init__(self, context: CameraContext) -> None:
        type(self).context = context

    def read(self) -> Frame:
        frame = self.feed.get(timeout=10)
        if frame is None:
            raise EOFError
        return frame

    def close(self) -> None:
        type(self).closed += 1
        self.feed.put(None)


@pytest.fixture
def blocking(stand_of: Make) -> Iterator[Stand]:
    BlockingCamera.feed, BlockingCamera.closed = SimpleQueue(), 0
    stand: Stand = stand_of("camera.trigger=free", f"camera.source='{__name__}:BlockingCamera'")
    yield stand
    BlockingCamera.feed.put(None)


def image(stand: Stand) -> np.ndarray:
    """Return what the overhead camera would see of the robots at their start."""
    config = stand.bench.config
    renderer = scene_renderer(config, np.random.default_rng(1))
    return renderer.render(np.array([[robot.start.x_m, robot.start.y_m, robot.start.psi] for robot in config.robots]))


def test_any_camera_is_read_in_a_thread_of_its_own(blocking: Stand) -> None:
    blocking.run(S // 10)
    assert blocking.bench.heard(POSES, CAMERA) == [], "a camera that has no image holds nobody up"
    exposure_ns = blocking.bench.now_ns - 5 * MS
    blocking.woken.clear()
    BlockingCamera.feed.put(Frame(image(blocking), exposure_ns))
    assert blocking.woken.wait(10), "an image wakes the tracker"
    blocking.node.step(blocking.bench.now_ns)
    (frame,) = blocking.bench.heard(POSES, CAMERA)
    assert frame.exposure_ns == exposure_ns
    assert {pose.tag for pose in frame.poses} == {1, 2, 3, 4}
    for pose in frame.poses:
        start = blocking.bench.config.robots[pose.tag - 1].start
        assert np.hypot(pose.x_m - start.x_m, pose.y_m - start.y_m) < 1e-3
    blocking.node.step(blocking.bench.now_ns)
    assert len(blocking.bench.heard(POSES, CAMERA)) == 1, "an image is used once"


def test_a_camera_that_ends_ends_quietly(blocking: Stand) -> None:
    BlockingCamera.feed.put(None)
    blocking.run(S // 2)
    assert blocking.bench.heard(POSES, CAMERA) == []
    blocking.node.close()
    assert BlockingCamera.closed == 1


def test_a_camera_is_told_what_it_is_made_from(blocking: Stand) -> None:
    assert BlockingCamera.context.config is blocking.bench.config
    assert BlockingCamera.context.clock is blocking.bench.clock
