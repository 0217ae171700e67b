"""The tracker's accuracy on a few ray-cast frames; the whole table: ``python -m tools.measure.tracking.accuracy``."""

import pytest

from tests.tracking.peers import OURS, UNTIMED
from tools.measure.tracking.accuracy import SCENES, evaluate


@pytest.mark.slow
@pytest.mark.parametrize(
    ("title", "frames"), [("noise 3.5", (8,)), pytest.param("fisheye", (8,), marks=pytest.mark.long)]
)
def test_placed_to_hundredths_of_a_millimetre(title: str, frames: tuple[int, ...]) -> None:
    row = evaluate(SCENES[title], [OURS], frames)[OURS]
    assert row["wrong"] == 0
    assert row["measured"] >= 0.995
    assert row["rms_mm"] <= 0.03
    assert row["rms_deg"] <= 0.05


@pytest.mark.slow
def test_followed_under_a_cable() -> None:
    row = evaluate(SCENES["cable of 2 px"], [OURS], [5])[OURS]
    assert row["wrong"] == 0
    assert row["measured"] >= 0.95


@pytest.mark.long
def test_followed_when_the_light_goes_out() -> None:
    row = evaluate(SCENES["15 % light"], [OURS], [8])[OURS]
    assert row["wrong"] == 0
    assert row["measured"] == 1.0


@pytest.mark.slow
def test_rolling_shutter_is_accounted_for() -> None:
    rows = evaluate(SCENES["rolling shutter, 20 ms"], [OURS, UNTIMED], [6])
    assert rows[OURS]["measured"] >= 0.995
    assert rows[OURS]["rms_mm"] <= 0.1
    assert rows[UNTIMED]["rms_mm"] > 0.5  # 0.2 m/s for up to 10 ms
