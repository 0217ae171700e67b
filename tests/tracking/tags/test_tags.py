import math
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.core.arrays import Image
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.detection import Findings, Region, Sweep, TagDetector
from robofleet.tracking.tags.families import Squares
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import Target
from tests.shipped import OVERHEAD

APRILTAGS = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
SIDE_M, HEIGHT_M = 0.07, 0.08
IDS = (1, 2, 3, 40)

GEOMETRY = CameraGeometry.from_model(OVERHEAD)

FOUR, NOBODY = np.array([(-0.5, 0.0, 0.3), (0.5, 0.0, 1.0), (0.0, 0.5, 2.0), (0.0, -0.5, 0.0)]), np.full((4, 3), np.nan)


@cache
def detector(ids: tuple[int, ...] = IDS, side: float = SIDE_M) -> TagDetector:
    targets = [Target(tag, side, HEIGHT_M, 0.2) for tag in ids]
    return TagDetector(PhotometricFit(GEOMETRY, targets), targets)


def scene(ids: tuple[int, ...] = IDS, seed: int = 1) -> SceneRenderer:
    targets = [Target(tag, SIDE_M, HEIGHT_M, 0.2) for tag in ids]
    size = (OVERHEAD.width, OVERHEAD.height)
    return SceneRenderer(GEOMETRY, size, targets, 3.0, np.random.default_rng(seed), exposure_s=0.004)


@pytest.fixture(scope="module")
def renderer() -> SceneRenderer:
    return scene()


def random_poses(rng: np.random.Generator) -> NDArray[np.float64]:
    """Poses (4, 3) anywhere in the arena, no two robots overlapping."""
    while True:
        poses = rng.uniform([-1.6, -1.0, -math.pi], [1.6, 1.0, math.pi], (4, 3))
        gaps = np.linalg.norm(poses[:, None, :2] - poses[None, :, :2], axis=2)[np.triu_indices(4, 1)]
        if gaps.min() > 0.13:
            return poses


def measure(renderer: SceneRenderer, frames: int) -> tuple[NDArray[np.float64], int]:
    """Errors (M, 3) of x, y [mm], psi [deg] of all that was seen, and how much was seen that is not there."""
    rng = np.random.default_rng(7)
    errors, false = [], 0
    for _ in range(frames):
        truth = random_poses(rng)
        findings = detector().detect(renderer.render(truth))
        false += findings.refused
        for target, centre, psi, _ in findings.tags:
            x_true, y_true, psi_true = truth[target]
            turned = math.degrees(math.remainder(psi - psi_true, math.tau))
            errors.append(((centre.real - x_true) * 1e3, (centre.imag - y_true) * 1e3, turned))
    return np.array(errors), false


def test_poses_all_over_the_arena(renderer: SceneRenderer) -> None:
    frames = 200
    errors, false = measure(renderer, frames)
    assert len(errors) >= 0.99 * frames * len(IDS)
    assert false == 0
    position, heading = np.hypot(errors[:, 0], errors[:, 1]), errors[:, 2]
    assert np.sqrt((position**2).mean()) < 0.05
    assert position.max() < 0.2
    assert np.sqrt((heading**2).mean()) < 0.06
    assert abs(heading).max() < 0.3
    assert np.abs(errors[:, :2].mean(0)).max() < 0.02
    assert abs(heading.mean()) < 0.01


def test_moving_tag_is_found_where_it_is_at_mid_exposure(renderer: SceneRenderer) -> None:
    poses, velocities = np.full((4, 3), np.nan), np.zeros((4, 3))
    poses[0], velocities[0] = (0.3004, 0.2, 0.506), (0.2, 0.0, 3.0)  # for 4 ms
    (seen,) = detector().detect(renderer.render(poses, velocities)).tags
    assert abs(seen.centre - (0.3004 + 0.2j)) < 2e-4
    assert seen.psi == pytest.approx(0.506, abs=0.003)


def test_printed_right_is_forward_and_top_is_left() -> None:
    # Drawn by OpenCV alone: the image's right is world +x, its top world +y.
    marker = np.pad(APRILTAGS.generateImageMarker(40, 24), 3, constant_values=255)
    for quarters, heading in ((0, 0.0), (1, 90.0), (2, 180.0), (3, -90.0)):
        image = np.full((720, 1280), 120, np.uint8)
        image[300:330, 700:730] = np.rot90(marker, quarters)  # counter-clockwise on the screen
        (seen,) = detector().detect(image).tags
        assert IDS[seen.target] == 40
        assert abs(math.remainder(math.degrees(seen.psi) - heading, 360.0)) < 1.0
        # Its pixels are 703 to 726 and 303 to 326: with centres at integers, the middle is at 714.5, 314.5.
        middle = GEOMETRY.to_plane(np.array([[714.5, 314.5]]), HEIGHT_M)[0]
        assert abs(complex(*middle) - seen.centre) < 2e-4  # 0.07 px


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_nothing_is_found_where_nothing_is(seed: int) -> None:
    empty = scene(seed=seed)
    images = [np.zeros((720, 1280), np.uint8), *(empty.render(NOBODY) for _ in range(10))]
    stranger = scene((5,), seed).render(np.zeros((1, 3)))
    assert all(detector().detect(image) == Findings((), 0) for image in (*images, stranger))


def test_print_that_only_reads_like_a_tag_is_refused() -> None:
    for flipped, expected in ((0, 1), (5, 0)):  # cells; the family's code corrects 5
        marker = APRILTAGS.generateImageMarker(40, 8)
        marker[2, 1 : 1 + flipped] = 255 - marker[2, 1 : 1 + flipped]
        image = np.full((720, 1280), 120, np.uint8)
        image[300:330, 700:730] = np.kron(np.pad(marker, 1, constant_values=255), np.ones((3, 3), np.uint8))
        findings = detector().detect(image)
        assert (len(findings.tags), findings.refused) == (expected, 1 - expected)


def test_only_what_is_whole_in_the_region_is_found(renderer: SceneRenderer) -> None:
    image = renderer.render(FOUR)
    (u, v), _ = GEOMETRY.project(np.array([(-0.5, 0.0, HEIGHT_M), (0.5, 0.0, HEIGHT_M)])).astype(int)
    (found,) = detector().detect(image, Region(u - 40, v - 40, u + 40, v + 40)).tags
    assert found.target == 0
    assert abs(found.centre - (-0.5 + 0j)) < 2e-4
    assert detector().detect(image, Region(u, v - 40, u + 40, v + 40)).tags == ()


@pytest.mark.parametrize("light", [0.5, 0.15])
def test_tags_in_the_dark_are_found(renderer: SceneRenderer, light: float) -> None:
    rng = np.random.default_rng(3)
    bright = renderer.render(FOUR).astype(float)
    dark = np.clip(light * bright + rng.normal(0.0, 3.0, bright.shape), 0, 255).astype(np.uint8)
    found = {IDS[found.target]: found.centre for found in detector().detect(dark).tags}
    assert found.keys() == set(IDS)
    assert max(abs(found[tag] - complex(x, y)) for tag, (x, y, _) in zip(IDS, FOUR.tolist(), strict=True)) < 4e-4


def test_tag_of_a_wrong_size_is_refused(renderer: SceneRenderer) -> None:
    image = renderer.render(np.array([(0.0, 0.0, 0.0), *3 * [(np.nan, np.nan, np.nan)]]))
    assert detector(side=0.05).detect(image) == Findings((), 1)


def test_a_tile_is_searched_again_around_what_changes_and_now_and_then(
    renderer: SceneRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[Region] = []
    squares, tile = detector().squares, Region(0, 0, OVERHEAD.width, OVERHEAD.height)

    def spied(image: Image, region: Region, bright: float) -> Squares:
        searched.append(region)
        return squares(image, region, bright)

    monkeypatch.setattr(detector(), "squares", spied)
    sweep, known = Sweep(detector(), [tile], 60.0), np.full(4, np.nan, complex)
    alone = np.array([(-0.5, 0.0, 0.3), *3 * [(np.nan, np.nan, np.nan)]])
    both = np.array([(-0.5, 0.0, 0.3), (0.5, 0.0, 1.0), *2 * [(np.nan, np.nan, np.nan)]])
    for k, (poses, expected) in enumerate(((alone, {0}), (both, {0, 1}), (alone, {0}))):
        searched.clear()
        for visit in range(40):
            findings = sweep.search(renderer.render(poses), 40 * k + visit + 1, known)
            assert {tag.target for tag in findings.tags} == expected
        assert 3 <= len(searched) <= 8
        assert k == 0 or searched[0].right - searched[0].left < 0.3 * tile.right


@pytest.mark.slow
def test_prints_at_the_edge_of_a_fisheye_that_looks_aslant_are_refused() -> None:
    T = np.eye(4)
    T[:3, :3], T[2, 3] = cv2.Rodrigues(np.array([0.75 * math.pi, 0.0, 0.0]))[0], 2.5
    geometry = CameraGeometry([[420, 0, 640], [0, 420, 360], [0, 0, 1]], np.zeros(4), T, "fisheye")
    fit = PhotometricFit(geometry, [Target(40, 0.1, 0.0, 0.2)])
    finder = TagDetector(fit, [Target(40, 0.1, 0.0, 0.2)])
    marker = np.kron(np.pad(APRILTAGS.generateImageMarker(40, 8), 1, constant_values=255), np.ones((3, 3), np.uint8))
    for left, top in ((left, top) for left in (0, 20, 60, 1190, 1230, 1252) for top in range(0, 690, 15)):
        image = np.full((720, 1280), 120, np.uint8)
        image[top : top + 30, left : left + 30] = marker[:, : 1280 - left]
        squares = finder.squares(image)
        assert finder.place(image, squares) == Findings((), len(squares.which))
        for corners in squares.corners:
            guess = geometry.to_plane(corners, 0.0).mean(0) @ [1.0, 1j]  # the map from pixels is wild there
            assert fit.fit(image, np.array([0]), np.array([guess]), np.zeros(1)).alike[0] < 0.9
