"""A camera that is knocked or warms up, and floor tags that are hidden or kicked: sightings without pixels.

The true camera projects a landmark's centre and two points of it; the geometry in use places them; noise is added.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.calibrated import FloorTag
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.camera_motion import pose_covariance, sensitivity
from robofleet.tracking.drift import DriftMonitor
from robofleet.tracking.events import NO_TAG, Notice, TrackerEvent
from robofleet.tracking.tags.tracker import TagSighting
from tests.shipped import OVERHEAD

CALIBRATED = CameraGeometry.from_model(OVERHEAD)

CORNERS = [(-1.5, -0.9), (1.5, -0.9), (1.5, 0.9), (-1.5, 0.9)]
EDGES = [(0.0, 0.9), (0.0, -0.9), (1.5, 0.0), (-1.5, 0.0)]
ROBOTS_M = 0.08  # height of the robots' tags
SIGMA = 3e-5  # of a sighting [m]
HEADING = 30.0  # its heading's [rad/m]
SURVEY = np.array([5e-4, 5e-4, math.radians(0.5)])
SECOND = 30  # images

Array = NDArray[np.float64]


def moved(
    x_deg: float = 0.0, y_deg: float = 0.0, z_deg: float = 0.0, shift: tuple[float, ...] = (0, 0, 0), focal: float = 1.0
) -> CameraGeometry:
    """The calibrated camera, turned about the world's axes, shifted [m] and its focal length multiplied."""
    T, K = CALIBRATED.T_world_camera.copy(), CALIBRATED.K.copy()
    T[:3, :3] = cv2.Rodrigues(np.radians([x_deg, y_deg, z_deg]))[0] @ T[:3, :3]
    T[:3, 3] += shift
    K[:2, :2] *= focal
    return CameraGeometry(K, CALIBRATED.distortion, T)


def arena() -> Array:
    x, y = np.meshgrid(np.linspace(-1.6, 1.6, 17), np.linspace(-1.0, 1.0, 11))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, ROBOTS_M)])


ARENA = arena()


def error_mm(true: CameraGeometry, used: CameraGeometry) -> float:
    """How far robots all over the arena are placed from where they are, rms."""
    off = used.to_plane(true.project(ARENA), ROBOTS_M) - ARENA[:, :2]
    return 1e3 * math.sqrt((off**2).sum(1).mean())


class Lab:
    """Floor tags, surveyed to half a millimetre, a camera, and the monitor."""

    def __init__(
        self, places: Sequence[tuple[float, float]], sigma: float = SIGMA, used: CameraGeometry = CALIBRATED
    ) -> None:
        self._rng, self._sigma, self.used = np.random.default_rng(len(places)), sigma, used
        headings_deg = [math.degrees(math.remainder(0.7 * i, math.tau)) for i in range(len(places))]
        marks = [
            FloorTag(tag=100 + i, side_m=0.1, x_m=x, y_m=y, heading_deg=heading_deg)
            for i, ((x, y), heading_deg) in enumerate(zip(places, headings_deg, strict=True))
        ]
        self.tags = np.column_stack([places, np.radians(headings_deg)])
        self.tags += self._rng.normal(0, 1, self.tags.shape) * SURVEY
        self.monitor = DriftMonitor(used, marks)
        self.news: list[Notice] = []
        self.given = 0

    def see(self, true: CameraGeometry, images: int = 1, hidden: Sequence[int] = ()) -> None:
        for _ in range(images):
            x, y, psi = self.tags.T
            arm = 0.02
            ends = np.column_stack([x + arm * np.cos(psi), y + arm * np.sin(psi), 0 * x])
            points = np.vstack([np.column_stack([x, y, 0 * x]), ends])
            centres, ends = self.monitor.geometry.to_plane(true.project(points), 0.0).reshape(2, -1, 2)
            headings = np.arctan2(ends[:, 1] - centres[:, 1], ends[:, 0] - centres[:, 0])
            self.show(np.column_stack([centres, headings]), hidden)

    def show(self, poses: Array, hidden: Sequence[int] = ()) -> None:
        """Give the monitor poses (L, 3) with noise."""
        noisy = poses + self._rng.normal(0, self._sigma, poses.shape) * [1.0, 1.0, HEADING]
        rows = [i for i in range(len(noisy)) if i not in hidden]
        spread = (self._sigma**2, 0.0, self._sigma**2, 0.0, 0.0, (self._sigma * HEADING) ** 2)
        geometry, news = self.monitor.update([TagSighting(100 + i, *noisy[i].tolist(), 0, 0, spread) for i in rows])
        self.news += news
        self.given += geometry is not self.used
        self.used = geometry

    def events(self) -> list[TrackerEvent]:
        return [happening.event for happening in self.news]


def calm(*what: Any, **others: Any) -> Lab:
    """Return a lab whose camera has been at rest for a second."""
    lab = Lab(*what, **others)
    lab.see(CALIBRATED, SECOND)
    return lab


KNOCKS = {
    "tilt": moved(0.3),
    "tilt, roll and turn": moved(0.15, -0.2, 0.2),
    "turned and shifted, as about a joint 10 cm away": moved(0.2, shift=(0.0, 0.4e-3, -0.3e-3)),
    "shift": moved(shift=(5e-3, -3e-3, 0.0)),
    "height": moved(0.1, shift=(0.0, 0.0, 2e-3)),
    "almost out of bounds": moved(0.8),
}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("places", [CORNERS, CORNERS + EDGES], ids=["4 tags", "8 tags"])
@pytest.mark.parametrize("true", KNOCKS.values(), ids=KNOCKS.keys())
def test_a_knock_is_told_within_three_images_and_corrected(
    places: list[tuple[float, float]], true: CameraGeometry
) -> None:
    lab = Lab(places)
    lab.see(CALIBRATED, 2 * SECOND)
    assert (lab.news, lab.used, lab.monitor.trusted) == ([], CALIBRATED, True)
    lab.see(true)
    assert not lab.monitor.trusted
    lab.see(true, 2)
    ((event, tag, value),) = lab.news
    assert (event, tag) == (TrackerEvent.CAMERA_CORRECTED, NO_TAG)
    marks = np.column_stack([places, np.zeros(len(places))])
    off = np.hypot(*(CALIBRATED.to_plane(true.project(marks), 0.0) - places).T)
    assert value == pytest.approx(off.max(), abs=5e-4)
    assert lab.monitor.trusted
    lab.see(true, 12)
    assert error_mm(true, lab.used) < 0.1
    assert lab.events() == [TrackerEvent.CAMERA_CORRECTED]  # not again


@pytest.mark.slow
def test_any_knock_that_four_landmarks_see() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        lab = Lab(CORNERS, sigma=float(rng.choice([1e-6, 3e-5, 1e-4])))
        lab.see(CALIBRATED, SECOND)
        true = moved(*rng.uniform(-0.35, 0.35, 3), shift=rng.normal(0.0, 1e-3, 3), focal=1.0 + rng.normal(0.0, 2e-4))
        lab.see(true, 6)
        assert lab.monitor.trusted
        assert error_mm(true, lab.used) < 0.3


def test_two_landmarks_correct_most_of_a_knock() -> None:
    lab = calm(CORNERS[:2])
    lab.see(KNOCKS["tilt"], SECOND // 2)
    assert lab.events() == [TrackerEvent.CAMERA_CORRECTED]
    assert error_mm(KNOCKS["tilt"], CALIBRATED) > 10.0
    assert error_mm(KNOCKS["tilt"], lab.used) < 0.5


def test_fisheye() -> None:
    lens = [0.02, -0.01, 0.003, 0.0]
    straight, tilted = (
        CameraGeometry(camera.K, lens, camera.T_world_camera, "fisheye") for camera in (CALIBRATED, moved(0.3))
    )
    lab = Lab(CORNERS, used=straight)
    lab.see(straight, SECOND)
    lab.see(tilted, SECOND // 2)
    assert error_mm(tilted, straight) > 10.0
    assert error_mm(tilted, lab.used) < 0.1


WARMING: dict[str, Callable[[float], CameraGeometry]] = {
    "tilt": lambda minutes: moved(0.1145 * minutes),  # 5 mm a minute on the floor
    "focal length": lambda minutes: moved(focal=1.0 + 3e-3 * minutes),  # the same at the corners
    "all": lambda minutes: moved(0.05 * minutes, 0.0, 0.05 * minutes, (0, 0, 1e-3 * minutes), 1.0 - 1e-3 * minutes),
}


@pytest.mark.slow
@pytest.mark.parametrize("true", WARMING.values(), ids=WARMING.keys())
def test_slow_drift_is_followed(true: Callable[[float], CameraGeometry]) -> None:
    lab, errors, minute = Lab(CORNERS), [], 60 * SECOND
    for k in range(minute):
        lab.see(true(k / minute))
        if k % 10 == 0:
            errors.append(error_mm(true(k / minute), lab.used))
    assert max(errors) < 0.1
    assert error_mm(true(1.0), CALIBRATED) > 2.0
    assert set(lab.events()) == {TrackerEvent.CAMERA_CORRECTED}
    drifts = [value for _, _, value in lab.news]
    assert np.diff(drifts) == pytest.approx(1e-3, abs=3e-4)  # not again before a millimetre
    assert lab.monitor.trusted


@pytest.mark.parametrize("kicked", [1, 2])
def test_a_tag_that_was_kicked_away_is_named_and_moves_nothing(kicked: int) -> None:
    lab = calm(CORNERS)
    ways = np.array([[0.012, -0.005, 0.2], [0.0, 0.3, -2.0]])[:kicked]
    lab.tags[:kicked] += ways
    lab.see(CALIBRATED, 3 * SECOND)
    assert lab.events() == [TrackerEvent.TAG_JUMPED] * kicked
    for (_, tag, value), row, way in zip(lab.news, itertools.count(), ways, strict=False):
        assert tag == 100 + row
        assert value == pytest.approx(math.hypot(*way[:2]), abs=3e-4)
    lab.see(CALIBRATED, SECOND, hidden=(3,))  # of those that are left, most lie still
    assert (lab.monitor.trusted, len(lab.news)) == (True, kicked)
    assert error_mm(CALIBRATED, lab.used) < 0.05


def test_half_of_the_tags_are_no_majority() -> None:
    lab = calm(CORNERS + EDGES)
    points = np.column_stack([lab.tags[:4, :2], np.zeros(4)])
    lab.tags[:4, :2] = CALIBRATED.to_plane(KNOCKS["tilt"].project(points), 0.0)  # as if the camera had been knocked
    lab.tags[4] += [0.0, -0.03, 0.2]
    lab.see(CALIBRATED, 2 * SECOND)
    assert (lab.events(), lab.used, lab.monitor.trusted) == ([TrackerEvent.CAMERA_MOVED], CALIBRATED, False)


@pytest.mark.slow
def test_shadows_on_a_tag_hardly_move_the_camera() -> None:
    lab = Lab(CORNERS)
    lab.see(CALIBRATED, 6 * SECOND)
    for k in range(600):
        lab.tags[2, 0] += (k % 60 == 0) * 2e-4 - (k % 60 == 30) * 2e-4
        lab.see(CALIBRATED)
        assert error_mm(CALIBRATED, lab.used) < 0.05
    assert lab.news == []


def test_a_tag_that_creeps_away_is_named() -> None:
    lab = calm(CORNERS)
    for _ in range(4 * SECOND):  # a robot pushes it at 2 mm/s
        lab.tags[2, 0] += 2e-3 / SECOND
        lab.see(CALIBRATED)
    assert [(event, tag) for event, tag, _ in lab.news] == [(TrackerEvent.TAG_JUMPED, 102)]
    assert error_mm(CALIBRATED, lab.used) < 0.05


def test_a_kicked_tag_is_used_again_when_it_lies_where_it_was() -> None:
    lab = calm(CORNERS)
    home = lab.tags.copy()
    lab.tags[0, 0] += 0.02
    lab.see(CALIBRATED, SECOND)
    lab.tags = home
    lab.see(CALIBRATED, 2 * SECOND)
    lab.see(KNOCKS["tilt"], SECOND, hidden=(1,))  # three are left with it, two without
    assert error_mm(KNOCKS["tilt"], lab.used) < 0.1
    lab.tags[0, 0] += 0.02
    lab.see(KNOCKS["tilt"], SECOND)
    assert [tag for event, tag, _ in lab.news if event == TrackerEvent.TAG_JUMPED] == [100, 100]


def test_a_kicked_tag_alone_witnesses_nothing_until_it_lies_where_it_was() -> None:
    lab = calm(CORNERS)
    home = lab.tags.copy()
    lab.tags[0, 0] += 0.02
    lab.see(CALIBRATED, SECOND)
    assert lab.monitor.floor_seen
    lab.see(KNOCKS["tilt"], 3, hidden=(1, 2, 3))
    assert not lab.monitor.floor_seen
    lab.tags = home
    lab.see(CALIBRATED, 2 * SECOND, hidden=(1, 2, 3))
    assert lab.monitor.floor_seen


def test_while_a_small_knock_is_not_explained_nobody_is_sure_and_then_it_is_told() -> None:
    lab, true = Lab(CORNERS[:1]), moved(0.06)
    lab.see(CALIBRATED, SECOND)
    for _ in range(SECOND - 1):
        lab.see(true)
        assert lab.monitor.trusted
        off = lab.used.to_plane(true.project(ARENA), ROBOTS_M) - ARENA[:, :2]
        spread = lab.monitor.covariance(ARENA)[:, :2, :2]
        assert (np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off) < 9.0).all()
    assert lab.news == []
    lab.see(true)
    assert (lab.events(), lab.monitor.trusted) == ([TrackerEvent.CAMERA_MOVED], False)


def test_knocked_while_some_are_hidden_and_one_is_kicked() -> None:
    lab = Lab(CORNERS + EDGES)
    lab.see(CALIBRATED, SECOND, hidden=(0, 5))
    lab.tags[2] += [-0.003, -0.008, 0.1]
    lab.see(KNOCKS["tilt"], 3, hidden=(0, 5))
    assert lab.events() == [TrackerEvent.CAMERA_CORRECTED]
    lab.see(KNOCKS["tilt"], SECOND, hidden=(0, 5))
    assert lab.events() == [TrackerEvent.CAMERA_CORRECTED, TrackerEvent.TAG_JUMPED]
    assert error_mm(KNOCKS["tilt"], lab.used) < 0.1


def test_one_landmark_alone_cannot_tell_what_moved() -> None:
    lab = calm(CORNERS)
    lab.see(KNOCKS["tilt"], 2 * SECOND, hidden=(0, 1, 2))
    assert (lab.events(), lab.monitor.trusted, lab.used) == ([TrackerEvent.CAMERA_MOVED], False, CALIBRATED)
    lab.see(KNOCKS["tilt"], 3)  # the others are back
    assert (lab.events()[1:], lab.monitor.trusted) == ([TrackerEvent.CAMERA_CORRECTED], True)
    assert error_mm(KNOCKS["tilt"], lab.used) < 0.1
    for true in (CALIBRATED, KNOCKS["tilt"], CALIBRATED):  # not told when it is over soon
        lab.see(true, SECOND - 5, hidden=(0, 1, 2))
        lab.see(true, SECOND)
    assert lab.events()[2:] == [TrackerEvent.CAMERA_CORRECTED] * 3


@pytest.mark.parametrize("tilt_deg", [1.5, 5.0, -20.0])
def test_further_out_than_is_corrected(tilt_deg: float) -> None:
    lab, out = Lab(CORNERS + EDGES), moved(tilt_deg)
    lab.see(CALIBRATED, SECOND)
    lab.see(out, 4)
    ((event, tag, value),) = lab.news
    assert (event, tag) == (TrackerEvent.CAMERA_MOVED, NO_TAG)
    assert value > 0.05
    lab.see(out, 3 * SECOND)
    assert (lab.monitor.trusted, lab.used, len(lab.news)) == (False, CALIBRATED, 1)
    lab.see(KNOCKS["shift"], 3)  # put right, nearly
    assert (lab.monitor.trusted, lab.events()[1:]) == (True, [TrackerEvent.CAMERA_CORRECTED])
    lab.see(KNOCKS["shift"], 3)
    assert error_mm(KNOCKS["shift"], lab.used) < 0.1


def test_out_already_at_the_beginning() -> None:
    lab = Lab(CORNERS + EDGES)
    lab.see(KNOCKS["tilt"])
    assert not lab.monitor.trusted
    lab.see(KNOCKS["tilt"], SECOND)
    assert (lab.events(), lab.monitor.trusted) == ([TrackerEvent.CAMERA_CORRECTED], True)
    assert error_mm(KNOCKS["tilt"], lab.used) < 0.7  # as good as the survey
    far = Lab(CORNERS + EDGES)
    far.see(moved(3.0), 3)
    assert (far.events(), far.monitor.trusted) == ([TrackerEvent.CAMERA_MOVED], False)


def test_a_tag_that_lay_elsewhere_from_the_beginning() -> None:
    lab = Lab(CORNERS)
    lab.tags[3, 1] += 0.01
    lab.see(CALIBRATED, SECOND)
    assert [(event, tag) for event, tag, _ in lab.news] == [(TrackerEvent.TAG_JUMPED, 103)]
    assert (lab.monitor.trusted, lab.used) == (True, CALIBRATED)


def test_a_strange_image_and_a_swing_are_not_believed() -> None:
    lab = calm(CORNERS)
    lab.see(KNOCKS["tilt"], 2)
    lab.see(CALIBRATED, SECOND)
    assert (lab.news, lab.monitor.trusted) == ([], True)
    assert error_mm(CALIBRATED, lab.used) < 0.1
    for k in range(4 * SECOND):  # 3 Hz, decaying from 10 mm in a second
        lab.see(true := moved(0.23 * math.sin(0.6 * k) * math.exp(-k / SECOND)))
        assert not lab.monitor.trusted or error_mm(true, lab.used) < 4.0
    lab.see(CALIBRATED, SECOND)
    assert lab.monitor.trusted
    assert error_mm(CALIBRATED, lab.used) < 0.1


def test_predictions_and_strangers_are_no_sightings() -> None:
    lab = calm(CORNERS)
    far = [TagSighting(100 + i, 0.0, 0.0, 0.0, 0, 1) for i in range(4)] + [TagSighting(1, 0.0, 0.0, 0.0, 0, 0)]
    assert all(lab.monitor.update(far) == (CALIBRATED, ()) for _ in range(3 * SECOND))
    assert lab.monitor.trusted
    assert DriftMonitor(CALIBRATED, []).update(far) == (CALIBRATED, ())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("places", "sigma", "images"),
    [
        (CORNERS + EDGES, SIGMA, 2000), (CORNERS, SIGMA, 2000), (CORNERS[:2], SIGMA, 1000), (CORNERS, 2e-4, 1000),
        pytest.param(CORNERS + EDGES, SIGMA, 20_000, marks=pytest.mark.long),
        pytest.param(CORNERS, SIGMA, 10_000, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_noise_and_robots_that_hide_tags_are_no_news(
    places: list[tuple[float, float]], sigma: float, images: int
) -> None:
    lab, rng, n = Lab(places, sigma), np.random.default_rng(5), len(places)
    pixels = CALIBRATED.project(np.column_stack([lab.tags[:, :2], np.zeros(n)]))
    poses, used, until = lab.tags.copy(), CALIBRATED, np.zeros(n)
    for k in range(images):
        begins = rng.random(n) < 0.004  # a robot drives over it, for up to ten seconds
        until[begins] = k + rng.integers(5, 300, np.count_nonzero(begins))
        if lab.monitor.geometry is not used:
            used = lab.monitor.geometry
            poses[:, :2] = used.to_plane(pixels, 0.0)
        if k % 10 == 0:
            assert error_mm(CALIBRATED, lab.used) < 0.1 * max(1.0, sigma / 1e-4)
        lab.show(poses, np.flatnonzero(until > k).tolist())
        assert lab.monitor.trusted
    assert lab.news == []
    assert lab.given < (images / 40 if n > 2 else 1)  # geometries change for reasons


def shaken(deg: float, k: int, axes: tuple[float, ...] = (1.0, 1.0, 1.0)) -> CameraGeometry:
    """The camera in image ``k`` while it turns at 7 Hz."""
    return moved(*(deg * math.sin(math.tau * 7.0 * k / SECOND + 0.4) * np.array(axes)))


@pytest.mark.slow
@pytest.mark.parametrize("axes", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)], ids=["x", "z", "all"])
@pytest.mark.parametrize("deg", [0.02, 0.05])
def test_every_image_of_a_camera_that_vibrates_has_its_own_correction(deg: float, axes: tuple[float, ...]) -> None:
    lab, errors = Lab(CORNERS), []
    lab.see(CALIBRATED, SECOND)
    for k in range(3 * SECOND):
        lab.see(true := shaken(deg, k, axes))
        if k >= 5:  # at first it may be a knock
            assert lab.monitor.trusted, k
            errors.append(error_mm(true, lab.used))
    assert max(errors) < 0.15
    assert max(error_mm(shaken(deg, k, axes), CALIBRATED) for k in range(SECOND)) > 0.35
    lab.see(CALIBRATED, 10 * SECOND)  # it came to rest
    assert error_mm(CALIBRATED, lab.used) < 0.05


@pytest.mark.slow
def test_a_camera_that_vibrates_from_the_beginning() -> None:
    lab = Lab(CORNERS)
    errors = []
    for k in range(10 * SECOND):
        lab.see(true := shaken(0.05, k))
        errors.append(error_mm(true, lab.used))
        assert lab.monitor.trusted or k < 10
    assert max(errors[5 * SECOND :]) < 0.2
    assert max(error_mm(shaken(0.05, k), CALIBRATED) for k in range(SECOND)) > 3.0


def test_a_knock_of_a_camera_that_vibrates() -> None:
    lab = calm(CORNERS)
    knock = KNOCKS["tilt"].T_world_camera[:3, :3] @ CALIBRATED.T_world_camera[:3, :3].T
    for k in range(3 * SECOND):
        true = shaken(0.02, k)
        if k >= SECOND:
            T = true.T_world_camera.copy()
            T[:3, :3] = knock @ T[:3, :3]
            true = true.moved(T)
        lab.see(true)
        if not SECOND <= k < SECOND + 5:
            assert lab.monitor.trusted, k
            assert error_mm(true, lab.used) < 0.3, k
    assert TrackerEvent.CAMERA_CORRECTED in lab.events()


@pytest.mark.slow
@pytest.mark.parametrize("seconds_at_rest", [0, 1])
@pytest.mark.parametrize("share", [0.001, 0.0025, 0.005])
def test_a_lens_that_breathes_is_followed(share: float, seconds_at_rest: int) -> None:
    lab, errors = Lab(CORNERS), []
    lab.see(CALIBRATED, seconds_at_rest * SECOND)
    for k in range(4 * SECOND):
        lab.see(
            true := moved(focal=1.0 + share * math.sin(math.tau * k / (1.3 * SECOND) + 0.4 * (seconds_at_rest == 0)))
        )
        if k >= SECOND // 2:
            assert lab.monitor.trusted, k
            errors.append(error_mm(true, lab.used))
    assert max(errors) < (0.05 if seconds_at_rest else 0.5)  # relative to the calibration; else as good as the survey
    assert TrackerEvent.CAMERA_BREATHES in lab.events()
    assert TrackerEvent.TAG_JUMPED not in lab.events()
    still = lab.used
    lab.see(CALIBRATED, 5 * SECOND)
    assert error_mm(CALIBRATED, lab.used) < (0.05 if seconds_at_rest else 0.5)
    assert still is not lab.used


@pytest.mark.slow
def test_the_uncertainty_of_an_images_camera_is_true() -> None:
    lab, squares = Lab(CORNERS), []
    points = np.array([(-1.0, 0.5, ROBOTS_M), (0.3, -0.4, ROBOTS_M), (1.2, 0.2, ROBOTS_M)])
    lab.see(CALIBRATED, SECOND)
    for k in range(20 * SECOND):
        lab.see(true := shaken(0.03, k))
        if k >= 5 * SECOND:
            off = lab.used.to_plane(true.project(points), ROBOTS_M) - points[:, :2]
            spread = lab.monitor.covariance(points)
            squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread[:, :2, :2]), off))
    assert 0.5 < np.mean(squares) / 2.0 < 2.0  # of a degree of freedom


def test_what_a_camera_does_to_poses_is_that_of_its_whole_model() -> None:
    points, rng = np.array([(-1.4, 0.8, ROBOTS_M), (0.3, -0.4, ROBOTS_M), (1.2, 0.2, 0.0)]), np.random.default_rng(0)
    rows = sensitivity(CALIBRATED, points).reshape(3, 3, 6)
    parts = 1e-4 * rng.normal(0.0, 1.0, (6, 6))
    spread = pose_covariance(CALIBRATED, points, parts @ parts.T)
    expected = rows @ parts @ parts.T @ rows.transpose(0, 2, 1)
    assert np.abs(spread - expected).max() < 0.05 * expected.max()  # a focal length is a little less of a barrel
