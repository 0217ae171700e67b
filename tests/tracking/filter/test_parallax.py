"""Two cameras that see a robot tell how high its tag lies."""

import numpy as np
import pytest

from robofleet.core.clock import MS, S
from robofleet.tracking.filter.agreement import Agreement
from robofleet.tracking.filter.joined import Seen
from robofleet.tracking.filter.parallax import Parallax

CAMERAS = np.array([[-0.7, 0.0, 2.5], [0.8, 0.3, 2.7]])
HEIGHT, NOISE = 0.08, 1e-5
HIGHER = np.array([0.0, 0.002, -0.005])


def watched(seconds: float, both: bool = True) -> Parallax:
    """Three robots drive for so long; the cameras take turns."""
    rng, parallax = np.random.default_rng(2), Parallax(CAMERAS, np.full(3, HEIGHT))
    agreement = Agreement(np.ones(3, np.bool_), NOISE, np.zeros(2, np.bool_), parallax)
    for k in range(round(60 * seconds)):
        at_ns, camera = S + k * 16 * MS, k % 2
        angle = 0.3 * k / 60 + np.arange(3)
        true = 0.5 * np.column_stack([np.cos(angle), np.sin(angle)])
        foot, above = CAMERAS[camera, :2], CAMERAS[camera, 2] - HEIGHT
        seen = foot + (true - foot) * (above / (above - HIGHER))[:, None] + rng.normal(0.0, NOISE, (3, 2))
        if camera and not both:
            seen[:] = np.nan
        poses = np.column_stack([seen, angle + np.pi / 2])
        agreement.look(Seen(camera, poses, np.full(3, at_ns)), np.full((3, 3), np.nan))
    return parallax


def test_heights_are_found_and_named_once() -> None:
    parallax = watched(5.0)
    heights = parallax.heights()
    assert heights.higher == pytest.approx(HIGHER, abs=1e-4)
    assert (np.abs(heights.higher - HIGHER) < 5.0 * heights.noise).all()
    assert dict(parallax.news()) == {1: pytest.approx(0.002, abs=1e-4), 2: pytest.approx(-0.005, abs=1e-4)}
    assert not list(parallax.news())


def test_one_camera_alone_tells_nothing() -> None:
    parallax = watched(1.0, both=False)
    assert not list(parallax.news())
    assert (parallax.heights().noise > 1.0).all()
