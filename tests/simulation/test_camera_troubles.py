"""The simulated camera as a whole: what is configured comes at its time, in lockstep, and the same each time."""

import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TRUTH
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock, WallClock
from robofleet.simulation.sources import SimulatedCamera
from robofleet.testing import CameraContract
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import Frame
from robofleet.tracking.tags.detection import TagDetector
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import Target
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.bus.alone import Truth
from tests.contexts import context
from tests.shipped import PLATOON

PERIOD_NS = 50 * MS  # of the camera
SIDE, HEIGHT = 0.07, 0.08
V, OMEGA = 0.2, 2.0  # of the robots: all drive circles [m/s, rad/s]
CENTRES = np.array([(-1.0, 0.6), (1.0, 0.6), (-1.0, -0.6), (1.0, -0.6)])


class Stage:
    """Robots that drive circles below a camera that runs freely at 20 Hz."""

    def __init__(self, *overrides: str) -> None:
        self.config = load_config(
            PLATOON, ["camera.trigger=free", "camera.rate_hz=20", "drivers.robots_per_process=1", *overrides]
        )
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        bus: Any = MemoryBus("platoon", self.clock, 0)
        self._publish = [bus.publisher(TRUTH, robot.id) for robot in self.config.robots]
        ticks: Any = SimpleNamespace(began_ns=S + PERIOD_NS)  # at its first image
        self.camera = SimulatedCamera(context(self.config, self.clock, bus=bus, ticks=ticks))
        self.eye = CameraGeometry.from_model(self.config.camera.model)

    def where(self, row: int, instant_ns: float) -> tuple[float, float, float]:
        psi = OMEGA * (instant_ns - S) / S + row
        x, y = CENTRES[row] + V / OMEGA * np.array([math.sin(psi), -math.cos(psi)])
        return float(x), float(y), math.remainder(psi, math.tau)

    def next(self) -> tuple[Frame, int]:
        """Return the next image, and when it came [ns]."""
        ready_ns = self.camera.ready_ns()
        while self.clock.now_ns() < ready_ns:
            now_ns = min(self.clock.now_ns() + 10 * MS, ready_ns)
            self.clock.advance_to(now_ns)
            for row, publish in enumerate(self._publish):
                publish(TRUTH_LAYOUT.encode(Truth(1, now_ns, *self.where(row, now_ns), V, OMEGA)))
        frame = self.camera.read()
        return Frame(frame.image.copy(), frame.exposure_ns), self.clock.now_ns()

    def run(self, images: int) -> list[Frame]:
        return [self.next()[0] for _ in range(images)]

    def seen(self, frame: Frame, tag: int) -> list[tuple[float, float, float]]:
        """Return x, y [m], psi [rad] of all that reads as a tag, by the calibrated camera."""
        targets = [Target(tag, SIDE, HEIGHT, V)]
        found = TagDetector(PhotometricFit(self.eye, targets), targets).detect(frame.image).tags
        return [(at.centre.real, at.centre.imag, at.psi) for at in found]

    def error(self, frame: Frame, row: int, after_ns: float = 0.0) -> tuple[float, float]:
        """Return how far robot ``row`` is seen from where it is so long after mid-exposure [m, rad]."""
        ((x, y, psi),) = self.seen(frame, row + 1)
        true = self.where(row, frame.exposure_ns + after_ns)
        return math.dist((x, y), true[:2]), abs(math.remainder(psi - true[2], math.tau))


class TestContract(CameraContract):
    shape = (240, 320)

    @pytest.fixture
    def camera(self) -> SimulatedCamera:
        size = [f"camera.{part}{key}={n}" for part in ("", "model.") for key, n in (("width", 320), ("height", 240))]
        return SimulatedCamera(context(load_config(PLATOON, ["camera.trigger=free", *size]), WallClock()))


@pytest.mark.slow
def test_a_long_exposure_smears_a_robot_around_where_it_is_at_its_middle() -> None:
    stage = Stage("camera.exposure_s=0.033", "camera.noise_gray=0.5")
    sharp = Stage("camera.exposure_s=0.0001", "camera.noise_gray=0.5")
    errors = []
    for long, short in list(zip(stage.run(4), sharp.run(4), strict=True))[1:]:
        for row in range(4):
            x, y, _ = stage.where(row, long.exposure_ns)
            u, v = np.rint(stage.eye.project(np.array([[x, y, HEIGHT]]))[0]).astype(int)
            tags = (frame.image[v - 10 : v + 11, u - 10 : u + 11].astype(float) for frame in (long, short))
            smeared, clear = (sum((slope**2).sum() for slope in np.gradient(tag)) for tag in tags)
            assert smeared < 0.9 * clear
            errors.append(stage.error(long, row)[0])
    # The mean over the arc lies a third of its sagitta inside of its middle; the middle of its chord all of it.
    sagitta = V * OMEGA * 0.0165**2 / 2.0
    assert np.median(errors) < 0.6 * sagitta


@pytest.mark.slow
def test_each_row_of_a_rolling_shutter_has_its_own_instant() -> None:
    line_s = 0.02 / 720
    stage = Stage(f"camera.model.line_time_s={line_s}", "camera.readout_s=0")
    (_, first_ns), (frame, ready_ns), (_, _) = (stage.next() for _ in range(3))
    assert ready_ns - first_ns == PERIOD_NS
    assert ready_ns - frame.exposure_ns == pytest.approx((0.002 + 359.5 * line_s) * S, abs=1), "its last row is exposed"
    for row in range(4):
        x, y, _ = stage.where(row, frame.exposure_ns)
        after_ns = (stage.eye.project(np.array([[x, y, HEIGHT]]))[0, 1] - 359.5) * line_s * S
        assert abs(after_ns) > 4 * MS
        distance, turn = stage.error(frame, row, after_ns)
        assert distance < 2.5e-4
        assert turn < 5e-3
        assert stage.error(frame, row)[0] > 8e-4, "not where it is when the middle row is exposed"


@pytest.mark.slow
def test_a_frozen_camera_sends_the_same_picture_with_new_times() -> None:
    frames = Stage("camera.simulated.outages=[{kind: frozen, at_s: 0.1, duration_s: 0.19}]").run(9)
    same = [np.array_equal(a.image, b.image) for a, b in pairwise(frames)]
    assert same == [False, True, True, True, True, False, False, False]
    assert len({frame.exposure_ns for frame in frames}) == 9


def test_a_stalled_camera_sends_nothing_and_then_goes_on_in_its_own_rhythm() -> None:
    stage = Stage("camera.simulated.outages=[{kind: stalled, at_s: 0.1, duration_s: 0.33}]")
    frames = stage.run(5)
    steps = np.diff([frame.exposure_ns for frame in frames]) // PERIOD_NS
    assert steps.tolist() == [1, 8, 1, 1], "the images of 0.10 s to 0.40 s are not there"
    assert np.mod([frame.exposure_ns - frames[0].exposure_ns for frame in frames], PERIOD_NS).max() == 0
    assert stage.error(frames[2], 1)[0] < 2e-4, "the first one afterwards is a fresh one"


@pytest.mark.slow
def test_a_camera_that_stalls_for_good_and_from_the_first_image() -> None:
    stage = Stage("camera.simulated.outages=[{kind: stalled, at_s: 0, duration_s: 1.0e+8}]")
    ready_ns = stage.camera.ready_ns()
    assert ready_ns > 0.99e8 * S


def test_a_knocked_camera_sees_robots_elsewhere_from_then_on() -> None:
    stage = Stage("camera.simulated.knocks=[{at_s: 0.1, rotation_deg: [0.3, 0, 0]}]")
    frames = stage.run(4)
    before, after = (stage.error(frames[k], 0)[0] for k in (1, 2))
    assert before < 2e-4
    assert after == pytest.approx(math.radians(0.3) * 2.42, rel=0.2), "0.3 degrees, 2.42 m above the tags"


@pytest.mark.slow
def test_a_newcomer_appears_when_its_cover_goes_and_exchanged_tags_stay_exchanged() -> None:
    stage = Stage(
        "camera.simulated.covers=[{robot: r3, duration_s: 0.1}]",
        "camera.simulated.swaps=[{robots: [r1, r2], at_s: 0.1}]",
    )
    frames = stage.run(4)
    assert [len(stage.seen(frame, 3)) for frame in frames[1:]] == [0, 1, 1]
    for frame, (first, second) in zip(frames[1:], [(0, 1), (1, 0), (1, 0)], strict=True):
        for tag, row in ((1, first), (2, second)):
            ((x, y, _),) = stage.seen(frame, tag)
            assert math.dist((x, y), stage.where(row, frame.exposure_ns)[:2]) < 2e-4


EVERYTHING = (
    "camera.exposure_s=0.01", "camera.model.line_time_s=1.0e-5",
    "tracker.floor_tags=[{tag: 40, side_m: 0.1, x_m: 0, y_m: 0}]",
    "camera.simulated={light: 0.5, jpeg_quality: 70, projector_gray: 30,"
    " cables: [{points_px: [[0, 0], [1279, 719]]}], glare: [{at_px: [300, 300], radius_px: 30}],"
    " posters: [{tag: 1, side_m: 0.07, x_m: 0.3, y_m: 0.1}], covers: [{robot: r1, duration_s: 0.05}],"
    " swaps: [{robots: [r2, r3], at_s: 0.1}], outages: [{kind: frozen, at_s: 0.15, duration_s: 0.1}],"
    " knocks: [{at_s: 0, over_s: 2, rotation_deg: [0, 0, 1]}], tag_offsets: [{robot: r4, left_m: 0.01}]}",
)  # fmt: skip


@pytest.mark.slow
def test_all_of_it_at_once_is_the_same_each_time() -> None:
    first, again = (Stage(*EVERYTHING).run(6) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert a.exposure_ns == b.exposure_ns
        assert np.array_equal(a.image, b.image)
