"""What images say of a board, which images are worth having, and which board it cannot be."""

import numpy as np
import pytest

from robofleet.calibration.lens.board import Board, BoardDetector
from robofleet.calibration.lens.gathering import Gathering
from robofleet.calibration.lens.views import Collector, Offer
from robofleet.calibration.store import CalibrationError

from .conftest import BOARD, TrueCamera


@pytest.mark.slow
def test_corners_are_found_to_a_twentieth_of_a_pixel(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(1)
    detector, errors = BoardDetector(BOARD), []
    for pose in true_camera.good_poses(9, rng):
        view = detector.detect("", true_camera.photo(pose, rng)).view
        assert view is not None
        true = true_camera.view("", pose, 0.0, rng)
        _, i, j = np.intersect1d(view.ids, true.ids, return_indices=True)
        assert len(i) > 0.6 * len(true.ids)
        errors.append(view.pixels[i] - true.pixels[j])
    off = np.concatenate(errors)
    assert 1.4826 * np.median(np.abs(off)) < 0.06
    assert np.abs(np.median(off, axis=0)).max() < 0.01  # half a pixel's convention would show here


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("named", "words"),
    [
        (Board((5, 6)), "are not of a board of 5 x 6 squares (0 to 14)"),
        (Board((8, 11)), "the markers do not lie as on a board of 8 x 11 squares"),
        (Board((12, 8)), "the markers do not lie as on a board of 12 x 8 squares"),
        (Board(marker_m=0.02), "of a square, not 0.50: check --square-mm and --marker-mm"),
        (Board((11, 8), dictionary="DICT_6X6_250"), "no marker of DICT_6X6_250 in 4 images"),
    ],
)
def test_a_board_that_is_not_the_one_named(named: Board, words: str, true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(2)
    gathering = Gathering(named, film=False)
    for k, left in enumerate((-20, 0, 20, 10)):
        gathering.take(f"{k}", true_camera.photo(true_camera.pose(300 + 70 * k, 300, 0.7, left, 0), rng))
    with pytest.raises(CalibrationError, match=r".*") as refused:
        gathering.refuse()
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"squares": (3, 8)}, "too few corners"),
        ({"marker_m": 0.04}, "do not fit"),
        ({"marker_m": -0.01}, "do not fit"),
        ({"marker_m": float("nan")}, "do not fit"),
        ({"dictionary": "DICT_9X9_1"}, "there is no dictionary DICT_9X9_1"),
        ({"squares": (30, 30)}, "need 450 markers, DICT_5X5_250 has 250"),
    ],
)
def test_a_board_that_cannot_be_printed(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        Board(**arguments)  # type: ignore[arg-type]


def test_a_film_gives_what_is_new_and_still(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(3)
    first, moved, elsewhere, tilted = (
        true_camera.view("", true_camera.pose(u, 300, 0.9, left, 0), 0.05, rng)
        for u, left in ((400, 0), (404, 0), (500, 0), (400, 30))
    )
    film, folder = Collector(true_camera.size, film=True), Collector(true_camera.size, film=False)
    views = [first, first, first, moved, moved, elsewhere, elsewhere, tilted, tilted]
    new, alike, moving = Offer.NEW, Offer.ALIKE, Offer.MOVING
    assert [film.offer(view) for view in views] == [moving, new, alike, moving, alike, moving, new, moving, new]
    assert [folder.offer(view) for view in views] == [new, alike, alike, alike, alike, new, alike, new, alike]
    assert len(film.views) == len(folder.views) == 3


def test_views_outlive_the_cameras_buffer(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(4)
    gathering, buffer = Gathering(BOARD, film=False), true_camera.photo(true_camera.pose(400, 300, 0.8, 0, 0), rng)
    assert gathering.take("a", buffer) is Offer.NEW
    before = buffer.copy()
    buffer[:] = 0
    assert np.array_equal(gathering.views[0].image, before)


def test_an_image_of_another_size_is_named() -> None:
    gathering = Gathering(BOARD, film=False)
    assert gathering.take("a.png", np.zeros((60, 80), np.uint8)) is Offer.NO_BOARD
    with pytest.raises(CalibrationError, match=r"b\.png: 90 x 60 px, those before it 80 x 60"):
        gathering.take("b.png", np.zeros((60, 90), np.uint8))
