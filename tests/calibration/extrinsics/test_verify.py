"""Is the camera where it was? Judged from marks whose truth is known."""

import math

import numpy as np
import pytest

from robofleet.calibration.extrinsics import verify
from robofleet.calibration.extrinsics.consensus import agree, chance
from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.placing import Lens, moved
from robofleet.calibration.extrinsics.verify import Calibrated, Verdict, judge
from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import SeenMark
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry
from tests.calibration.extrinsics.test_arena import CAMERA, DOWN, SIZE, SURVEY_M

LENS_SIGMA = np.array([1.5, 1.5, 3.0, 3.0, 4e-3, 6e-3, 4e-4, 4e-4, 3e-3])  # of the lens's file
LENS = Lens(CAMERA, SIZE, np.diag(LENS_SIGMA**2))
EIGHT = np.array([(-1.5, -0.9), (-1.5, 0.9), (1.5, -0.9), (1.5, 0.9), (0, 0.9), (0, -0.9), (-0.7, 0.1), (0.8, 0.0)])
FLOOR = np.array([(x, y, 0.0) for x in (-1.5, 0.0, 1.5) for y in (-0.9, 0.0, 0.9)])
PIXEL = 0.01


class Lab:
    """A floor that was surveyed once, and a camera calibrated by that, through a lens's file that is a little wrong."""

    def __init__(self, seed: int, n: int = 8, yaw: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.true = np.column_stack([EIGHT[:n], np.zeros(n)])
        K = CAMERA.K
        values = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *CAMERA.distortion])
        f_x, f_y, c_x, c_y, *distortion = values + self.rng.normal(0.0, LENS_SIGMA)
        true_lens = CameraGeometry([[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]], distortion, DOWN)
        turned = moved(moved(DOWN, np.array([0, 0, yaw, 0, 0, 0])), self.rng.normal(0.0, 0.05, 6))
        self.camera = true_lens.moved(turned)
        self.survey = self.survey_again()
        then = self.look()
        placement = agree(LENS, then, SURVEY_M).placement
        seen = {
            name: SeenMark(x_m=x, y_m=y, height_m=height, pixel_px=(u, v), sigma_px=PIXEL)
            for name, (x, y, height), (u, v) in zip(then.names, then.points.tolist(), then.pixels.tolist(), strict=True)
        }
        self.calibrated = Calibrated(placement.T_world_camera, placement.covariance, SURVEY_M, seen)

    def survey_again(self) -> Array:
        n = len(self.true)
        return self.true + np.column_stack([self.rng.normal(0.0, SURVEY_M, (n, 2)), np.zeros(n)])

    def look(self) -> Marks:
        n, nan = len(self.true), np.full(len(self.true), np.nan)
        pixels = self.camera.project(self.true) + self.rng.normal(0.0, PIXEL, (n, 2))
        names = tuple(f"tag {k}" for k in range(n))
        return Marks(names, self.survey, nan, nan, pixels, np.stack([nan, nan], 1), np.full(n, PIXEL))

    def knock(self, *change: float) -> None:
        self.camera = self.camera.moved(moved(self.camera.T_world_camera, np.array(change)))

    def judged(self) -> Verdict:
        return judge(LENS, self.look(), self.calibrated, FLOOR)


KNOCKS = {  # how far [m], by which angle [rad]
    "0.3 mm": (3e-4, 0.0),
    "1 mm": (1e-3, 0.0),
    "3 mm": (3e-3, 0.0),
    "0.02 deg": (0.0, math.radians(0.02)),
}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("knock", KNOCKS)
def test_a_small_knock_in_any_direction_is_noticed_through_an_uncertain_lens(knock: str) -> None:
    shift, turn = KNOCKS[knock]
    for seed in range(6):
        lab = Lab(seed)
        ways = [way / np.linalg.norm(way) for way in lab.rng.normal(size=(2, 3))]
        lab.knock(*(turn * ways[0]), *(shift * ways[1]))
        verdict = lab.judged()
        assert not verdict.good
        assert "the camera was knocked" in verdict.sentences[0]


@pytest.mark.long
def test_false_alarms_are_rare() -> None:
    assert sum(not Lab(seed).judged().good for seed in range(100)) <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("again", "shares"),
    [
        ("nothing", (0.75, 1.25)),  # of chi-square over 120 degrees of freedom: 1 +- 0.13
        ("a mark is covered", (0.75, 1.25)),
        ("the survey", (0.7, 1.3)),
    ],
)
def test_the_change_of_a_camera_that_stayed_has_the_covariance_that_is_told(
    again: str, shares: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    reported = []
    monkeypatch.setattr(
        verify, "chance", lambda distance, freedom: reported.append(distance) or chance(distance, freedom)
    )
    for seed in range(20):
        lab = Lab(seed)
        if again == "the survey":
            lab.survey = lab.survey_again()
        seen = lab.look()
        judge(LENS, seen.chosen(np.arange(8) != seed % 8) if "covered" in again else seen, lab.calibrated, FLOOR)
    assert len(reported) == 20
    assert shares[0] < sum(reported) / (6 * 20) < shares[1]


def test_marks_that_are_new_or_surveyed_again_do_not_count() -> None:
    lab = Lab(2)
    lab.survey = lab.survey.copy()
    lab.survey[3, 0] += 0.2  # carried there, and surveyed
    lab.true[3, 0] += 0.2
    del lab.calibrated.marks["tag 5"]  # covered at the calibration
    verdict = lab.judged()
    assert verdict.good
    assert verdict.sentences[0].startswith("OK: 6 marks are seen")
    assert verdict.sentences[1].startswith("tag 3, tag 5: not compared")


@pytest.mark.slow_after_first
@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("n", [4, 8])
def test_a_camera_in_its_place_is_ok(n: int, fresh: bool) -> None:
    for seed in range(6):
        lab = Lab(seed, n)
        if fresh:
            lab.survey = lab.survey_again()
        verdict = lab.judged()
        assert verdict.good, verdict.sentences
        assert verdict.sentences[0].startswith(f"OK: {n} marks are seen")


@pytest.mark.slow
def test_expected_errors_are_the_usual_ones() -> None:
    for fresh in (False, True):
        ratios = []
        for seed in range(12):
            lab = Lab(seed)
            if fresh:
                lab.survey = lab.survey_again()
            words = lab.judged().sentences[0].split()
            seen, expected = (float(words[k]) for k in (words.index("seen") + 1, words.index("expected") - 3))
            ratios.append((seen / expected) ** 2)
        assert np.mean(ratios) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_a_tilt_is_noticed_and_told_in_degrees() -> None:
    # Looking down with its image's right along the world's x: about that axis it tilts towards its image's top.
    for seed in range(5):
        lab = Lab(seed)
        angle = (-1.0) ** seed * math.radians(0.2)
        lab.knock(angle, 0, 0, 0, 0, 0)
        verdict = lab.judged()
        assert not verdict.good
        assert "the camera was knocked" in verdict.sentences[0]
        assert "turned by 0.2" in verdict.sentences[0] or "turned by 0.19" in verdict.sentences[0]
        assert f"degrees towards its image's {'top' if angle > 0 else 'bottom'}" in verdict.sentences[0]
        assert "shifted" not in verdict.sentences[0]
        assert len(verdict.sentences) == 1


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("change", "words_expected"),
    [
        ((0.0, 0.0, 0.01, 0.0, 0.0, 0.0), "degrees counter-clockwise about its axis"),
        ((0.0, 0.01, 0.0, 0.0, 0.0, 0.0), "degrees towards its image's left"),
        ((0.0, 0.0, 0.0, 0.05, 0.0, 0.0), "shifted by"),
    ],
)
def test_knocks_have_the_signs_of_the_image(change: tuple[float, ...], words_expected: str) -> None:
    lab = Lab(3)
    lab.knock(*change)
    before = lab.calibrated.T
    pixel = CAMERA.moved(before).project(np.array([[1.0, 0.0, 0.0]]))[0]
    now = lab.camera.project(np.array([[1.0, 0.0, 0.0]]))[0]
    sentence = lab.judged().sentences[0]
    assert words_expected in sentence
    if "left" in words_expected:  # what it sees moves to the right of its image
        assert now[0] > pixel[0] + 2.0
    if "counter" in words_expected:  # and clockwise, as the camera turns the other way: the right end goes down
        assert now[1] > pixel[1] + 2.0


@pytest.mark.parametrize(("axis", "direction"), [(0, "top"), (1, "right")])
def test_directions_are_the_images_however_the_camera_is_turned(axis: int, direction: str) -> None:
    lab = Lab(9, yaw=2.0)
    lab.knock(*(0.01 * lab.camera.T_world_camera[:3, axis]), 0, 0, 0)
    assert f"0.57 degrees towards its image's {direction}" in lab.judged().sentences[0]


def test_error_of_a_knocked_camera_is_told() -> None:
    lab = Lab(4)
    calibrated = CAMERA.moved(lab.calibrated.T)
    before = calibrated.to_plane(lab.camera.project(FLOOR), 0.0)
    lab.knock(0.003, -0.002, 0.004, 0.01, -0.005, 0.02)
    off = calibrated.to_plane(lab.camera.project(FLOOR), 0.0) - before
    words = lab.judged().sentences[0].split()
    reported_mm = float(words[words.index("seem") + 1])
    assert reported_mm == pytest.approx(1e3 * math.sqrt(float((off**2).sum(1).mean())), abs=0.6)


@pytest.mark.slow
def test_moved_tags_are_named_and_the_camera_is_not_blamed() -> None:
    for seed in range(5):
        lab = Lab(seed)
        pushed = sorted(lab.rng.permutation(8)[: 1 + seed % 2].tolist())
        lab.true[pushed, 0] += 0.01
        verdict = lab.judged()
        assert not verdict.good
        assert verdict.sentences[0].startswith("the camera is in its place")
        assert [sentence.split(":")[0] for sentence in verdict.sentences[1:]] == [f"tag {k}" for k in pushed]


def test_a_knock_and_a_moved_tag_at_once() -> None:
    lab = Lab(5)
    lab.knock(0.01, 0, 0, 0, 0, 0)
    lab.true[2, 1] += 0.015
    verdict = lab.judged()
    assert "the camera was knocked" in verdict.sentences[0]
    assert [sentence.split(":")[0] for sentence in verdict.sentences[1:]] == ["tag 2"]


def test_one_of_four_moved_is_named_by_the_calibrated_pose() -> None:
    lab = Lab(6, 4)
    lab.true[1, 0] += 0.01
    verdict = lab.judged()
    assert not verdict.good
    assert [sentence.split(":")[0] for sentence in verdict.sentences[1:]] == ["tag 1"]


def test_too_few_or_contradicting_marks_do_not_tell() -> None:
    lab = Lab(7)
    with pytest.raises(CalibrationError, match="3 surveyed marks are in sight: tag 0, tag 1, tag 2"):
        judge(LENS, lab.look().chosen(np.arange(8) < 3), lab.calibrated, FLOOR)
    four = Lab(7, 4)
    four.true[:2] += [[0.1, 0.2, 0.0], [-0.2, 0.1, 0.0]]
    with pytest.raises(CalibrationError, match="no pose shows these"):
        four.judged()
