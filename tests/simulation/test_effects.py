"""Effects on images, each by itself and in their order."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.camera import Cable, Glare, Shadow, SimulatedCameraSettings
from robofleet.simulation.effects import effects, shade

SIZE = (320, 200)
Image = NDArray[np.uint8]


def plain(gray: int = 120) -> Image:
    return np.full(SIZE[::-1], gray, np.uint8)


def after(settings: SimulatedCameraSettings, image: Image, t: float = 0.0, seed: int = 1) -> NDArray[np.float64]:
    changed = image.copy()
    for effect in effects(settings, SIZE, np.random.default_rng(seed)):
        effect(changed, t)
    return changed.astype(float)


def test_nothing_is_done_unless_it_is_asked_for() -> None:
    assert effects(SimulatedCameraSettings(), SIZE, np.random.default_rng(1)) == []


def test_a_lamps_reflection_saturates_its_middle_and_falls_off_as_a_gaussian() -> None:
    image = after(SimulatedCameraSettings(glare=(Glare(at_px=(100.0, 80.0), radius_px=20.0),)), plain())
    assert image[80, 100] == 255
    half = 100 + round(20.0 * math.sqrt(2.0 * math.log(8.0)))  # where the light is an eighth of 400
    assert image[80, half] - 120 == pytest.approx(50.0, abs=4.0)
    assert image[190, 300] == 120


@pytest.mark.parametrize("width", [2, 5])
def test_a_cable_hides_what_is_below_it_along_its_whole_way(width: int) -> None:
    ends = (10.3, 20.0), (310.3, 170.0)
    image = after(SimulatedCameraSettings(cables=(Cable(points_px=ends, width_px=width, gray=30),)), plain())
    hidden = (120.0 - image) / 90.0
    slope = (ends[1][1] - ends[0][1]) / (ends[1][0] - ends[0][0])
    columns = np.arange(40, 280)
    rows = (hidden[:, columns] * np.arange(SIZE[1])[:, None]).sum(0) / hidden[:, columns].sum(0)
    assert np.abs(rows - (ends[0][1] + slope * (columns - ends[0][0]))).max() < 0.1
    assert hidden[:, columns].sum(0).mean() / math.hypot(1.0, slope) == pytest.approx(width, abs=0.1)
    assert not hidden[150:, :100].any()


def noisy(sigma: float = 3.0) -> Image:
    return np.random.default_rng(2).normal(120.0, sigma, SIZE[::-1]).round().astype(np.uint8)


@pytest.mark.parametrize(("curve", "light", "shown"), [("gamma", 55, 127), ("srgb", 55, 128), ("srgb", 0, 0)])
def test_tone_curves_brighten_what_is_dark(curve: str, light: int, shown: int) -> None:
    assert after(SimulatedCameraSettings(tone_curve=curve), plain(light)) == pytest.approx(shown, abs=0.6)


def test_a_mosaic_keeps_slopes_and_blurs_noise() -> None:
    settings, inner = SimulatedCameraSettings(bayer=True), np.s_[2:-2, 2:-2]
    ramp = np.tile(np.linspace(10.0, 250.0, SIZE[0]).round().astype(np.uint8), (SIZE[1], 1))
    assert np.abs(after(settings, ramp) - ramp)[inner].max() <= 1.0
    assert after(settings, noisy())[inner].std() < 2.2


def test_denoising_calms_noise_and_keeps_edges() -> None:
    image = noisy()
    image[:, 160:] += 100
    calm = after(SimulatedCameraSettings(denoising_gray=12.0), image)
    assert calm[:, :150].std() < 1.5
    assert calm[:, 160].mean() - calm[:, 159].mean() > 98.0


def test_temporal_denoising_shows_the_image_before() -> None:
    (mix,) = effects(SimulatedCameraSettings(temporal_denoising=0.3), SIZE, np.random.default_rng(1))
    shown = [plain(gray) for gray in (100, 200, 200)]
    for image in shown:
        mix(image, 0.0)
    assert [image.mean() for image in shown] == [100.0, 170.0, 191.0]


def test_sharpening_overshoots_at_edges_alone() -> None:
    image = plain(60)
    image[:, 160:] = 160
    sharp = after(SimulatedCameraSettings(sharpening=1.0), image)
    assert sharp[100, 160] > 170.0
    assert sharp[100, 159] < 50.0
    assert sharp[100, [20, 300]].tolist() == [60.0, 160.0]


def test_light_is_left_by_vignetting_and_shadows() -> None:
    assert (shade(SimulatedCameraSettings(), SIZE) == 1.0).all()
    corners = shade(SimulatedCameraSettings(vignetting=0.4), SIZE)[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert corners == pytest.approx(0.6, abs=1e-6)
    edge = Shadow(at_px=(100.0, 80.0), angle_deg=90.0, softness_px=4.0, light=0.3)
    column = shade(SimulatedCameraSettings(shadows=(edge,)), SIZE)[:, 50]
    assert column[[20, 80, 140]] == pytest.approx([1.0, 0.65, 0.3], abs=1e-4)
    assert column[84] == pytest.approx(1.0 - 0.7 * 0.8413, abs=1e-3)


def test_jpeg_loses_more_the_lower_its_quality() -> None:
    image = np.random.default_rng(2).normal(120.0, 10.0, SIZE[::-1]).astype(np.uint8)
    losses = [
        np.sqrt(((after(SimulatedCameraSettings(jpeg_quality=quality), image) - image) ** 2).mean())
        for quality in (95, 60, 10)
    ]
    assert 0.0 < losses[0] < losses[1] < losses[2] < 12.0


def test_a_projectors_pattern_adds_light_and_moves() -> None:
    settings = SimulatedCameraSettings(projector_gray=50)
    frames = [after(settings, plain(), t) for t in (0.0, 0.25)]
    assert set(np.unique(frames[0])) == {120.0, 170.0}
    moved = [shift for shift in range(1, 60) if np.array_equal(frames[0][:, shift:], frames[1][:, :-shift])]
    assert moved
    assert np.array_equal(after(settings, plain(), 0.25), frames[1])
    assert not np.array_equal(after(settings, plain(), 0.25, seed=2), frames[1])
    assert after(settings, plain(240)).max() == 255


@pytest.mark.parametrize("t", [0.0, 1.0, 5.333, 100.0, 86_400.7])
def test_a_projectors_pattern_goes_on_for_hours(t: float) -> None:
    assert set(np.unique(after(SimulatedCameraSettings(projector_gray=50), plain(), t))) <= {120.0, 170.0}


def test_a_cable_hangs_in_front_of_the_light() -> None:
    cable = Cable(points_px=((0.0, 80.0), (319.0, 80.0)), width_px=5, gray=30)
    lamp = Glare(at_px=(100.0, 80.0), radius_px=20.0)
    settings = SimulatedCameraSettings(cables=(cable,), glare=(lamp,), projector_gray=50)
    assert after(settings, plain())[80, 100] == 30
