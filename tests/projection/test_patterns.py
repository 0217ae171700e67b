"""What cameras read of a grid of tags: where it is, whatever the floor and the camera's tone curve."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from robofleet.projection.patterns import Grid, read
from tests.projection.projectors import SIZE

GRID = Grid(SIZE)
ONTO = np.array([[0.62, 0.03, 12.0], [-0.02, 0.6, 20.0], [2e-5, 3e-5, 1.0]])  # from the picture into the camera's image
IMAGE = 640, 400


def photographed(curve: Callable[[np.ndarray], np.ndarray], blur_px: float = 1.5, light: float = 0.5) -> dict:
    """A cluttered floor in a bright room, lit by each picture; greys are what the curve makes of the light."""
    rng = np.random.default_rng(5)
    floor = cv2.resize(rng.uniform(0.2, 0.9, (25, 40)), IMAGE, interpolation=cv2.INTER_NEAREST)
    seen = {}
    for name, picture in GRID.pictures().items():
        shown = cv2.warpPerspective(
            cv2.GaussianBlur(picture / 255.0, (0, 0), blur_px), ONTO, IMAGE, flags=cv2.INTER_LINEAR
        )
        seen[name] = 255.0 * curve(floor * (0.5 + light * shown)) + rng.normal(0.0, 1.0, floor.shape)
    return seen


@pytest.mark.slow_after_first
@pytest.mark.parametrize("curve", [lambda light: light, lambda light: light ** (1 / 2.2)], ids=["linear", "gamma"])
def test_tags_are_read_where_they_are(curve: Callable[[np.ndarray], np.ndarray]) -> None:
    reading = read(GRID, photographed(curve))
    assert len(reading.tags) > 0.9 * len(GRID.corners)
    true = cv2.perspectiveTransform(GRID.centres[reading.tags][None], ONTO)[0]
    assert np.sqrt(((reading.pixels - true) ** 2).mean()) < 0.05
    assert reading.saturated == 0.0


@pytest.mark.slow
def test_a_blur_is_told() -> None:
    sharp, soft = (read(GRID, photographed(lambda light: light, blur_px)).blur_px for blur_px in (1.2, 2.4))
    assert soft / sharp == pytest.approx(2.0, rel=0.25)


@pytest.mark.slow
def test_the_light_is_compared_with_the_rooms() -> None:
    reading = read(GRID, photographed(lambda light: light, light=0.2))
    assert reading.over_room == pytest.approx(0.2 / 0.5, rel=0.1)


def test_in_the_dark_nothing_is_read() -> None:
    reading = read(GRID, photographed(lambda light: light, light=0.0))
    assert (len(reading.tags), reading.lit) == (0, pytest.approx(0.0, abs=1e-3))


def test_a_picture_has_each_tag_once_within_it() -> None:
    assert len(np.unique(GRID.corners, axis=0)) == len(GRID.corners) > 100
    assert (GRID.corners >= 0).all()
    assert (GRID.corners + 8 * GRID.cell_px <= SIZE).all()
