"""What is refused of a projector, and what a calibration is worth: by readings of a camera, without images."""

from dataclasses import replace

import numpy as np
import pytest

from robofleet.calibration.projector.measured import Found, measure, verify
from robofleet.calibration.store import CalibrationError
from robofleet.projection.model import Projector
from robofleet.projection.patterns import Grid, Reading
from robofleet.tracking.camera import CameraGeometry
from tests.projection.projectors import SIZE, on_floor, tilted
from tests.shipped import OVERHEAD

GRID, TRUTH, CAMERA = Grid(SIZE), tilted(), CameraGeometry.from_model(OVERHEAD)
ARENA = 2.8, 1.6


def reading(truth: Projector = TRUTH, blur_px: float = 1.0, seed: int = 1) -> Reading:
    """What the shipped camera reads of a grid, with noise of 0.02 px."""
    floor = on_floor(truth.floor(GRID.centres))
    tags = np.flatnonzero(CAMERA.sees(floor, (OVERHEAD.width, OVERHEAD.height)))
    noise = 0.02 * np.random.default_rng(seed).standard_normal((len(tags), 2))
    return Reading(tags, CAMERA.project(floor[tags]) + noise, np.full(len(tags), 0.02), 0.5, 0.0, 1.0, blur_px)


def measured(own: Reading, others: tuple[Projector | None, ...] = (), arena: tuple[float, float] = ARENA) -> Found:
    return measure("main", GRID, {"overhead": OVERHEAD}, {"overhead": own}, 0.05, arena, others, 0.95, {})


def test_a_projector_is_measured() -> None:
    found = measured(reading())
    lit = np.isfinite(found.sigma_m)
    off = TRUTH.floor(found.fit.projector.pixels(found.points[lit])) - found.points[lit, :2]
    assert lit.mean() > 0.95
    assert np.linalg.norm(off, axis=1).max() < 1e-3
    assert Projector.from_model(found.model).spread(found.points[lit]) == pytest.approx(
        found.fit.projector.spread(found.points[lit]), rel=1e-2, abs=1e-13
    )
    assert found.model.delay_s == 0.05
    assert found.notes == (
        "overhead: its file does not say how well its pose is known: that is not part of the predicted error",
    )


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("own", "fault"),
    [
        (replace(reading(), lit=0.0, tags=np.empty(0, int)), r"no camera \(overhead\) sees its light: switch it on"),
        (replace(reading(), saturated=0.8), "its white is too bright for overhead: shorten camera.exposure_s"),
        (
            Reading(np.empty(0, int), np.empty((0, 2)), np.empty(0), 0.5, 0.0, 1.0, np.nan),
            "its light is seen, but 0 tags of its pattern are read, 12 are needed: focus it",
        ),
        (reading(blur_px=4.0), "out of focus: an edge is 1..* mm wide on the floor"),
        (reading(tilted(1.4)), ".. % of the arena is lit by a pattern that a camera sees, less than 95"),
    ],
    ids=["unseen", "bright", "unread", "blurred", "half"],
)  # fmt: skip
def test_one_that_cannot_be_used_is_refused_in_a_line(own: Reading, fault: str) -> None:
    with pytest.raises(CalibrationError, match=f"projector main: {fault}") as refused:
        measured(own)
    assert len(refused.value.faults) == 1


@pytest.mark.slow
def test_projectors_cover_an_arena_together() -> None:
    wide = 4.0, 1.4
    left, right = tilted(-0.9), tilted(0.9)
    with pytest.raises(CalibrationError, match="of the arena is lit"):
        measured(reading(left), arena=wide)
    assert "calibrate the other projectors, too" in measured(reading(left), (None,), wide).notes[-1]
    assert measured(reading(left), (right,), wide).covered > 0.95


@pytest.mark.slow
def test_a_knock_is_told_and_noise_is_not() -> None:
    model = measured(reading()).model
    assert "falls where its calibration says" in verify("main", model, measured(reading(seed=2)))
    knocked = TRUTH.changed(np.array([0.002, *[0.0] * 12]))
    with pytest.raises(CalibrationError, match=r"its light now falls \d.* mm from where its calibration says"):
        verify("main", model, measured(reading(knocked)))
