"""A camera that mixes each image with the one before: how much of it, and whether it is undone."""

import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.tracking.denoising import TemporalDenoising
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.sight import FleetSight
from tools.measure.tracking.vibration import Motion, configuration, frames

PERIOD_NS = 33_000_000
Images = list[NDArray[np.uint8]]


def mixed(images: Images, share: float) -> Images:
    """Return what a camera makes of images that mixes ``share`` of its image before into each."""
    seen = [images[0].astype(np.float64)]
    for image in images[1:]:
        seen.append((1.0 - share) * image + share * seen[-1])
    return [np.rint(image).astype(np.uint8) for image in seen]


def noisy(count: int, sigma: float, swing: float = 0.0) -> Images:
    """Return images of one wall, under a lamp whose light swings by so many grey levels."""
    rng = np.random.default_rng(3)
    wall = rng.normal(120.0, 3.0, (400, 640))
    lamp = swing * np.sin(2.1 * np.arange(count))
    return [np.rint(wall + light + rng.normal(0.0, sigma, wall.shape)).astype(np.uint8) for light in lamp]


@pytest.mark.slow_after_first
@pytest.mark.parametrize("share", [0.2, 0.3, 0.5])
def test_the_share_of_the_image_before_is_found_and_undone(share: float) -> None:
    sharp, denoising = noisy(40, 2.5), TemporalDenoising()
    seen = mixed(sharp, share)
    undone = [denoising.undone(image, k * PERIOD_NS) for k, image in enumerate(seen)]
    assert denoising.share == 0.0  # nobody has seen yet that something lags
    assert undone[0] is None
    last = undone[-1]
    assert last is not None
    left = last.astype(np.float64) - sharp[-1]
    assert left.std() < 0.75  # rounding, twice
    assert denoising.judge(np.full(20, 0.96), np.full(20, 0.98))
    assert denoising.share == pytest.approx(share, abs=0.04)


def test_what_moves_is_asked_before_the_share_is_believed() -> None:
    denoising = TemporalDenoising()
    for k, image in enumerate(mixed(noisy(40, 2.5), 0.3)):
        denoising.undone(image, k * PERIOD_NS)
    assert not denoising.judge(np.full(20, 0.98), np.full(20, 0.96))  # still parts only are filtered
    assert denoising.share == 0.0


@pytest.mark.slow_after_first
@pytest.mark.parametrize("swing", [0.0, 10.0])
def test_a_camera_that_mixes_nothing_is_left_alone(swing: float) -> None:
    denoising = TemporalDenoising()
    assert all(denoising.undone(image, k * PERIOD_NS) is None for k, image in enumerate(noisy(40, 2.5, swing)))


def test_an_image_after_a_missing_one_is_left_as_it_is() -> None:
    denoising = TemporalDenoising()
    for k, image in enumerate(seen := mixed(noisy(40, 2.5), 0.3)):
        denoising.undone(image, k * PERIOD_NS)
    assert denoising.undone(seen[-1], 50 * PERIOD_NS) is None
    assert denoising.undone(seen[-1], 51 * PERIOD_NS) is not None


@pytest.mark.slow
def test_robots_of_a_camera_that_denoises_over_time_are_placed_as_without_it() -> None:
    config = configuration(floor_tags=False)
    shown = list(frames(config, Motion(), 32))
    sight, errors, events = FleetSight(config), [], []
    for k, (image, frame) in enumerate(zip(mixed([frame.image for frame in shown], 0.3), shown, strict=True)):
        look = sight.see(image, frame.exposure_ns)
        events += [event for event in look.happenings if event.event is TrackerEvent.CAMERA_DENOISES]
        if k >= 20:
            order = {robot.tag: row for row, robot in enumerate(config.robots)}
            errors += [np.hypot(*(frame.poses[order[seen.tag], :2] - (seen.x, seen.y))) for seen in look.poses]
    ((_, _, share),) = events
    assert share == pytest.approx(0.3, abs=0.05)
    assert np.sqrt(np.square(errors).mean()) < 3e-5  # 0.2 mm if it is not undone
