"""What is learnt of a camera's imaging, and the fit of tags whose light has a structure."""

import numpy as np
import pytest

from robofleet.config.calibrated import ImagingSettings
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.imaging import BlurMonitor, Imaging, learn_blur
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.structure import solve
from robofleet.tracking.tags.targets import Target
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import Print, RayCaster

CALIBRATED = ImagingSettings(blur_px=0.9, blur_edge_px=1.2, tone=0.14)
ONE, CENTRE, PSI = np.zeros(1, np.int64), np.zeros(1, np.complex128), np.array([0.4])


def products(shade: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the products of 25 blocks of 60 pixels with a light of their own (25,), and the values that are true."""
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(0.0, 1.0, (25, 60, 8))
    coefficients[:, :, 0] = 1.0
    true = rng.normal(0.0, 1.0, 8)
    grey = coefficients @ true + shade[:, None] + rng.normal(0.0, 0.3, (25, 60))
    both = np.concatenate([coefficients, grey[:, :, None]], axis=2)
    return both.transpose(0, 2, 1) @ both, true


def test_blocks_that_are_lit_alike_are_solved_as_plain_least_squares() -> None:
    blocks, _ = products(np.zeros(25), 1)
    total = blocks.sum(0)
    assert solve(blocks)[0] == pytest.approx(np.linalg.solve(total[:8, :8], total[:8, 8]), abs=0.02)


def test_the_light_of_a_block_moves_no_pose_and_the_covariance_says_how_sure_that_is() -> None:
    rng = np.random.default_rng(2)
    squared, plain, ours = [], 0.0, 0.0
    for seed in range(60):
        blocks, true = products(rng.normal(0.0, 3.0, 25), seed)
        values, covariance = solve(blocks)
        total = blocks.sum(0)
        off = (values - true)[4:7]
        plain += float(((np.linalg.solve(total[:8, :8], total[:8, 8]) - true)[4:7] ** 2).sum())
        ours += float((off**2).sum())
        squared.append(off @ np.linalg.solve(covariance[4:7, 4:7], off) / 3.0)
    assert ours < 0.05 * plain
    assert 0.6 < np.median(squared) / 0.789 < 1.6  # of a chi-square of three degrees


def test_too_few_blocks_say_nothing() -> None:
    blocks, _ = products(np.zeros(25), 3)
    assert np.isinf(np.diag(solve(blocks[:9])[1])).all()
    blocks[:, 0, 0] = 5.0  # pixels
    assert np.isinf(np.diag(solve(blocks)[1])).all()


def images(camera: RayCamera, noise: float, count: int) -> list[np.ndarray]:
    """Return images of a tag straight below a camera, of so much noise [grey levels]."""
    rng = np.random.default_rng(4)
    caster = RayCaster(camera, np.full(camera.size, 0.5), rng)
    light = caster.image([Print(7, 0.07, 0.0, (0.0, 0.0, PSI[0]))], 0.7, 0.0)
    return [np.rint(light + rng.normal(0.0, noise, light.shape)).clip(0, 255).astype(np.uint8) for _ in range(count)]


def test_a_tag_of_which_too_few_blocks_are_seen_keeps_the_covariance_of_its_noise() -> None:
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 2.0
    camera = RayCamera(
        (120, 120), np.array([[1000.0, 0.0, 60.0], [0.0, 1000.0, 60.0], [0.0, 0.0, 1.0]]), np.zeros(5), T
    )
    fit = PhotometricFit(CameraGeometry(camera.K, camera.distortion, T), [Target(7, 0.07, 0.0, 0.3)])
    hidden = np.ones((8, 8), np.bool_)
    hidden[6:, :4] = False
    for image in images(camera, 2.0, 4):
        before = fit.fit(image, ONE, CENTRE, PSI, hidden=hidden)
        fit.fit(image, ONE, CENTRE, PSI)
    after = fit.fit(images(camera, 12.0, 1)[0], ONE, CENTRE, PSI, hidden=hidden)
    assert (after.covariance[0, [0, 2, 5]] > 20.0 * before.covariance[0, [0, 2, 5]]).all()
    assert abs(after.centre[0]) < 5.0 * np.sqrt(after.covariance[0, [0, 2]].sum())


def test_a_run_starts_from_the_calibrated_imaging() -> None:
    imaging = Imaging.of(CALIBRATED)
    assert (imaging.sigma_px, imaging.tone[0]) == pytest.approx((0.9, 0.14))
    corner = imaging.blur.sum()  # the B-spline's variance is a quarter of its width's square; a pixel's is 1/12
    assert corner**2 / 4.0 - 1.0 / 12.0 == pytest.approx(1.2**2)


def test_a_lens_that_is_touched_is_named() -> None:
    imaging = Imaging.of(CALIBRATED)
    monitor, changes = BlurMonitor(imaging, CALIBRATED.blur_px), []
    for width in (*[imaging.blur[0]] * 40, *[4.0] * 200):
        for _ in range(4):
            learn_blur(imaging.blur, imaging.known, 0.2, width - imaging.blur[0], 1e-4)
        changes.append(monitor.changed())
    assert changes[:40] == [None] * 40
    assert [sigma for sigma in changes if sigma is not None][-1] == pytest.approx(2.0, abs=0.1)
    assert changes[-1] is None
