"""The covariances are true, and edges along the rows do not bias; ``certainty.py`` has the whole tables."""

import math

import numpy as np
import pytest

from robofleet.config.calibrated import TagOffset
from robofleet.tracking.offset import centre_covariance, centre_from_tag
from tools.measure.tracking.certainty import Scene, biases, certainty

LENS = 0.7  # sigma [px]


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [Scene(lens=LENS), Scene(lens=LENS, light=0.15), Scene(lens=LENS, covered=0.2)],
    ids=["plain", "dark", "covered"],
)
def test_squared_errors_are_as_large_as_said(scene: Scene) -> None:
    row = certainty(scene, 80)
    assert 0.8 < row["chi2_xy"] < 1.3  # of 160 numbers: 1 +- 0.11
    assert 0.7 < row["chi2_psi"] < 1.4
    assert row["worst_sigma"] < 5.0
    assert row["alike"] > 0.9


def test_edges_along_the_rows_do_not_bias() -> None:
    ((_, bias_px, worst_mm),) = biases(np.array([0.0]), 160, LENS)
    assert bias_px < 0.01
    assert worst_mm < 0.03


def test_a_robots_centre_is_as_sure_as_its_tag_and_its_heading() -> None:
    """By 20,000 poses of a tag, against the mean over them."""
    of_tag = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.4], [0.5, -0.4, 2.0]]) * 1e-8
    offset, psi = TagOffset(forward_m=0.03, left_m=-0.02, heading_deg=12.0), 0.7
    drawn = np.random.default_rng(1).multivariate_normal([0.4, -0.2, psi], of_tag, 20_000)
    centres = np.array([centre_from_tag(*pose, offset) for pose in drawn.tolist()])
    seen = np.cov(centres.T)
    xx, xy, yy = of_tag[0, 0], of_tag[0, 1], of_tag[1, 1]
    covariance = centre_covariance((xx, xy, yy, of_tag[0, 2], of_tag[1, 2], of_tag[2, 2]), psi, offset)
    for value, (i, j) in zip(covariance, ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        assert value == pytest.approx(seen[i, j], abs=0.04 * math.sqrt(seen[i, i] * seen[j, j]))
