"""The renderer, and a slow oracle: rays through 9 x 9 points a pixel, a sharp scene, then lens and pixel."""

import math
from functools import cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from tests.shipped import OVERHEAD

GEOMETRY, SIZE = CameraGeometry.from_model(OVERHEAD), (OVERHEAD.width, OVERHEAD.height)
SIDE, HEIGHT = 0.07, 0.08
TAG = 17
BLACK, WHITE, BODY = 30.0, 215.0, 70.0
BODY_RADIUS, BODY_DROP = 0.8 * SIDE, 0.02
SUB = 9  # points a pixel, each way
MARGIN = 4  # pixels around the patch, for the blur

Array = NDArray[np.float64]


class Look(NamedTuple):
    """A lens, and a print that is not as it should be."""

    lens: float = 0.5  # standard deviation [px]
    stretch: tuple[float, float] = (0.0, 0.0)
    bow: float = 0.0  # [m]


IDEAL = Look()

EXPOSURE = 0.004
NOBODY = np.full((1, 3), np.nan)


def scene(ids: tuple[int, ...] = (TAG,), noise: float = 0.0, **what: Any) -> SceneRenderer:
    targets = [Target(tag, SIDE, HEIGHT, 0.2) for tag in ids]
    return SceneRenderer(GEOMETRY, SIZE, targets, noise, np.random.default_rng(1), **what)


@cache
def still() -> SceneRenderer:
    return scene()


@pytest.fixture(scope="module")
def renderer() -> SceneRenderer:
    return scene(exposure_s=EXPOSURE)


def rays(u: Array, v: Array) -> Array:
    """Directions (..., 3) [world] of pixels: Newton's method on the distortion, without OpenCV."""
    k1, k2, p1, p2, k3 = OVERHEAD.distortion
    target = np.stack(
        [(u - OVERHEAD.centre_px[0]) / OVERHEAD.focal_px[0], (v - OVERHEAD.centre_px[1]) / OVERHEAD.focal_px[1]]
    )
    a, b = target
    for _ in range(30):
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        a, b = (
            a + target[0] - (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)),
            b + target[1] - (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b),
        )
    return np.stack([a, b, np.ones_like(a)], axis=-1) @ GEOMETRY.T_world_camera[:3, :3].T


def sharp(directions: Array, pose: Array, look: Look) -> tuple[Array, Array]:
    """What each ray hits: 1 where a robot, and its grey (0 elsewhere)."""
    x, y, psi = pose
    eye = GEOMETRY.position

    def body_frame(height: float | Array) -> tuple[Array, Array]:
        hit = eye + directions * ((np.asarray(height)[..., None] - eye[2]) / directions[..., 2:])
        d_x, d_y = hit[..., 0] - x, hit[..., 1] - y
        return d_x * math.cos(psi) + d_y * math.sin(psi), d_y * math.cos(psi) - d_x * math.sin(psi)

    forward, left = body_frame(HEIGHT)
    if look.bow:
        for _ in range(4):
            forward, left = body_frame(HEIGHT - look.bow * (2.0 * forward / SIDE) ** 2)
        run = np.linspace(-SIDE, SIDE, 4001)
        length = np.cumsum(np.hypot(1.0, 8.0 * look.bow * run / SIDE**2)) * (run[1] - run[0])
        forward = np.interp(forward, run, length - length[2000])
    forward, left = forward / (1.0 + look.stretch[0]), left / (1.0 + look.stretch[1])
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(family.generateImageMarker(TAG, 8), 1, constant_values=255) > 0
    column, row = np.floor(forward / (SIDE / 8) + 5).astype(int), np.floor(5 - left / (SIDE / 8)).astype(int)
    paper = (column >= 0) & (column < 10) & (row >= 0) & (row < 10)
    print_gray = np.where(cells[row.clip(0, 9), column.clip(0, 9)], WHITE, BLACK)
    body = np.hypot(*body_frame(HEIGHT - BODY_DROP)) < BODY_RADIUS
    return (paper | body).astype(float), np.where(paper, print_gray, np.where(body, BODY, 0.0))


def oracle(poses: Array, left: int, top: int, size: int, look: Look) -> tuple[Array, Array]:
    """How much of each pixel of a patch is robot, and the robot's grey times that."""
    span = (np.arange((size + 2 * MARGIN) * SUB) - SUB // 2) / SUB - MARGIN
    u, v = np.meshgrid(left + span, top + span)
    directions = rays(u, v)
    images = np.mean([sharp(directions, pose, look) for pose in poses], axis=0)
    inside = slice(MARGIN * SUB + SUB // 2, (MARGIN + size) * SUB, SUB)
    lens = (cv2.GaussianBlur(image, (0, 0), look.lens * SUB) for image in images)
    cover, light = (cv2.blur(image, (SUB, SUB))[inside, inside] for image in lens)
    return np.asarray(cover), np.asarray(light)


def compared(renderer: SceneRenderer, pose: Array, velocity: Array, look: Look = IDEAL) -> tuple[Array, Array]:
    """A moving robot: the errors of its picture beside the oracle's, all, and those of the print as (grey, slopes)."""
    u, v = GEOMETRY.project(np.array([[*pose[:2], HEIGHT]]))[0]
    size, left, top = 52, round(u) - 26, round(v) - 26
    patch = np.s_[top : top + size, left : left + size]
    poses = pose + velocity * EXPOSURE * np.linspace(-0.5, 0.5, 9 if velocity.any() else 1)[:, None]
    cover, light = oracle(poses, left, top, size, look)
    floor = renderer.render(NOBODY)[patch].astype(float)
    shown = renderer.render(pose[None], velocity[None])[patch].astype(float)
    robot = shown - floor * (1 - cover)
    # The lamps' gain is smooth: three numbers for the patch, fitted.
    down, right = np.indices(shown.shape) / size
    basis = np.stack([light, light * right, light * down], axis=-1).reshape(-1, 3)
    gain = np.linalg.lstsq(basis, robot.ravel(), rcond=None)[0]
    assert 0.65 < gain[0] < 1.0
    error = robot - (basis @ gain).reshape(shown.shape)
    down, right = np.indices(shown.shape)
    in_print = np.hypot(right + left - u, down + top - v) < 0.5 * SIDE * GEOMETRY.K[0, 0] / 2.6
    return error, np.stack([error[in_print], *(slope[in_print] for slope in np.gradient(shown))], axis=-1)


def shift_px(inner: Array) -> Array:
    """By how many pixels, down and right, a print is off its place."""
    return np.asarray(np.linalg.lstsq(inner[:, 1:], inner[:, 0], rcond=None)[0])


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("x", "y", "psi"), [(0.08, 0.02, 0.4), (-1.5, 0.85, 2.1), (1.45, -0.85, -1.0), (0.9, 0.85, math.pi / 2)]
)
def test_pixels_are_those_of_the_oracle(renderer: SceneRenderer, x: float, y: float, psi: float) -> None:
    error, inner = compared(renderer, np.array([x, y, psi]), np.array([0.2, 0.15, 2.0]))
    assert np.sqrt((error**2).mean()) < 2.0  # a few pixels are off where body and paper end in the same one
    assert np.sqrt((inner[:, 0] ** 2).mean()) < 1.5
    assert np.abs(inner[:, 0]).max() < 6.0  # two standard deviations of the noise
    assert np.abs(shift_px(inner)).max() < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("look", [Look(0.8, (0.01, -0.02), 0.002), Look(1.2)])
def test_other_lenses_and_prints_are_those_of_the_oracle(look: Look) -> None:
    own = scene(lens_sigma_px=look.lens, stretches=np.array([look.stretch]), bows=np.array([look.bow]))
    error, inner = compared(own, np.array([0.7, -0.4, 0.6]), np.zeros(3), look)
    assert np.sqrt((error**2).mean()) < 2.0
    assert np.sqrt((inner[:, 0] ** 2).mean()) < 1.0
    assert np.abs(shift_px(inner)).max() < 0.003


@pytest.mark.slow
def test_prints_are_in_their_places_to_five_micrometres(renderer: SceneRenderer) -> None:
    rng = np.random.default_rng(3)
    poses = rng.uniform((-1.2, -0.7, -math.pi), (1.2, 0.7, math.pi), (8, 3))
    shifts = [shift_px(compared(renderer, pose, np.zeros(3))[1]) for pose in poses]
    metres_a_pixel = 2.42 / GEOMETRY.K[0, 0]
    assert np.abs(np.mean(shifts, axis=0)).max() * metres_a_pixel < 5e-6


def test_noise_is_white_and_of_the_given_size(renderer: SceneRenderer) -> None:
    noisy = scene(noise=3.0, exposure_s=EXPOSURE)
    a, b = (noisy.render(NOBODY).astype(float).copy() for _ in range(2))
    assert (a - b).std() / math.sqrt(2) == pytest.approx(3.0, abs=0.05)
    assert (a - renderer.render(NOBODY)).mean() == pytest.approx(0.0, abs=0.02)
    poses = np.array([[0.0, 0.0, 0.0]])
    u, v = np.rint(GEOMETRY.project(np.array([[0.0, 0.0, HEIGHT]]))[0]).astype(int)
    patch = np.s_[v - 10 : v + 11, u - 10 : u + 11]
    tags = np.array([noisy.render(poses)[patch].astype(float) for _ in range(100)])
    assert tags.std(0).mean() == pytest.approx(3.0, abs=0.1)


def test_robots_outside_and_at_the_edge_are_clipped() -> None:
    four = scene((1, 2, 3, 4))
    empty = four.render(np.full((4, 3), np.nan)).copy()
    far = np.array([(50.0, 0.0, 0.0), (-50.0, 9.0, 0.0), (0.0, 60.0, 0.0), (3.0, -2.0, 0.0)])
    assert np.array_equal(four.render(far), empty)
    corners = GEOMETRY.to_plane(np.array([[0.0, 0.0], [1279.0, 0.0], [0.0, 719.0], [1279.0, 719.0]]), HEIGHT)
    image = four.render(np.column_stack([corners, np.zeros(4)]))
    changed = image != empty
    assert all(corner.any() for corner in (changed[:9, :9], changed[:9, -9:], changed[-9:, :9], changed[-9:, -9:]))
    assert not changed[50:-50, 50:-50].any()


@pytest.mark.slow
def test_robots_side_by_side_do_not_erase_each_other() -> None:
    two = scene((1, 2))
    a, b = (0.0, 0.0, 0.0), (0.115, 0.0, 0.0)
    gone = (np.nan,) * 3
    both = two.render(np.array([a, b])).copy()
    u, v = np.rint(GEOMETRY.project(np.array([[0.0, 0.0, HEIGHT]]))[0]).astype(int)
    alone = two.render(np.array([a, gone]))
    assert np.array_equal(both[v - 15 : v + 16, u - 15 : u + 16], alone[v - 15 : v + 16, u - 15 : u + 16])


def centroid(image: NDArray[np.uint8], empty: NDArray[np.uint8]) -> Array:
    """The middle of what changed [px]."""
    weight = np.abs(image.astype(float) - empty)
    v, u = np.indices(image.shape)
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


@pytest.mark.slow
def test_rows_of_a_rolling_shutter_see_a_robot_where_it_is_then() -> None:
    line_time, speed = 2e-5, 0.5
    rolling = scene(line_time_s=line_time)
    empty = rolling.render(NOBODY).copy()
    image = rolling.render(np.zeros((1, 3)), np.array([[speed, 0.0, 0.0]])).astype(float)
    row = rolling.rows(np.zeros((1, 3)))[0]
    for above in (-10, 0, 10):  # rows of the print; image up is world +y, and rows above the middle are earlier
        i = round(row) + above
        then = still().render(np.array([[speed * (i - row) * line_time, 0.0, 0.0]]))
        now = still().render(np.zeros((1, 3)))
        seen = image[i] - empty[i]
        assert np.abs(seen - (then[i].astype(float) - empty[i])).max() <= 2.0
        if above:
            assert np.abs(seen - (now[i].astype(float) - empty[i])).max() > 2.0


@pytest.mark.slow
def test_a_tag_off_its_robots_middle_turns_with_the_robot_and_the_body_stays() -> None:
    forward, left, turn = 0.01, -0.005, 0.2
    offset = scene(offsets=np.array([[forward, left, turn]]))
    x, y, psi = 0.3, 0.2, 1.1
    c, s = math.cos(psi), math.sin(psi)
    tag = (x + c * forward - s * left, y + s * forward + c * left, psi + turn)
    moved = still().render(np.array([tag])).astype(float)
    image = offset.render(np.array([(x, y, psi)])).astype(float)
    u, v = np.rint(GEOMETRY.project(np.array([[*tag[:2], HEIGHT]]))[0]).astype(int)
    inner = np.s_[v - 8 : v + 9, u - 8 : u + 9]
    assert np.abs(image[inner] - moved[inner]).max() <= 1.0
    middle = centroid(image, still().render(NOBODY)) - centroid(moved, still().render(NOBODY))
    assert np.hypot(*middle) > 0.5


@pytest.mark.slow
def test_dim_light_dims_everything() -> None:
    full, dim = still().render(np.zeros((1, 3))), scene(light=0.15).render(np.zeros((1, 3)))
    assert np.abs(dim - 0.15 * full.astype(float)).max() <= 1.0
