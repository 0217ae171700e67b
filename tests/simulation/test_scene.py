"""What a configuration draws, and what happens in it while the camera looks: read back by the tracker's detector."""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.load import ConfigError, load_config
from robofleet.config.tree import Config
from robofleet.simulation.camera import SceneRenderer
from robofleet.simulation.scene import ScenePlay, scene_renderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.detection import TagDetector
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import Target
from tests.shipped import PLATOON

PLACES = np.array([(-0.9, 0.4, 0.3), (0.8, 0.5, 2.0), (-0.6, -0.5, -2.5), (0.7, -0.4, 1.0)])
SIDE, HEIGHT = 0.07, 0.08
NEAR = (3e-4, 3e-4, 4e-3)  # of one image: about five standard deviations of the detector's noise [m, m, rad]

Array = NDArray[np.float64]
Seen = list[tuple[float, float, float]]


def load(*overrides: str) -> Config:
    return load_config(PLATOON, overrides)


def drawn(config: Config) -> SceneRenderer:
    return scene_renderer(config, np.random.default_rng(1))


def look(geometry: CameraGeometry, image: NDArray[np.uint8], *targets: Target) -> Seen:
    """Return x, y [m], psi [rad] of all that reads as a target."""
    finder = TagDetector(PhotometricFit(geometry, targets), targets)
    return [(tag.centre.real, tag.centre.imag, tag.psi) for tag in finder.detect(image).tags]


def assert_near(seen: Seen, expected: object) -> None:
    assert len(seen) == 1
    error = np.array(seen[0]) - np.asarray(expected)
    error[2] = math.remainder(error[2], math.tau)
    assert np.abs(error / NEAR).max() < 1.0, error


def calibrated(config: Config) -> CameraGeometry:
    return CameraGeometry.from_model(config.camera.model)


@pytest.mark.slow
def test_every_robot_carries_its_tag_at_its_own_height() -> None:
    config = load("robots.1.tag_height_m=0.15", "robots.2.tag_height_m=0.03")
    image = drawn(config).render(PLACES)
    for pose, tag, height in zip(PLACES, (1, 2, 3, 4), (HEIGHT, 0.15, 0.03, HEIGHT), strict=True):
        assert_near(look(calibrated(config), image, Target(tag, SIDE, height, 0.2)), pose)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_floor_tags_and_posters_lie_where_they_are_said_to_lie(noise: float) -> None:
    config = load(
        f"camera.noise_gray={noise}",
        "tracker.floor_tags=[{tag: 40, side_m: 0.1, x_m: 1.2, y_m: 0.8, heading_deg: 30},"
        " {tag: 41, side_m: 0.07, x_m: -1.3, y_m: -0.8, heading_deg: -100, height_m: 0.05}]",
        "camera.simulated.posters=[{tag: 1, side_m: 0.07, x_m: 0.1, y_m: 0.6}]",
    )
    eye, image = calibrated(config), drawn(config).render(PLACES)
    assert_near(look(eye, image, Target(40, 0.1, 0.0, 0.0)), (1.2, 0.8, math.radians(30)))
    assert_near(look(eye, image, Target(41, SIDE, 0.05, 0.0)), (-1.3, -0.8, math.radians(-100)))
    twice = look(eye, image, Target(1, SIDE, HEIGHT, 0.2))
    assert len(twice) == 2, "a robot's, and the poster's"


@pytest.mark.slow
def test_a_robot_hides_the_print_that_it_stands_on() -> None:
    posters = "camera.simulated.posters=[{tag: 40, side_m: 0.07, x_m: 0.0, y_m: 0.0}]"
    renderer = drawn(load(posters))
    target, eye = Target(40, SIDE, 0.0, 0.0), calibrated(load())
    assert len(look(eye, renderer.render(PLACES), target)) == 1
    standing = PLACES.copy()
    standing[0] = (0.0, 0.0, 0.5)
    assert look(eye, renderer.render(standing), target) == []


@pytest.mark.slow
def test_a_tag_sits_where_the_calibration_says_or_where_it_truly_is() -> None:
    offset = "{forward_m: 0.01, left_m: -0.006, heading_deg: 5}"
    measured = f"robots.0.calibration={{robot: r1, tag_offset: {offset}}}"
    true = "camera.simulated.tag_offsets=[{robot: r1, forward_m: -0.004, left_m: 0.002, heading_deg: -3}]"
    target, (x, y, psi) = Target(1, SIDE, HEIGHT, 0.2), PLACES[0]
    c, s = math.cos(psi), math.sin(psi)
    for overrides, (forward, left, turn) in (
        ([], (0.0, 0.0, 0.0)),
        ([measured], (0.01, -0.006, 5.0)),
        ([measured, true], (-0.004, 0.002, -3.0)),
    ):
        config = load(*overrides)
        expected = (x + c * forward - s * left, y + s * forward + c * left, psi + math.radians(turn))
        assert_near(look(calibrated(config), drawn(config).render(PLACES), target), expected)


@pytest.mark.slow
def test_prints_are_what_they_truly_are() -> None:
    """A tag that lies higher is seen further out; a print of its own goes before that of all."""
    config = load(
        "camera.simulated.prints=[{robot: r1}, {stretch: [0.05, 0.05]}]",
        f"camera.simulated.tag_offsets=[{{robot: r1, height_m: {HEIGHT + 0.02}}}]",
    )
    eye, image = calibrated(config), drawn(config).render(PLACES)
    (x, y, psi), target = PLACES[0], Target(1, SIDE, HEIGHT + 0.02, 0.2)
    assert_near(look(eye, image, target), (x, y, psi))
    assert look(eye, image, Target(2, SIDE * 1.05, HEIGHT, 0.2))


def test_a_focus_that_hunts_changes_the_focal_length_as_a_sine() -> None:
    config = load("camera.simulated.breathing={ratio: 0.005, period_s: 2}")
    play, focal = ScenePlay(config), calibrated(config).K[0, 0]
    ratios = [play.camera(t).K[0, 0] / focal for t in (0.0, 0.5, 1.5)]
    assert ratios == pytest.approx([1.0, math.exp(0.005), math.exp(-0.005)])


@pytest.mark.slow
def test_the_noise_is_as_strong_in_the_dark() -> None:
    renderer = drawn(load("camera.simulated.light=0.15", "camera.noise_gray=2"))
    nobody = np.full((4, 3), np.nan)
    images = np.array([renderer.render(nobody)[::4, ::4].astype(float) for _ in range(150)])
    lit = images.mean(0) > 8.0
    assert lit.mean() > 0.5
    assert images.std(0)[lit].mean() == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_a_lens_that_sees_the_horizon() -> None:
    """Its image's edges look past the floor: the floor and its textures must have an end, and tags be whole."""
    lens = (
        "camera.model={lens: fisheye, width: 1280, height: 720, focal_px: [410, 410], centre_px: [640, 360],"
        " distortion: [0, 0, 0, 0], T_world_camera: {position_m: [0, 0, 2.5], rotation_rad: [3.0915926535, 0, 0]}}"
    )
    config = load(lens, "camera.noise_gray=0", "tracker.tag_side_m=0.4", "tracker.tag_height_m=0.3")
    eye, renderer = calibrated(config), drawn(config)
    poses = np.array([(0.4, 0.3, 0.3), (2.2, 0.4, 2.0), (-3.0, -0.5, -2.5), (3.8, -0.6, 1.0)])
    image = renderer.render(poses)
    for tag, pose in enumerate(poses[:2], start=1):
        assert_near(look(eye, image, Target(tag, 0.4, 0.3, 0.2)), pose)
    # The others are too flat to be read, but all their paper is there, and nothing far from it.
    empty = renderer.render(np.full((4, 3), np.nan)).astype(float)
    corners = np.array([-1.0 - 1.0j, -1.0 + 1.0j, 1.0 + 1.0j, 1.0 - 1.0j]) * (0.4 / 2 + 0.4 / 8)
    for row in (2, 3):
        alone = np.where(np.arange(4)[:, None] == row, poses, np.nan)
        changed = np.argwhere(np.abs(renderer.render(alone) - empty) > 8.0)[:, ::-1]
        rim = complex(*poses[row, :2]) + corners * np.exp(1j * poses[row, 2])
        outline = eye.project(np.column_stack([rim.real, rim.imag, np.full(4, 0.3)]))
        assert (changed.min(0) < outline.min(0) + 1.5).all()
        assert (changed.max(0) > outline.max(0) - 1.5).all()
        assert np.ptp(changed, axis=0).max() < 2.0 * np.ptp(outline, axis=0).max()


def test_a_knock_turns_shifts_and_zooms_the_camera() -> None:
    knock = "at_s: 2, rotation_deg: [0.3, -0.2, 0.4], shift_m: [0.004, 0, 0.002], focal_ratio: 1.01"
    config = load(f"camera.simulated.knocks=[{{{knock}}}]")
    play, old = ScenePlay(config), calibrated(config)
    assert play.camera(0.0) is None
    assert play.camera(1.99) is None
    new = play.camera(2.0)
    assert play.camera(2.1) is None, "it stays there"
    # The same, from the definition: a ray of the camera, turned about the camera's axes, then into the world.
    turn = old.T_world_camera[:3, :3] @ cv2.Rodrigues(np.radians([0.3, -0.2, 0.4]))[0]
    assert np.abs(new.T_world_camera[:3, :3] - turn).max() < 1e-12
    assert np.abs(new.position - old.position - [0.004, 0.0, 0.002]).max() < 1e-12
    assert new.K[0, 0] == pytest.approx(1.01 * old.K[0, 0])
    assert np.array_equal(new.K[:2, 2], old.K[:2, 2])


def test_a_slow_knock_comes_in_small_steps_and_ends_where_it_should() -> None:
    config = load("camera.simulated.knocks=[{at_s: 1, over_s: 10, rotation_deg: [0, 0, 1]}]")
    play, old = ScenePlay(config), calibrated(config)
    angles = [0.0]
    for t in np.arange(0.0, 14.0, 0.033):
        moved = play.camera(float(t))
        if moved is not None:
            relative = old.T_world_camera[:3, :3].T @ moved.T_world_camera[:3, :3]
            angles.append(math.degrees(cv2.Rodrigues(relative)[0][2, 0]))
            assert abs(angles[-1] - (t - 1.0) / 10.0) < 0.06
    assert np.diff(angles).max() < 0.06
    assert angles[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("override", "where"),
    [
        ("camera.simulated.covers=[{robot: r9, duration_s: 1}]", "covers.0.robot"),
        ("camera.simulated.swaps=[{robots: [r1, r8], at_s: 1}]", "swaps.0.robots.1"),
        ("camera.simulated.tag_offsets=[{robot: r5}]", "tag_offsets.0.robot"),
        ("camera.simulated.prints=[{robot: r6, bow_m: 0.001}]", "prints.0.robot"),
        ("camera.simulated.light=0", "simulated.light"),
        ("camera.simulated.jpeg_quality=0", "jpeg_quality"),
        ("camera.simulated.cables=[{points_px: [[1, 2]]}]", "cables.0.points_px"),
        ("camera.simulated.knocks=[{at_s: 1, focal_ratio: 0}]", "knocks.0.focal_ratio"),
        ("camera.simulated.outages=[{kind: asleep, at_s: 1, duration_s: 1}]", "outages.0.kind"),
        ("camera.simulated.posters=[{tag: 600, side_m: 0.1, x_m: 0, y_m: 0}]", "posters.0.tag"),
        ("camera.simulated.posters=[{tag: 6, side_m: 0.1, x_m: 0, y_m: 0, heigth_m: 1}]", "posters.0.heigth_m"),
        ("camera.simulated.fog=1", "simulated.fog"),
        ("robots.2.tag_height_m=2.5", "hangs at 2.5 m"),
        ("camera.model.T_world_camera.rotation_rad=[0, 0, 0]", "looks up from the floor"),
    ],
)
def test_what_cannot_be_is_refused_where_it_is_written(override: str, where: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(override)
    assert len(refused.value.faults) == 1
    assert where in str(refused.value)
