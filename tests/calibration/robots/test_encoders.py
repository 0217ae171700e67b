"""The encoders' residuals: white where the model is right, more where it is wrong, none where nothing turns."""

import numpy as np
import pytest

from robofleet.calibration.robots.encoders import Encoders, counts
from robofleet.core.arrays import Array

COUNT, TICK_S, SHOT = 0.002244, 0.02, 100
NOISE = {"stamp_s": 1e-6, "wander": 1e-6}
AT_S = np.arange(0.0, 20.0, TICK_S, dtype=np.float64)
TURNED = np.column_stack([np.cumsum(0.05 + 0.05 * np.sin(AT_S)), np.where(AT_S < 10.0, 0.0, 3.1 * (AT_S - 10.0))])
EVERYTHING = np.ones(len(AT_S), dtype=np.bool_)


def counted(turned: Array) -> Encoders:
    rounded = COUNT * np.round((turned + np.array([0.3, 0.7])) / COUNT)
    return Encoders(AT_S, rounded, np.arange(len(AT_S)) // SHOT)


def mean_squares(encoders: Encoders, scale: float = 1.0) -> list[float]:
    e, _ = encoders.residuals(TURNED, np.full(2, scale), **NOISE, chosen=EVERYTHING)
    return [float((e[e[:, side] != 0.0, side] ** 2).mean()) for side in range(2)]


def test_counts_of_an_encoder_are_found() -> None:
    angles = 0.002244 * np.array([[0, 5], [3, 9], [10, 10], [11, 30]])
    assert counts(angles) == pytest.approx(0.002244)
    assert counts(np.random.default_rng(1).normal(size=(40, 2))) == 0.0


def test_residuals_are_the_rounding_where_the_model_is_right_and_more_where_it_is_wrong() -> None:
    right, wrong = mean_squares(counted(TURNED)), mean_squares(counted(TURNED), 0.998)
    assert right == pytest.approx([1.0, 1.0], abs=0.15)
    assert min(wrong) > 1.5


def test_a_wheel_that_stands_says_nothing_and_an_instant_that_is_not_chosen_neither() -> None:
    e, _ = counted(TURNED).residuals(TURNED, np.ones(2), **NOISE, chosen=AT_S < 15.0)
    assert not e[AT_S < 10.0, 1].any()
    assert e[(AT_S > 10.1) & (AT_S < 12.0), 1].any()
    assert not e[AT_S >= 15.0].any()


def test_a_jump_is_an_outlier_and_what_follows_is_none() -> None:
    jumped = TURNED.copy()
    jumped[333:, 0] += 0.1
    encoders = counted(jumped)
    outliers = encoders.outliers(TURNED, np.ones(2), **NOISE, gate=6.0)
    assert np.argwhere(outliers).tolist() == [[333, 0]]
    encoders.kept = ~outliers
    assert mean_squares(encoders) == pytest.approx([1.0, 1.0], abs=0.15)
