"""Where a camera is above tags: told by corners that an independent camera model projects."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.calibrated import CameraModel
from robofleet.tracking.plane import PlacedCamera, SeenTags, placed, side_ratio
from tests.tracking.raycamera import RayCamera

Array = NDArray[np.float64]
SIZE, SIDE = (1280, 720), 0.07


def camera(tilt_deg: tuple[float, float], fov_deg: float, distortion: tuple[float, ...], height: float) -> RayCamera:
    a, b = np.radians(tilt_deg)
    turn_x = np.array([[1.0, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    turn_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1.0, 0], [-math.sin(b), 0, math.cos(b)]])
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn_x @ turn_y
    T[:3, 3] = 0.3, -0.2, height
    f = SIZE[0] / 2 / math.tan(math.radians(fov_deg) / 2)
    K = np.array([[f, 0, SIZE[0] / 2 + 5.0], [0, f, SIZE[1] / 2 - 4.0], [0, 0, 1.0]])
    return RayCamera(SIZE, K, np.array(distortion), T)


def tags(seeing: RayCamera, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the centres (M, 2) of tags anywhere in the image [m], and their corners (M, 4, 2) with noise [px]."""
    pixels = rng.uniform([60, 60], np.array(SIZE) - 60, (count, 2))
    centres, turn = seeing.on_plane(pixels, 0.0), rng.uniform(-math.pi, math.pi, count)
    corners = 0.5 * SIDE * math.sqrt(2.0) * np.exp(1j * (turn[:, None] + np.radians([135.0, 45.0, -45.0, -135.0])))
    points = np.stack([corners.real + centres[:, :1], corners.imag + centres[:, 1:], 0.0 * corners.real], axis=2)
    seen = seeing.project(points.reshape(-1, 3)).reshape(-1, 4, 2)
    return centres, seen + rng.normal(0.0, 0.03, seen.shape)


def misplaced(found: PlacedCamera, seeing: RayCamera, truth: Array) -> Array:
    """Return how far off places are (N,) [m] when frames are laid over each other: nobody knows the laboratory's."""
    pixels = seeing.project(np.column_stack([truth, np.zeros(len(truth))]))
    seen = found.geometry.to_plane(pixels, 0.0) @ [1.0, 1j]
    true = truth @ [1.0, 1j]
    seen, true = seen - seen.mean(), true - true.mean()
    turn = (true * seen.conj()).sum()
    return np.asarray(np.abs(seen * turn / abs(turn) - true))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tilt_deg", "fov_deg", "distortion", "edge_m"),
    [
        ((0.0, 0.0), 65.0, (-0.1, 0.02, 0, 0), 0.01),
        ((-8.0, 5.0), 50.0, (), 0.01),
        ((30.0, -20.0), 85.0, (-0.15, 0.03, 0, 0), 0.1),  # the farthest corner is 12 m away
    ],
)
def test_without_calibration_the_tags_tell_where_the_camera_is(
    tilt_deg: tuple[float, float], fov_deg: float, distortion: tuple[float, ...], edge_m: float
) -> None:
    seeing = camera(tilt_deg, fov_deg, distortion, 2.0)
    truth, seen = tags(seeing, 80, np.random.default_rng(1))
    found = placed(seen, SIDE, 0.0, SIZE, None, None)
    off = misplaced(found, seeing, truth)
    assert np.sqrt((off**2).mean()) < 0.002
    assert off.max() < 5 * found.edge_error_m
    assert found.edge_error_m < edge_m
    assert not found.lens_calibrated
    assert not found.place_calibrated


def test_a_calibrated_lens_tells_height_and_tilt() -> None:
    seeing = camera((-8.0, 5.0), 65.0, (-0.1, 0.02, 0.0, 0.0), 2.0)
    (f, _, c_x), (_, _, c_y), _ = seeing.K.tolist()
    model = CameraModel(
        width=SIZE[0], height=SIZE[1], focal_px=(f, f), centre_px=(c_x, c_y), distortion=(-0.1, 0.02, 0, 0)
    )
    _, seen = tags(seeing, 60, np.random.default_rng(2))
    found = placed(seen, SIDE, 0.1, SIZE, model, None)
    assert found.height_m == pytest.approx(2.1, abs=0.002), "the tags are 0.1 m above the floor"
    assert found.tilt_deg == pytest.approx(math.degrees(math.acos(-seeing.T_world_camera[2, 2])), abs=0.1)
    assert found.lens_calibrated
    middle, right, up = found.geometry.to_plane((np.array(SIZE) - 1) / 2 + np.array([[0, 0], [50, 0], [0, -50]]), 0.1)
    assert middle == pytest.approx([0.0, 0.0], abs=1e-9), "the origin"
    assert right[0] > 0.01
    assert right[1] == pytest.approx(0.0, abs=1e-4)
    assert up[1] > 0.01


@pytest.mark.slow
def test_one_tag_tells_little_and_says_so() -> None:
    seeing = camera((0.0, 0.0), 65.0, (), 2.0)
    _, single = tags(seeing, 1, np.random.default_rng(3))
    _, many = tags(seeing, 20, np.random.default_rng(3))
    assert (
        placed(single, SIDE, 0.0, SIZE, None, None).edge_error_m
        > 10 * placed(many, SIDE, 0.0, SIZE, None, None).edge_error_m
    )


def test_a_tag_that_stands_counts_once() -> None:
    seen, corners = SeenTags(), np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 40.0], [0.0, 40.0]])
    for shift in (0.0, 1.0, 10.0, 30.0):
        seen.add(3, corners + shift)
    seen.add(4, corners)
    assert seen.corners[:, 0, 0].tolist() == [0.0, 30.0, 0.0]


@pytest.mark.slow
def test_a_side_that_is_wrong_shows_in_a_calibrated_place() -> None:
    seeing = camera((-8.0, 5.0), 65.0, (), 2.0)
    _, seen = tags(seeing, 20, np.random.default_rng(4))
    found = placed(seen, SIDE, 0.0, SIZE, None, 65.0)
    assert side_ratio(found.geometry, seen, SIDE, 0.0) == pytest.approx(1.0, abs=0.01)
    assert side_ratio(found.geometry, seen, 0.05, 0.0) == pytest.approx(1.4, abs=0.02)
