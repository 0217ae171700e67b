"""Tags that are not level on their robots: the tracker learns how far each is tilted, and its heading becomes true."""

import math

import numpy as np
import pytest

from robofleet.core.clock import S
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagSighting, TagTracker
from tests.tracking.raycast import Cable, Print, RayCaster, along, clutter
from tools.measure.tracking.accuracy import HEIGHT, SIDE
from tools.measure.tracking.certainty import Scene, camera

TAGS = (7, 30, 211, 400)
STARTS = ((-1.2, -0.5, 0.3), (1.1, 0.5, 2.0), (-0.9, 0.5, -2.5), (1.0, -0.6, -0.8))  # seen under slopes of 0.4 to 0.6
PERIOD_NS = S // 30
TWIST = 0.15, 0.0, 0.6  # forward, left [m/s], turn [rad/s]
IMAGES = 20


def errors(
    tilts_deg: tuple[float, float], cable: Cable | None = None, images: int = IMAGES
) -> tuple[np.ndarray, np.ndarray]:
    """Return the headings' errors and standard deviations (images, 4) [deg] as the tracker sees four robots drive whose
    tags are level from the image IMAGES on."""
    rng = np.random.default_rng(1)
    eye = camera(Scene(small=True, lens=0.7))
    caster = RayCaster(eye, clutter(eye.size, rng), rng)
    tracker = TagTracker(
        CameraGeometry(eye.K, eye.distortion, eye.T_world_camera),
        eye.size,
        [Target(t, SIDE, HEIGHT, 0.3) for t in TAGS],
    )
    forward, left = math.radians(tilts_deg[0]), math.radians(tilts_deg[1])
    tilts = ((forward, left), (-forward, left), (forward, -left), (-forward, -left))
    off, sigma = [], []
    for k in range(images):
        t = k * PERIOD_NS / S
        poses = [tuple(map(float, along(start, TWIST, t))) for start in STARTS]
        if k == IMAGES:
            tilts = ((0.0, 0.0),) * len(TAGS)
        prints = [
            Print(tag, SIDE, HEIGHT, (x, y, psi), cable=cable if k > 2 else None, tilt=tilt)
            for tag, (x, y, psi), tilt in zip(TAGS, poses, tilts, strict=True)
        ]
        seen = {pose.tag: pose for pose in tracker.track(caster.image(prints, 0.7, 3.5), S + k * PERIOD_NS).poses}
        assert set(seen) == set(TAGS), k
        off.append([_off(seen[tag], pose[2]) for tag, pose in zip(TAGS, poses, strict=True)])
        sigma.append([math.degrees(math.sqrt(seen[tag].covariance[5])) for tag in TAGS])
    return np.array(off), np.array(sigma)


def _off(seen: TagSighting, psi: float) -> float:
    return math.degrees(math.remainder(seen.psi - psi, math.tau))


@pytest.mark.slow
@pytest.mark.parametrize("tilts_deg", [(5.0, 0.0), (3.0, -4.0)])
def test_a_tilt_is_learnt_and_no_longer_turns_the_heading(tilts_deg: tuple[float, float]) -> None:
    off, sigma = errors(tilts_deg)
    first, last = math.sqrt((off[0] ** 2).mean()), math.sqrt((off[-6:] ** 2).mean())
    assert first > 0.3
    assert last < 0.06
    assert (sigma[-1] < 0.3 * sigma[0]).all(), "it says so"
    assert (off[-6:] ** 2 / sigma[-6:] ** 2).mean() < 4.0


@pytest.mark.slow
def test_what_lies_across_level_tags_is_not_taken_for_a_tilt() -> None:
    off, sigma = errors((0.0, 0.0), Cable(0.0, 0.005, 0.4, 0.004, 0.004, 20.0))
    assert math.sqrt((off[3:] ** 2).mean()) < 0.06
    assert (off[3:] ** 2 / sigma[3:] ** 2).mean() < 2.0


@pytest.mark.slow
def test_a_tag_that_is_put_straight_is_learnt_anew() -> None:
    off, sigma = errors((5.0, 0.0), images=4 * IMAGES)
    assert np.abs(off[IMAGES]).max() > 0.3
    assert math.sqrt((off[-IMAGES:] ** 2).mean()) < 0.06
    assert (off[-IMAGES:] ** 2 / sigma[-IMAGES:] ** 2).mean() < 4.0
