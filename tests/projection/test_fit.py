"""A projector from what cameras saw: right, and as sure as it says."""

import numpy as np
import pytest

from robofleet.projection.fit import FitError, Seen, fit
from robofleet.projection.model import Projector
from tests.projection.projectors import SIZE, on_floor, pixels, tilted

SIGMA_M = 2e-4
TRUTH = tilted()
FLOOR = TRUTH.floor(pixels())


def seen(rng: np.random.Generator, by_camera: np.ndarray | None = None, stated: float = 1.0) -> Seen:
    """What a camera sees with noise, and with one draw of its own errors."""
    own = np.zeros((len(FLOOR), 2, 0)) if by_camera is None else by_camera
    off = SIGMA_M * rng.standard_normal(FLOOR.shape) + own @ rng.standard_normal(own.shape[2])
    return Seen(pixels(), FLOOR + off, np.tile((stated * SIGMA_M) ** 2 * np.eye(2), (len(FLOOR), 1, 1)), own)


def chi_square(found: Projector) -> float:
    """1 on average where the predicted error is true: of a few places far apart, and all that a fit knows."""
    some = pixels(3, 3)
    points = on_floor(found.floor(some))
    error = TRUTH.floor(some) - points[:, :2]
    return float(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.spread(points)), error).mean()) / 2.0


@pytest.mark.slow
@pytest.mark.parametrize("stated", [1.0, 0.3])
def test_the_predicted_error_is_true_whatever_was_stated_of_the_noise(stated: float) -> None:
    ratios = [chi_square(fit([seen(np.random.default_rng(k), stated=stated)], SIZE).projector) for k in range(6)]
    assert 0.5 < np.mean(ratios) < 1.6


@pytest.mark.slow
def test_the_errors_that_a_camera_has_everywhere_count() -> None:
    """A shift, a turn about the middle: of the whole floor, so that no residual shows them."""
    left = np.column_stack([-FLOOR[:, 1], FLOOR[:, 0]])
    common = np.stack([np.tile([2e-3, 0.0], (len(FLOOR), 1)), np.tile([0.0, 2e-3], (len(FLOOR), 1)), 1e-3 * left], 2)
    ratios = [chi_square(fit([seen(np.random.default_rng(k), common)], SIZE).projector) for k in range(6)]
    assert 0.4 < np.mean(ratios) < 1.8


def test_wrong_tags_are_left_out() -> None:
    own = seen(np.random.default_rng(3))
    own.floor[[5, 40, 77]] += [[0.5, 0.1], [-0.01, 0.0], [0.0, 0.004]]
    found = fit([own], SIZE)
    assert set(np.flatnonzero(~found.used)) >= {5, 40, 77}
    assert np.count_nonzero(found.used) > len(FLOOR) - 8
    assert np.linalg.norm(found.projector.floor(pixels()) - FLOOR, axis=1).max() < 3 * SIGMA_M


def test_too_few_tags_are_refused() -> None:
    own = seen(np.random.default_rng(3))
    with pytest.raises(FitError, match="11 tags of the pattern were read, 12 are needed"):
        fit([Seen(own.pixels[:11], own.floor[:11], own.covariance[:11], own.by_camera[:11])], SIZE)
