"""Things of the floor, drawn in a projector's picture."""

import numpy as np
import pytest

from robofleet.projection.brush import Brush
from tests.projection.projectors import SIZE, on_floor, tilted

PROJECTOR = tilted()
BRUSH = Brush(PROJECTOR)
HEIGHT_M = 0.08


def black() -> np.ndarray:
    return np.zeros(SIZE[::-1], np.uint8)


def grays(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The greys that fall on points (N, 3)."""
    u, v = np.rint(PROJECTOR.pixels(points)).astype(int).T
    return picture[v, u]


@pytest.mark.parametrize("centre", [(0.0, 0.0), (1.5, 0.8)])
def test_all_that_stands_in_a_disc_has_its_grey(centre: tuple[float, float]) -> None:
    picture = black() + np.uint8(255)
    BRUSH.discs(picture, np.array([centre]), np.array([0.1]), 80, np.array([HEIGHT_M]))
    rng = np.random.default_rng(1)
    inside = np.array(centre) + 0.095 * np.sqrt(rng.uniform(size=(500, 1))) * _directions(rng, 500)
    points = np.column_stack([inside, rng.uniform(0.0, HEIGHT_M, 500)])
    assert (grays(picture, points) == 80).all()
    around = np.array(centre) + 0.16 * _directions(rng, 500)  # beyond its shadow, too
    assert (grays(picture, on_floor(around)) == 255).all()


def test_a_disc_as_large_as_the_floor_fills_the_picture() -> None:
    """But for slivers at its edge, which the lens bends."""
    picture = black()
    BRUSH.discs(picture, np.array([[0.3, 0.1]]), np.array([1e9]), 80)
    assert (picture == 80).mean() > 0.99


def test_of_a_disc_beside_the_picture_the_lit_part_is_drawn() -> None:
    picture, (left, right) = black(), PROJECTOR.floor(np.array([[0.0, 270.0], [959.0, 270.0]]))
    BRUSH.discs(picture, np.array([left, right + 10.0]), np.array([0.2, 0.2]), 80)
    drawn = PROJECTOR.floor(np.argwhere(picture == 80)[:, ::-1].astype(float))
    assert len(drawn) > 1000
    assert np.linalg.norm(drawn - left, axis=1).max() < 0.203


def test_a_line_lies_where_it_is_on_the_floor() -> None:
    """Its middle, to a tenth of a pixel's 4 mm; also where it is long and the lens bends it."""
    ends = np.array([[-1.4, -0.7], [1.5, 0.9]])
    picture, wide = black(), tilted(k1=-0.15)
    Brush(wide).line(picture, ends, 0.02, 255)
    v, u = np.nonzero(picture)
    floor, weight = wide.floor(np.column_stack([u, v]).astype(float)), picture[v, u].astype(float)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    aside = (floor - ends[0]) @ np.array([-along[1], along[0]])
    bins = ((floor - ends[0]) @ along // 0.2).astype(int)
    middles = [np.average(aside[bins == k], weights=weight[bins == k]) for k in range(1, bins.max())]
    assert np.abs(middles).max() < 4e-4
    assert np.abs(aside).max() < 0.02


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    angle = rng.uniform(-np.pi, np.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle)])
