"""The renderer, and a slow oracle: rays through 9 x 9 points a pixel, a sharp scene, then lens and pixel."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from robofleet.config.tree import CameraModel
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry

ROOT = Path(__file__).parents[2]
MODEL = CameraModel.model_validate(yaml.safe_load((ROOT / "configs/cameras/overhead.yaml").read_text()))
GEOMETRY = CameraGeometry.from_model(MODEL)
SIDE, HEIGHT = 0.07, 0.08
TAG = 17
BLACK, WHITE, BODY = 30.0, 215.0, 70.0
BODY_RADIUS, BODY_DROP = 0.8 * SIDE, 0.02
LENS_BLUR_PX = 0.5
SUB = 9  # points a pixel, each way
MARGIN = 4  # pixels around the patch, for the blur

Array = NDArray[np.float64]


def make(noise: float = 0.0, seed: int = 1) -> SceneRenderer:
    size = (MODEL.width, MODEL.height)
    return SceneRenderer(GEOMETRY, size, (TAG,), SIDE, HEIGHT, noise, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def renderer() -> SceneRenderer:
    return make()


def rays(u: Array, v: Array) -> Array:
    """Directions (..., 3) [world] of pixels: Newton's method on the distortion, without OpenCV."""
    k1, k2, p1, p2, k3 = MODEL.distortion
    target = np.stack([(u - MODEL.centre_px[0]) / MODEL.focal_px[0], (v - MODEL.centre_px[1]) / MODEL.focal_px[1]])
    a, b = target
    for _ in range(30):
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        a, b = (
            a + target[0] - (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)),
            b + target[1] - (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b),
        )
    return np.stack([a, b, np.ones_like(a)], axis=-1) @ GEOMETRY.T_world_camera[:3, :3].T


def sharp(directions: Array, pose: Array) -> tuple[Array, Array]:
    """What each ray hits: 1 where a robot, and its grey (0 elsewhere)."""
    x, y, psi = pose
    eye = GEOMETRY.position

    def body_frame(height: float) -> tuple[Array, Array]:
        hit = eye + directions * ((height - eye[2]) / directions[..., 2:])
        d_x, d_y = hit[..., 0] - x, hit[..., 1] - y
        return d_x * math.cos(psi) + d_y * math.sin(psi), d_y * math.cos(psi) - d_x * math.sin(psi)

    forward, left = body_frame(HEIGHT)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(family.generateImageMarker(TAG, 8), 1, constant_values=255) > 0
    column, row = np.floor(forward / (SIDE / 8) + 5).astype(int), np.floor(5 - left / (SIDE / 8)).astype(int)
    paper = (column >= 0) & (column < 10) & (row >= 0) & (row < 10)
    print_gray = np.where(cells[row.clip(0, 9), column.clip(0, 9)], WHITE, BLACK)
    body = np.hypot(*body_frame(HEIGHT - BODY_DROP)) < BODY_RADIUS
    return (paper | body).astype(float), np.where(paper, print_gray, np.where(body, BODY, 0.0))


def oracle(poses: Array, left: int, top: int, size: int) -> tuple[Array, Array]:
    """How much of each pixel of a patch is robot, and the robot's grey times that."""
    span = (np.arange((size + 2 * MARGIN) * SUB) - SUB // 2) / SUB - MARGIN
    u, v = np.meshgrid(left + span, top + span)
    directions = rays(u, v)
    images = np.mean([sharp(directions, pose) for pose in poses], axis=0)
    inside = slice(MARGIN * SUB + SUB // 2, (MARGIN + size) * SUB, SUB)
    lens = (cv2.GaussianBlur(image, (0, 0), LENS_BLUR_PX * SUB) for image in images)
    cover, light = (cv2.blur(image, (SUB, SUB))[inside, inside] for image in lens)
    return np.asarray(cover), np.asarray(light)


@pytest.mark.parametrize(
    ("x", "y", "psi"), [(0.08, 0.02, 0.4), (-1.5, 0.85, 2.1), (1.45, -0.85, -1.0), (0.9, 0.85, math.pi / 2)]
)
def test_pixels_are_those_of_the_oracle(renderer: SceneRenderer, x: float, y: float, psi: float) -> None:
    poses = np.array([x, y, psi]) + np.array([0.0004, 0.0003, 0.004]) * np.linspace(-1.0, 1.0, 3)[:, None]
    u, v = GEOMETRY.project(np.array([[x, y, HEIGHT]]))[0]
    size, left, top = 52, round(u) - 26, round(v) - 26
    patch = np.s_[top : top + size, left : left + size]
    cover, light = oracle(poses, left, top, size)
    floor = renderer.render(np.full((1, 1, 3), np.nan))[patch].astype(float)
    shown = renderer.render(poses[:, None])[patch].astype(float)
    robot = shown - floor * (1 - cover)
    # The lamps' gain is smooth: three numbers for the patch, fitted.
    down, right = np.indices(shown.shape) / size
    basis = np.stack([light, light * right, light * down], axis=-1).reshape(-1, 3)
    gain = np.linalg.lstsq(basis, robot.ravel(), rcond=None)[0]
    assert 0.65 < gain[0] < 1.0
    error = robot - (basis @ gain).reshape(shown.shape)
    assert np.sqrt((error**2).mean()) < 2.0  # a few pixels are off where body and paper end in the same one
    down, right = np.indices(shown.shape)
    in_print = np.hypot(right + left - u, down + top - v) < 0.5 * SIDE * GEOMETRY.K[0, 0] / 2.6
    inner = error[in_print]
    assert np.sqrt((inner**2).mean()) < 1.5
    assert np.abs(inner).max() < 6.0  # two standard deviations of the noise
    slopes = np.stack([slope[in_print] for slope in np.gradient(shown)], axis=-1)
    assert np.abs(np.linalg.lstsq(slopes, inner, rcond=None)[0]).max() < 0.003  # shifted by so many pixels


def test_same_seed_same_images() -> None:
    poses = np.array([[[0.2, -0.3, 1.0]]])
    first, second, other = make(3.0, 5), make(3.0, 5), make(3.0, 6)
    for _ in range(3):
        image = first.render(poses).copy()
        assert np.array_equal(image, second.render(poses))
        assert not np.array_equal(image, other.render(poses))


def test_noise_is_white_and_of_the_given_size() -> None:
    noisy = make(3.0)
    nobody = np.full((1, 1, 3), np.nan)
    a, b = (noisy.render(nobody).astype(float).copy() for _ in range(2))
    assert (a - b).std() / math.sqrt(2) == pytest.approx(3.0, abs=0.05)
    assert (a - make().render(nobody)).mean() == pytest.approx(0.0, abs=0.02)
    poses = np.array([[[0.0, 0.0, 0.0]]])
    u, v = np.rint(GEOMETRY.project(np.array([[0.0, 0.0, HEIGHT]]))[0]).astype(int)
    patch = np.s_[v - 10 : v + 11, u - 10 : u + 11]
    tags = np.array([noisy.render(poses)[patch].astype(float) for _ in range(100)])
    assert tags.std(0).mean() == pytest.approx(3.0, abs=0.1)


def test_motion_smears_along_the_motion(renderer: SceneRenderer) -> None:
    def edges(poses: list[tuple[float, float, float]]) -> tuple[float, float]:
        image = renderer.render(np.array(poses)[:, None]).astype(float)
        u, v = np.rint(GEOMETRY.project(np.array([[0.0, 0.0, HEIGHT]]))[0]).astype(int)
        patch = image[v - 15 : v + 16, u - 15 : u + 16]
        return float((np.diff(patch, axis=1) ** 2).sum()), float((np.diff(patch, axis=0) ** 2).sum())

    still = edges([(0.0, 0.0, 0.0)])
    moving = edges([(x, 0.0, 0.0) for x in (-0.004, -0.0013, 0.0013, 0.004)])
    assert moving[0] < 0.5 * still[0]  # across the columns
    assert moving[1] > 0.7 * still[1]


def test_robots_outside_and_at_the_edge_are_clipped() -> None:
    size, ids = (MODEL.width, MODEL.height), (1, 2, 3, 4)
    four = SceneRenderer(GEOMETRY, size, ids, SIDE, HEIGHT, 0.0, np.random.default_rng(1))
    empty = four.render(np.full((1, 4, 3), np.nan)).copy()
    far = np.array([[(50.0, 0.0, 0.0), (-50.0, 9.0, 0.0), (0.0, 60.0, 0.0), (3.0, -2.0, 0.0)]])
    assert np.array_equal(four.render(far), empty)
    corners = GEOMETRY.to_plane(np.array([[0.0, 0.0], [1279.0, 0.0], [0.0, 719.0], [1279.0, 719.0]]), HEIGHT)
    image = four.render(np.column_stack([corners, np.zeros(4)])[None])
    changed = image != empty
    assert all(corner.any() for corner in (changed[:9, :9], changed[:9, -9:], changed[-9:, :9], changed[-9:, -9:]))
    assert not changed[50:-50, 50:-50].any()


def test_robots_side_by_side_do_not_erase_each_other() -> None:
    size = (MODEL.width, MODEL.height)
    two = SceneRenderer(GEOMETRY, size, (1, 2), SIDE, HEIGHT, 0.0, np.random.default_rng(1))
    a, b = (0.0, 0.0, 0.0), (0.115, 0.0, 0.0)
    gone = (np.nan,) * 3
    both = two.render(np.array([[a, b]])).copy()
    u, v = np.rint(GEOMETRY.project(np.array([[0.0, 0.0, HEIGHT]]))[0]).astype(int)
    alone = two.render(np.array([[a, gone]]))
    assert np.array_equal(both[v - 15 : v + 16, u - 15 : u + 16], alone[v - 15 : v + 16, u - 15 : u + 16])
