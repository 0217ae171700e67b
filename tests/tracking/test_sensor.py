"""Cameras' effects on light, each against its definition."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tracking.sensor import Camera, Sensor, compressed, demosaiced

SIZE = (160, 120)


def image(light: NDArray[np.float32], **settings: object) -> NDArray[np.float64]:
    return Camera(Sensor(**settings), SIZE, np.random.default_rng(1)).image(light).astype(np.float64)


def flat(grey: float) -> NDArray[np.float32]:
    return np.full(SIZE[::-1], grey, np.float32)


def ramp() -> NDArray[np.float32]:
    return np.tile(np.linspace(1.0, 254.0, SIZE[0], dtype=np.float32), (SIZE[1], 1))


def test_a_camera_without_settings_rounds_and_clips() -> None:
    light = 1.3 * ramp() - 20.0
    assert np.array_equal(image(light), np.rint(light.clip(0.0, 255.0)))


@pytest.mark.parametrize(
    ("tone", "grey", "shown"),
    [("gamma", 55.5, 127.5), ("srgb", 54.6, 127.5), ("srgb", 0.774, 10.0), ("srgb", 255, 255)],
)
def test_tone_curves_are_the_standards(tone: str, grey: float, shown: float) -> None:
    assert image(flat(grey), tone=tone).mean() == pytest.approx(shown, abs=0.55)


def test_noise_grows_with_the_light_and_is_there_in_the_dark() -> None:
    for grey in (20.0, 128.0, 220.0):
        seen = image(flat(grey), shot_noise=3.0, read_noise=1.5) - grey
        assert seen.var() == pytest.approx(9.0 * grey / 128.0 + 1.5**2 + 1 / 12, rel=0.04)


def test_a_mosaic_keeps_what_is_flat_and_blurs_what_is_not() -> None:
    assert demosaiced(flat(100.0)) == pytest.approx(100.0, abs=0.02)
    inner = (slice(2, -2), slice(2, -2))
    assert demosaiced(ramp())[inner] == pytest.approx(ramp()[inner], abs=0.02), "bilinear: a slope is kept"
    stripes = flat(0.0)
    stripes[:, ::2] = 200.0
    assert np.ptp(demosaiced(stripes)[inner]) < 199.0
    noise = np.random.default_rng(1).normal(100.0, 10.0, SIZE[::-1]).astype(np.float32)
    assert demosaiced(noise)[inner].std() < 7.0


def test_memory_shows_the_image_before() -> None:
    camera = Camera(Sensor(memory=0.3), SIZE, np.random.default_rng(1))
    shown = [camera.image(flat(grey)).mean() for grey in (100.0, 200.0, 200.0)]
    assert shown == pytest.approx([100.0, 170.0, 191.0])


def test_sharpening_overshoots_at_edges_alone() -> None:
    light = flat(60.0)
    light[:, 80:] = 160.0
    sharp = image(light, sharpening=1.0)
    assert sharp[60, 80] > 170.0
    assert sharp[60, 79] < 50.0
    assert sharp[60, [20, 140]].tolist() == [60.0, 160.0]


def test_a_bilateral_filter_calms_noise_and_keeps_edges() -> None:
    light = flat(60.0) + np.random.default_rng(1).normal(0.0, 3.0, SIZE[::-1]).astype(np.float32)
    light[:, 80:] += 100.0
    calm = image(light, bilateral=12.0)
    assert calm[:, :70].std() < 1.5
    assert calm[:, 80].mean() - calm[:, 79].mean() > 98.0


def test_jpeg_of_less_quality_is_further_off() -> None:
    picture = np.random.default_rng(1).normal(128.0, 20.0, SIZE[::-1]).clip(0, 255).astype(np.uint8)
    off = [np.abs(compressed(picture, quality).astype(float) - picture).mean() for quality in (95, 85, 70)]
    assert 0.2 < off[0] < off[1] < off[2]


def test_veil_and_vignette_are_smooth_and_as_large_as_stated() -> None:
    veiled = image(flat(50.0), veil=60.0, veil_sigma_px=20.0, veil_pitch_px=100.0)
    assert veiled[50, 50] == 110.0
    assert veiled[50, 70] == pytest.approx(50.0 + 60.0 * np.exp(-0.5), abs=0.5)
    assert veiled[0, 0] < 53.0
    corner = image(flat(200.0), vignetting=0.4)
    assert corner[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(120.0)
    assert corner[60, 80] == pytest.approx(200.0, abs=1.0)
