"""The ray-cast camera, held to OpenCV's projection and to arithmetic."""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import BLACK, WHITE, Cable, Patch, Print, RayCaster, Shadow, along, instant

Array = NDArray[np.float64]

SIZE = (640, 480)
K = np.array([[1240.0, 0.0, 322.0], [0.0, 1230.0, 236.0], [0.0, 0.0, 1.0]])
PINHOLE = np.array([-0.1, 0.015, 4e-4, -3e-4, 0.002, 0.01, -0.004, 0.001, 1e-3, -2e-3, 5e-4, 1e-3, 0.02, -0.03])
FISHEYE = np.array([-0.02, 0.003, -0.001, 0.0004])
SIDE, HEIGHT = 0.07, 0.08
FAMILY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
DOWN = cv2.Rodrigues(np.array([3.1411411738, 0.0, 0.0548283519]))[0]


def camera(distortion: Array = PINHOLE[:5], fisheye: bool = False, **shutter: float) -> RayCamera:
    T = np.eye(4)
    T[:3, :3], T[2, 3] = DOWN, 2.5
    return RayCamera(SIZE, K, distortion, T, fisheye, **shutter)


def caster(eye: RayCamera) -> RayCaster:
    return RayCaster(eye, np.full(SIZE[::-1], 128.0, np.float32), np.random.default_rng(1))


def by_opencv(eye: RayCamera, points: Array) -> Array:
    project = cv2.fisheye.projectPoints if eye.fisheye else cv2.projectPoints
    turn, shift = cv2.Rodrigues(DOWN.T)[0], -DOWN.T @ eye.T_world_camera[:3, 3]
    distortion = eye.distortion if len(eye.distortion) else np.zeros(4)
    return project(points.reshape(-1, 1, 3), turn, shift, K, distortion)[0].reshape(-1, 2)


def corners(pose: tuple[float, ...], side: float) -> Array:
    """Corners (4, 3) of a square, the print's top left first, then clockwise in the print."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    square = side / 2.0 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    return np.column_stack([square @ [[c, s], [-s, c]] + pose[:2], np.full(4, HEIGHT)])


def outline(pose: tuple[float, ...], row: int, column: int, cells: int) -> Array:
    """The rim (N, 3) of a square of so many cells of the paper's 10 x 10, from a row and a column on."""
    top_left, top_right, _, bottom_left = corners(pose, SIDE * 10.0 / 8.0)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * cells + [column, row]
    rim = top_left + square / 10.0 @ np.stack([top_right - top_left, bottom_left - top_left])
    return np.concatenate([np.linspace(a, b, 20)[:-1] for a, b in zip(rim, np.roll(rim, -1, 0), strict=True)])


def centroid(image: Array) -> Array:
    """Mean pixel (u, v) of a picture's weights."""
    v, u = np.indices(image.shape)
    return np.array([(image * u).sum(), (image * v).sum()]) / image.sum()


def area_and_centroid(polygon: Array) -> tuple[float, Array]:
    a, b = polygon, np.roll(polygon, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
    return float(abs(cross.sum()) / 2.0), ((a + b) * cross[:, None]).sum(0) / (3.0 * cross.sum())


@pytest.mark.parametrize(("fisheye", "coefficients"), [(True, 4), *((False, n) for n in (0, 4, 5, 8, 12, 14))])
def test_the_lens_is_opencvs(fisheye: bool, coefficients: int) -> None:
    eye = camera((FISHEYE if fisheye else PINHOLE)[:coefficients], fisheye)
    reach = [3.0, 3.0, 0.3] if fisheye else [0.6, 0.5, 0.3]
    points = np.random.default_rng(1).uniform([-reach[0], -reach[1], 0.0], reach, (50, 3))
    assert np.abs(eye.project(points) - by_opencv(eye, points)).max() < 1e-6
    points[:, 2] = HEIGHT
    assert np.abs(eye.on_plane(by_opencv(eye, points), HEIGHT) - points[:, :2]).max() < 1e-9


@pytest.mark.slow_after_first
@pytest.mark.parametrize("fisheye", [False, True])
def test_paper_and_print_lie_where_opencv_projects_them(fisheye: bool) -> None:
    eye = camera(FISHEYE if fisheye else PINHOLE, fisheye)
    for x, y, psi in np.random.default_rng(2).uniform([-0.45, -0.3, -3.0], [0.45, 0.3, 3.0], (3, 3)).tolist():
        patch = caster(eye).patch(Print(5, SIDE, HEIGHT, (x, y, psi)))
        cover, dark = np.zeros(SIZE[::-1]), np.zeros(SIZE[::-1])
        cover[patch.where], dark[patch.where] = patch.cover, black(patch)
        # Light is only spread: area and centroid are those of the outlines.
        area, middle = area_and_centroid(by_opencv(eye, outline((x, y, psi), 0, 0, 10)))
        assert cover.sum() == pytest.approx(area, rel=2e-5)
        assert np.abs(centroid(cover) - middle).max() < 1e-3
        cells = np.argwhere(np.pad(FAMILY.generateImageMarker(5, 8), 1, constant_values=255) == 0).tolist()
        parts = [area_and_centroid(by_opencv(eye, outline((x, y, psi), *cell, 1))) for cell in cells]
        area = sum(part for part, _ in parts)
        assert dark.sum() == pytest.approx(area, rel=1e-4)
        assert np.abs(centroid(dark) - sum(part * middle for part, middle in parts) / area).max() < 4e-3


def flat(defocus: float = 0.8, lens_sigma_px: float = 0.0, **settings: float) -> RayCamera:
    """A camera a metre above the floor that sees a millimetre a pixel: u = 1000 x, v = 240 - 1000 y."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 1.0
    return RayCamera(
        SIZE,
        np.array([[1e3, 0.0, 0.0], [0.0, 1e3, 240.0], [0.0, 0.0, 1.0]]),
        np.zeros(0),
        T,
        **settings,
        lens_sigma_px=lens_sigma_px,
        defocus=defocus,
    )


def paper(
    eye: RayCamera, pose: tuple[float, float, float], twist: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Array:
    """How much of each pixel a sheet of 100 mm covers."""
    patch = caster(eye).patch(Print(0, 0.08, 0.0, pose, twist))
    cover = np.zeros(SIZE[::-1])
    cover[patch.where] = patch.cover
    return cover


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("defocus", "way"), [(0.4, 0.0), (0.7, 0.0), (1.0, 0.0), (0.7, 0.5), (0.7, 2.4)])
def test_edge_is_spread_by_disc_pixel_and_motion(defocus: float, way: float) -> None:
    edge, exposure = 200.3, 0.01  # at mid-exposure, while it goes its way [px]
    pose, twist = ((edge + 50.0) / 1e3, 0.0, 0.0), (way / 1e3 / exposure, 0.0, 0.0)
    row = paper(flat(defocus, exposure=exposure), pose, twist)[240]
    across = defocus * np.linspace(-0.999, 0.999, 999)
    share = np.sqrt(defocus**2 - across**2)
    moved = (np.arange(50) + 0.5) / 50 * way - way / 2.0
    u = np.arange(180, 220)[:, None, None]
    inside = (u + 0.5 - edge - across - moved[:, None]).clip(0.0, 1.0).mean(1)
    assert np.abs(row[180:220] - inside @ share / share.sum()).max() < 0.004


@pytest.mark.slow_after_first
@pytest.mark.parametrize("sigma", [0.4, 0.7, 1.2, 2.0])
@pytest.mark.parametrize(("phase", "degrees"), [(0.0, 0.0), (0.31, 0.0), (0.77, 90.0), (0.5, 30.0), (0.13, 45.0)])
def test_edge_is_spread_by_gaussian_and_pixel(sigma: float, phase: float, degrees: float) -> None:
    """By the normal distribution's integral, averaged over the pixel's square: a straight edge at any angle."""
    angle, right = math.radians(degrees), 200.0 + phase  # of the sheet's edge, where it crosses the row 240 [px]
    c, s = math.cos(angle), math.sin(angle)
    pose = (right / 1e3 - 0.05 * c, -0.05 * s, angle)
    cover = paper(flat(0.0, sigma), pose)
    v, u = np.mgrid[220:261, 180:221].astype(np.float64)
    across = c * (u - right) - s * (v - 240.0)  # from the edge, outwards [px]
    square = (np.arange(32) + 0.5) / 32 - 0.5
    within = (c * square - s * square[:, None]).ravel()
    x = np.arange(-12.0, 12.0, 0.005)
    beyond = np.array([0.5 * math.erfc(d / sigma / math.sqrt(2.0)) for d in x.tolist()])
    ideal = np.interp(across[..., None] + within, x, beyond).mean(2)
    assert np.abs(cover[220:261, 180:221] - ideal).max() < 0.0015


def test_every_row_has_its_own_instant() -> None:
    eye = flat(exposure=0.004, line_time=20e-6)
    pose, twist = (0.25, 0.1, 0.0), (0.5, 0.0, 0.0)
    cover = paper(eye, pose, twist)
    rows = np.arange(100, 180)
    middles = (cover[rows] @ np.arange(SIZE[0])) / cover[rows].sum(1)
    assert np.abs(middles - (250.0 + 500.0 * (rows - 239.5) * 20e-6)).max() < 0.01
    x, y, _ = along(pose, twist, instant(eye, Print(0, 0.08, 0.0, pose, twist)))
    assert np.abs(centroid(cover) - eye.project(np.array([[x, y, 0.0]]))[0]).max() < 0.002


def test_rows_go_down_the_image_with_what_moves_along_them() -> None:
    still = flat()
    fleeing = flat(line_time=1e-4)
    twist = (0.0, -1.0, 0.0)  # down the image, a tenth of a row each row
    rows = [cover.sum(1) > 50.0 for cover in (paper(still, (0.25, 0.0, 0.0)), paper(fleeing, (0.25, 0.0, 0.0), twist))]
    assert rows[0].sum() == 100
    assert rows[1].sum() == pytest.approx(100 / 0.9, abs=1.0)


def test_arc_is_the_integral_of_its_twist() -> None:
    pose, twist = (0.3, -0.2, 2.5), (0.2, 0.05, -2.0)
    t = (np.arange(4000) + 0.5) * 1e-4
    psi = pose[2] + twist[2] * t
    velocity = np.stack([np.cos(psi) * 0.2 - np.sin(psi) * 0.05, np.sin(psi) * 0.2 + np.cos(psi) * 0.05])
    x, y, heading = along(pose, twist, 0.4)
    assert np.allclose([x, y], np.array(pose[:2]) + velocity.sum(1) * 1e-4, atol=1e-8)
    assert heading == pytest.approx(1.7)


def test_cable_is_as_wide_as_said_and_lies_above() -> None:
    cable = Cable(0.01, 0.0, math.pi / 2.0, 0.003, 0.1, 60.0)
    patch = caster(flat()).patch(Print(0, 0.08, 0.0, (0.25, 0.0, 0.0), cable=cable))
    over = patch.cover[0]  # a row above the paper
    u = np.arange(patch.where[1].start, patch.where[1].stop)
    assert over.sum() == pytest.approx(3.0 / 0.9, abs=0.01)  # nearer to the lens: larger
    assert over @ u / over.sum() == pytest.approx(260.0 / 0.9, abs=0.01)
    assert patch.light[0].sum() == pytest.approx(60.0 * over.sum(), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("level", "noise"), [(1.0, 2.0), (1.0, 5.0), (0.15, 2.0)])
def test_light_and_noise_are_as_stated(level: float, noise: float) -> None:
    source, prints = caster(flat()), [Print(0, 0.08, 0.0, (0.25, 0.0, 0.0))]
    grey = source.light(prints).astype(np.float64) * level
    images = np.array([source.image(prints, level, noise) for _ in range(16)], np.float64)
    black, floor, white = grey < level * 30.0, (grey > level * 100.0) & (grey < level * 130.0), grey > level * 180.0
    for shown in (black, floor, white) if level == 1.0 else (floor, white):  # black in the dark is clipped
        assert images[:, shown].mean() == pytest.approx(grey[shown].mean(), abs=0.05)
        expected = noise**2 * (0.5 + 0.5 * grey[shown].mean() / 128.0) + 1.0 / 12.0
        assert ((images - grey)[:, shown] ** 2).mean() == pytest.approx(expected, rel=0.03)


def test_prints_outside_and_at_the_rim_are_cut_off() -> None:
    source = caster(flat())
    empty = source.light(())
    assert np.array_equal(source.light([Print(0, 0.08, 0.0, (5.0, 0.0, 0.0))]), empty)
    half = source.light([Print(0, 0.08, 0.0, (-0.0005, 0.0, 0.3))]) != empty  # the image begins at -0.5 px
    assert half[200:280, :40].all()
    whole = source.light([Print(0, 0.08, 0.0, (0.3, 0.0, 0.3))]) != empty
    assert half.sum() == pytest.approx(whole.sum() / 2.0, rel=0.02)


def black(patch: Patch) -> Array:
    """How much of each pixel of a patch is black."""
    return np.asarray((WHITE * patch.cover - patch.light) / (WHITE - BLACK), np.float64)


def test_a_stretched_print_is_larger_in_its_own_directions() -> None:
    stretch, psi = (0.02, -0.01), 0.5
    plain, other = (
        caster(flat()).patch(Print(0, 0.08, 0.0, (0.25, 0.0, psi), stretch=shares)) for shares in ((0.0, 0.0), stretch)
    )
    areas = [patch.cover.sum() for patch in (plain, other)]
    assert areas[1] / areas[0] == pytest.approx(1.02 * 0.99, rel=1e-4)
    reach = []
    for patch in (plain, other):  # second moments of the paper along its own axes
        v, u = np.indices(patch.cover.shape, np.float64)
        c, s = math.cos(psi), math.sin(psi)
        (x, y), total = ((patch.cover * way).sum() / patch.cover.sum() for way in (u, v)), patch.cover.sum()
        forward, left = c * (u - x) - s * (v - y), -s * (u - x) - c * (v - y)
        reach.append([math.sqrt((patch.cover * way**2).sum() / total) for way in (forward, left)])
    assert np.divide(reach[1], reach[0]) == pytest.approx([1.02, 0.99], rel=1e-3)


def test_a_bowed_print_is_seen_where_its_points_lie() -> None:
    """By the outlines of the black cells' ninths, put on the cylinder and projected."""
    eye, bow, pose = camera(), 0.004, (0.2, -0.1, 0.7)
    patch = caster(eye).patch(Print(5, SIDE, HEIGHT, pose, bow=bow))
    forward = np.linspace(-0.04, 0.04, 4001)
    length = np.cumsum(np.hypot(1.0, 8.0 * bow * forward / SIDE**2)) * (forward[1] - forward[0])
    c, s = math.cos(pose[2]), math.sin(pose[2])

    def seen(run: Array, left: Array) -> Array:
        ahead = np.interp(run, length - length[2000], forward)
        x, y = pose[0] + c * ahead - s * left, pose[1] + s * ahead + c * left
        return eye.project(np.column_stack([x, y, HEIGHT - bow * (2.0 * ahead / SIDE) ** 2]))

    rim = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) / 3.0
    parts = []
    for row, column in np.argwhere(FAMILY.generateImageMarker(5, 8) == 0).tolist():
        for ninth in np.ndindex(3, 3):
            at = (rim + np.array(ninth) / 3.0 + [column, row] - 4.0) * SIDE / 8.0
            parts.append(area_and_centroid(seen(at[:, 0], -at[:, 1])))
    area = sum(part for part, _ in parts)
    shown = np.zeros(SIZE[::-1])
    shown[patch.where] = black(patch)
    assert shown.sum() == pytest.approx(area, rel=2e-4)
    assert np.abs(centroid(shown) - sum(part * middle for part, middle in parts) / area).max() < 4e-3


@pytest.mark.parametrize("softness", [1.0, 6.0])
def test_a_shadows_edge_falls_on_floor_and_print_alike(softness: float) -> None:
    eye = flat()
    shadow = Shadow(softness, 0.5, 60.0, 0.0)
    source = RayCaster(eye, np.full(SIZE[::-1], 128.0, np.float32), np.random.default_rng(1), shadow)
    light = source.light([Print(0, 0.08, 0.0, (0.25, 0.0, 0.0))]) / source.lamps
    ideal = [1.0 - 0.25 * math.erfc(-(u - 270.0) / softness / math.sqrt(2.0)) for u in range(260, 281)]
    floor, paper = light[20, 260:281] / 128.0, light[240 - 45, 260:281] / WHITE  # the rim is white
    assert floor == pytest.approx(ideal, abs=1e-3)
    assert paper == pytest.approx(ideal, abs=0.02 / softness)
