"""Poses without pixels, and the rendered camera: noise, delay, dropout, triggers."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TRUTH
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.nodes.pose_sources import TruthPoses
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.sources import ScheduledCamera
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.bus.alone import Truth
from tests.contexts import context
from tests.shipped import PLATOON

TICK_NS = 33 * MS
LEAD_NS = 18 * MS
SPEED = 0.05  # of a robot, times its row [m/s]


class Floor:
    """Robots that drive straight on, each at its own speed, on a bus without delay."""

    def __init__(self, *overrides: str) -> None:
        self.config = load_config(
            PLATOON, [f"camera.trigger_lead_s={LEAD_NS / S}", "drivers.robots_per_process=1", *overrides]
        )
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        self.bus = MemoryBus("platoon", self.clock, 0)
        self.ticks: Any = SimpleNamespace(newest=0, newest_stamp_ns=0, began_ns=0, update=lambda: None)
        self.silent: set[str] = set()
        self.nowhere: set[str] = set()  # who say that they are at NaN
        self.rng = np.random.default_rng(1)

    def source(self) -> TruthPoses:
        return TruthPoses(context(self.config, self.clock, bus=self.bus, ticks=self.ticks, rng=self.rng))

    def camera(self) -> SimulatedCamera:
        return SimulatedCamera(context(self.config, self.clock, bus=self.bus, ticks=self.ticks, rng=self.rng))

    def where(self, row: int, instant_ns: int) -> tuple[float, float, float]:
        start = self.config.robots[row].start
        driven = SPEED * row * (instant_ns - S) / S
        return start.x_m + driven * math.cos(start.psi), start.y_m + driven * math.sin(start.psi), start.psi

    def drive_to(self, instant_ns: int) -> None:
        """Let time pass; every robot says every 10 ms where it is."""
        while self.clock.now_ns() < instant_ns:
            self.clock.advance_to(min(self.clock.now_ns() + 10 * MS, instant_ns))
            now_ns = self.clock.now_ns()
            for row, robot in enumerate(self.config.robots):
                if robot.id not in self.silent:
                    at = (math.nan,) * 3 if robot.id in self.nowhere else self.where(row, now_ns)
                    message = Truth(1, now_ns, *at, SPEED * row, 0.0)
                    self.bus.publisher(TRUTH, robot.id)(TRUTH_LAYOUT.encode(message))

    def tick(self) -> None:
        self.ticks.newest += 1
        self.ticks.newest_stamp_ns = self.clock.now_ns()

    def observe(self, source: TruthPoses | SimulatedCamera, ticks: int) -> list[Any]:
        """Let the controller tick; return what the source says of each."""
        seen = []
        for _ in range(ticks):
            self.tick()
            seen.append(self.read(source))
            self.drive_to(self.ticks.newest_stamp_ns + TICK_NS)
        return seen

    def read(self, source: TruthPoses | SimulatedCamera) -> Any:
        """Return the next observation or image, when it is there."""
        ready_ns = source.ready_ns() if isinstance(source, SimulatedCamera) else source.next_ns()
        self.drive_to(ready_ns)
        return source.read() if isinstance(source, SimulatedCamera) else source.observe(self.clock.now_ns())


def errors(floor: Floor, seen: list[Any]) -> np.ndarray:
    """Return pose minus truth at mid-exposure, (poses, 3)."""
    return np.array(
        [
            np.subtract((pose.x_m, pose.y_m, pose.psi_rad), floor.where(pose.tag - 1, observed.exposure_ns))
            for observed in seen
            for pose in observed.poses
        ]
    )


def test_noise_is_as_configured() -> None:
    floor = Floor("tracker.truth={position_noise_m: 0.002, heading_noise_rad: 0.03}")
    found = errors(floor, floor.observe(floor.source(), 500))
    assert found.std(axis=0) == pytest.approx([0.002, 0.002, 0.03], rel=0.1)
    assert np.abs(found.mean(axis=0) / [0.002, 0.002, 0.03]).max() < 0.1
    assert np.abs(np.corrcoef(found.T) - np.eye(3)).max() < 0.1


@pytest.mark.slow
def test_dropout_is_as_configured_and_each_robots_own() -> None:
    floor = Floor("tracker.truth={dropout: 0.25}")
    seen = floor.observe(floor.source(), 500)
    present = np.array([[tag in [pose[0] for pose in o.poses] for tag in (1, 2, 3, 4)] for o in seen])
    assert present.mean(axis=0) == pytest.approx([0.75] * 4, abs=0.07)
    assert np.abs(np.corrcoef(present.T) - np.eye(4)).max() < 0.2


def test_delay_and_jitter_are_as_configured() -> None:
    floor = Floor("tracker.truth={delay_s: 0.006, jitter_s: 0.004}")
    source, delays = floor.source(), []
    for _ in range(200):
        floor.tick()
        floor.read(source)
        delays.append(floor.clock.now_ns() - (floor.ticks.newest_stamp_ns + TICK_NS - LEAD_NS))
        floor.drive_to(floor.ticks.newest_stamp_ns + TICK_NS)
    assert 6 * MS <= min(delays) < 6.5 * MS
    assert 9.5 * MS < max(delays) <= 10 * MS


def test_a_robot_that_never_spoke_is_not_seen() -> None:
    floor = Floor("tracker.truth={}")
    floor.silent.add("r3")
    seen = floor.observe(floor.source(), 3)
    assert [pose[0] for pose in seen[-1].poses] == [1, 2, 4]


@pytest.mark.parametrize("how", ["silent", "not a number"])
def test_a_robot_that_does_not_say_any_more_where_it_is_is_not_seen(how: str) -> None:
    """For 100 ms it is taken to have gone on, and no longer."""
    floor = Floor("tracker.truth={delay_s: 0.01}")
    source = floor.source()
    floor.observe(source, 3)
    last_ns = floor.clock.now_ns()
    (floor.silent if how == "silent" else floor.nowhere).add("r3")
    seen = floor.observe(source, 6)
    for observed in seen:
        expected = [1, 2, 3, 4] if observed.exposure_ns <= last_ns + 100 * MS else [1, 2, 4]
        assert [pose.tag for pose in observed.poses] == expected
    assert len(seen[-1].poses) == 3
    assert len(seen[0].poses) == 4


@pytest.mark.slow
def test_the_cameras_images_come_after_exposure_and_readout() -> None:
    floor = Floor("camera.exposure_s=0.006", "camera.readout_s=0.005")
    camera = floor.camera()
    assert isinstance(camera, ScheduledCamera)
    assert camera.ready_ns() is None
    floor.tick()
    exposure_ns = floor.ticks.newest_stamp_ns + TICK_NS - LEAD_NS
    assert camera.ready_ns() == exposure_ns + 3 * MS + 5 * MS
    assert floor.read(camera).exposure_ns == exposure_ns
    assert camera.ready_ns() is None, "one image a tick"


@pytest.mark.slow
def test_a_robot_that_never_spoke_is_not_drawn() -> None:
    images = []
    for silent in ("", "r2"):
        floor = Floor()
        floor.silent.add(silent)
        images.append(floor.observe(floor.camera(), 1)[0].image.astype(int))
    changed = np.abs(images[0] - images[1]) > 60
    assert changed.sum() > 200
    rows, columns = np.nonzero(changed)
    assert np.ptp(rows) < 80
    assert np.ptp(columns) < 80


@pytest.mark.slow
def test_a_robot_that_stands_in_no_arena_is_not_drawn() -> None:
    absent, silent = Floor("robots.1.reality=simulated"), Floor()
    silent.silent.add("r2")
    first, other = (floor.observe(floor.camera(), 1)[0].image for floor in (absent, silent))
    assert np.array_equal(first, other)


@pytest.mark.parametrize("kind", ["truth", "camera"])
def test_a_camera_of_its_own_clock_skips_the_images_that_nobody_took(kind: str) -> None:
    floor = Floor("camera.trigger=free", "camera.rate_hz=50", "tracker.truth={delay_s: 0.005}")
    source = floor.source() if kind == "truth" else floor.camera()
    first = floor.read(source).exposure_ns
    assert first == S + 20 * MS
    floor.drive_to(S + 500 * MS)
    late = floor.read(source).exposure_ns
    assert late == first + 20 * MS, "it was exposed in time, and is read late"
    following = floor.read(source).exposure_ns
    assert (following - first) % (20 * MS) == 0
    assert floor.clock.now_ns() - 20 * MS <= following <= floor.clock.now_ns() + 20 * MS
