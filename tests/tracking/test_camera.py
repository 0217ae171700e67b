import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.tracking.camera import CameraGeometry, Lens
from robofleet.tracking.projection import project
from tests.shipped import OVERHEAD

ARENA_M = (3.2, 2.0)
TAG_HEIGHT_M = 0.08

GEOMETRY = CameraGeometry.from_model(OVERHEAD)


@given(st.floats(-1.7, 1.7), st.floats(-1.1, 1.1), st.floats(0.0, 0.5))
def test_to_plane_undoes_project(x: float, y: float, z: float) -> None:
    pixels = GEOMETRY.project(np.array([[x, y, z]]))
    assert GEOMETRY.to_plane(pixels, z) == pytest.approx(np.array([[x, y]]), abs=1e-9)


@pytest.mark.parametrize(("lens", "count"), [*(("pinhole", n) for n in (0, 4, 5, 8, 12, 14)), ("fisheye", 4)])
def test_a_kernels_projection_is_opencvs(lens: Lens, count: int) -> None:
    rng = np.random.default_rng(count)
    camera = CameraGeometry(GEOMETRY.K, rng.normal(0.0, 0.02, count), GEOMETRY.T_world_camera, lens)
    points = rng.uniform((-1.6, -1.0, 0.0), (1.6, 1.0, 0.5), (100, 3))
    points[0] = *camera.position[:2], 0.0
    assert np.array([project(camera.flat, *point) for point in points]) == pytest.approx(
        camera.project(points), abs=1e-9
    )


def test_overhead_camera_sees_the_arena_and_a_tags_margin() -> None:
    sides = [np.linspace(-size / 2 - 0.05, size / 2 + 0.05, 21) for size in ARENA_M]
    x, y = np.meshgrid(*sides)
    pixels = GEOMETRY.project(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, TAG_HEIGHT_M)]))
    assert pixels.min() >= 4.0  # OpenCV wants corners 3 px inside
    assert np.all(pixels <= np.array([OVERHEAD.width, OVERHEAD.height]) - 1 - 4.0)


def test_overhead_camera_is_tilted_and_upright() -> None:
    rotation = GEOMETRY.T_world_camera[:3, :3]
    assert math.degrees(math.acos(-rotation[2, 2])) == pytest.approx(2.0, abs=1e-6)
    ahead, left = GEOMETRY.project(np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])) - GEOMETRY.project(np.zeros((1, 3)))
    assert ahead[0] > 30 and abs(ahead[1]) < 1  # world +x is the image's right
    assert left[1] < -30 and abs(left[0]) < 1  # world +y is its top
