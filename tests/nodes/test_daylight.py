"""Daylight changes over a simulated camera: real pixels, through the tracker and back to the exposure."""

from itertools import pairwise

import numpy as np
import pytest

from robofleet.core.clock import S
from robofleet.tracking.events import TrackerEvent
from tools.measure.tracking.daylight import MINUTE, TICK_NS, Day

AUTO = "camera.exposure_control=auto"
LEAD_NS, READOUT_NS = 18_000_000, 4_000_000


@pytest.mark.long
def test_white_stays_below_saturation_while_daylight_falls_to_a_fifth_and_rises_threefold() -> None:
    held, fixed = (Day(f"camera.simulated.daylight={MINUTE}", *more).run(60.0)[30:] for more in ([AUTO], []))
    assert max(image.white for image in held) < 250
    assert min(image.measured for image in held) == 4
    assert max(image.white for image in fixed) == 255
    rms = [np.mean([image.error_mm**2 for image in run]) ** 0.5 for run in (held, fixed)]
    assert rms[0] < 0.7 * rms[1]


@pytest.mark.slow
def test_daylight_that_rises_does_not_saturate_white_and_every_image_is_exposed_at_its_time() -> None:
    day = Day(AUTO, "camera.simulated.daylight=[{at_s: 1, light: 1.0}, {at_s: 8, light: 2.5}]")
    shown = day.run(8.0)
    assert max(image.white for image in shown) < 250
    assert {image.measured for image in shown[3:]} == {4}
    assert shown[-1].exposure.time_s < 0.55 * shown[0].exposure.time_s
    for number, image in enumerate(shown):
        assert image.exposure_ns == S + (number + 1) * TICK_NS - LEAD_NS, "mid-exposure, however long"
        assert image.ready_ns == pytest.approx(image.exposure.time_s / 2 * S + READOUT_NS, abs=1)
    changes = sum(a.exposure != b.exposure for a, b in pairwise(shown))
    assert 6 <= changes <= len(shown) / 6


@pytest.mark.slow
def test_a_dark_laboratory_is_news_and_so_is_a_lamp() -> None:
    day = Day(
        AUTO, "camera.exposure.gain=[0, 0]", "camera.exposure.blur_px=0.3",
        "camera.simulated.daylight=[{at_s: 2, light: 0.1}, {at_s: 2.1, light: 1.0}]",
    )  # fmt: skip
    day.run(5.0)
    events = [(notice.event, notice.value) for _, notice in day.news if notice.event >= TrackerEvent.CAMERA_TOO_DARK]
    assert [event for event, _ in events] == [TrackerEvent.CAMERA_TOO_DARK, TrackerEvent.CAMERA_LIGHT_GOOD]
    assert 10 < events[0][1] < 30
    assert events[1][1] > 150


def test_fixed_is_what_a_simulated_camera_does_by_itself() -> None:
    day = Day("camera.simulated.light=0.4")
    assert not day.config.camera.adjusts_exposure
    assert {image.exposure for image in day.run(1.5)} == {(0.004, 0.0)}


@pytest.mark.slow
def test_gain_makes_noise_and_a_longer_exposure_does_not() -> None:
    def noise(exposure_s: float, gain: float) -> float:
        """Standard deviation from image to image where the floor is, over its grey."""
        day = Day(f"camera.simulated.light={0.3 / (exposure_s / 0.004) / 10 ** (gain / 20)}")
        camera = day._feed.device.camera
        camera.adjust(day.tick().exposure._replace(time_s=exposure_s, gain=gain))
        day.run(0.3)
        images = []
        for _ in range(7):
            images.append(camera._picture(day.clock.now_ns(), 0.0, camera._next_exposure)[:100, :100].astype(float))
        return float(np.std(np.array(images), axis=0).mean())

    plain = noise(0.004, 0.0)
    assert noise(0.008, 0.0) == pytest.approx(plain, rel=0.05)
    assert noise(0.004, 12.0) == pytest.approx(4 * plain, rel=0.1)
