"""Tags that one threshold misses; ``python -m tools.measure.tracking.acquisition`` has the whole table."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.core.settings import FAMILIES
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.deep import DeepSearch
from robofleet.tracking.tags.families import Squares
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import Target
from tests.tracking.peers import OURS
from tests.tracking.tags.test_tracker import (
    GEOMETRY,
    HEIGHT_M,
    IDS,
    MAX_SPEED,
    SIDE_M,
    STANDING,
    Watched,
    error,
    measured,
    scene,
)
from tools.measure.tracking.acquisition import SCENES, evaluate, trials


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("title", "least"), [("contrast 30", 0.99), ("contrast 20", 0.93), ("tags of 24 px, contrast 20", 0.93)]
)
def test_faint_tags_are_acquired_within_ten_images(title: str, least: float) -> None:
    row = evaluate(SCENES[title], [OURS], 1)[OURS]
    assert row["wrong"] == 0
    assert row["acquired"] >= least


@pytest.mark.slow
@pytest.mark.parametrize("title", ["a side covered, 25 %", "a corner covered, 25 %"])
def test_covered_tags_are_acquired_and_placed_by_what_is_seen(title: str) -> None:
    row = evaluate(SCENES[title], [OURS], 1)[OURS]
    assert row["wrong"] == 0
    assert row["acquired"] >= 0.9
    assert row["max_mm"] <= 0.4


@pytest.mark.slow
@pytest.mark.parametrize("family", ["36h11", "Standard41h12"])
def test_a_covered_tag_of_another_fleet_is_no_tag(family: str) -> None:
    for title in ("covered at any angle, 25 %", "half covered"):
        for trial in trials(SCENES[title]._replace(family=family), 1):
            shown = {tag.tag for tag in trial.prints}
            every = range(0, FAMILIES[family].ids, FAMILIES[family].ids // 195)
            ours = [Target(tag, *trial.setting.targets[0][1:]) for tag in every if tag not in shown]
            finder = DeepSearch(PhotometricFit(trial.setting.geometry, ours), ours)
            assert finder.detect(trial.images[0]).tags == ()


@pytest.mark.slow
def test_tags_are_followed_out_of_focus_and_back() -> None:
    watched, shows, spread = Watched(), scene(), []
    for k in range(60):
        image = shows.render(np.array(STANDING))
        seen = image if k // 15 in (0, 2) else np.asarray(cv2.GaussianBlur(image, (0, 0), 1.6), np.uint8)
        tags = measured(watched.look(seen))
        assert tags.keys() == set(IDS)
        assert all(error(tags[tag], true) < 3e-4 for tag, true in zip(IDS, STANDING, strict=True))
        spread.append(tags[IDS[0]].covariance[0])
    assert max(spread[30:45]) < 1.5 * np.median(spread[5:15])  # in focus again: as sure as before


def test_tags_out_of_focus_are_acquired() -> None:
    image = np.asarray(cv2.GaussianBlur(scene().render(np.array(STANDING)), (0, 0), 1.6), np.uint8)
    assert acquired(image) == {0, 1, 2}


def test_overexposed_tags_are_acquired() -> None:
    image = cv2.convertScaleAbs(scene().render(np.array(STANDING)), alpha=1.6)
    assert acquired(np.asarray(cv2.dilate(image, np.ones((2, 2), np.uint8)), np.uint8)) == {0, 1, 2}


def test_small_tags_are_acquired() -> None:
    half = np.array([[0.5, 0.0, -0.25], [0.0, 0.5, -0.25], [0.0, 0.0, 1.0]])
    geometry = CameraGeometry(half @ GEOMETRY.K, GEOMETRY.distortion, GEOMETRY.T_world_camera)  # 12 px
    for k in range(1, 4):
        image = scene().render(np.array(STANDING) + k * np.array([0.013, 0.007, 0.2]))
        small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        assert acquired(np.asarray(small, np.uint8), geometry) == {0, 1, 2}


def acquired(image: NDArray[np.uint8], geometry: CameraGeometry = GEOMETRY) -> set[int]:
    """Return what one deep search finds."""
    targets = [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED) for tag in IDS]
    return {tag.target for tag in DeepSearch(PhotometricFit(geometry, targets), targets).detect(image).tags}


def test_a_print_with_our_bits_and_wrong_ones_is_not_a_covered_tag() -> None:
    targets = [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED) for tag in IDS]
    finder, shows = DeepSearch(PhotometricFit(GEOMETRY, targets), targets), scene()
    image = shows.render(np.array(STANDING))
    assert {tag.target for tag in finder.detect(image).tags} == {0, 1, 2}
    for x, y, psi in STANDING:  # each cell of a corner the other way round, the rim and the paper as they were
        turn = np.exp(1j * psi) * SIDE_M / 8.0
        for i, j in np.ndindex(3, 3):
            at = complex(x, y) + turn * complex(i - 2.5, j - 2.5)
            u, v = GEOMETRY.project(np.array([[at.real, at.imag, HEIGHT_M]]))[0].round().astype(int)
            image[v - 1 : v + 2, u - 1 : u + 2] = 240 - image[v - 1 : v + 2, u - 1 : u + 2]
    assert finder.detect(image).tags == ()


def test_nothing_is_searched_deeply_while_nothing_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError

    for name in ("detect", "squares", "place", "near"):
        monkeypatch.setattr(DeepSearch, name, never)
    for sightings in Watched().at(scene(), STANDING, 30):
        assert measured(sightings).keys() == set(IDS)


def test_each_square_is_looked_at_once_and_many_of_them_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED) for tag in IDS]
    finder, looks = DeepSearch(PhotometricFit(GEOMETRY, targets), targets), []
    image = scene().render(np.array(STANDING))
    squares = finder.squares(image)
    assert sorted(squares.which) == [0, 1, 2]

    def never(_image: object, target: int, centre: complex, psi: float) -> None:
        looks.append((target, round(centre.real, 3), round(centre.imag, 3)))

    monkeypatch.setattr(finder, "near", never)
    shifts = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 1, 1, 2)
    many = Squares((squares.corners + shifts).reshape(-1, 4, 2), np.tile(squares.which, len(shifts)))
    for _ in range(30):
        before, found = len(looks), finder.place(image, many)
        assert len(looks) - before < 0.2 * len(many.which), "it takes a millisecond for each"
        many = found.squares
    assert len(set(looks)) == len(many.which)
