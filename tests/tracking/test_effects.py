"""What cameras do to images, and how the tracker bears it, beside pyapriltags: ``effects.py`` has the whole table."""

import pytest

from tools.measure.tracking.effects import EFFECTS, evaluate

NAMES = ("JPEG 70", "sRGB", "sharpening", "webcam")


@pytest.mark.slow
def test_tags_are_placed_better_than_by_the_best_peer() -> None:
    rows = dict(evaluate({name: EFFECTS[name] for name in NAMES}, 36.0, 8, 80))
    assert rows.keys() == set(NAMES)
    for row in rows.values():
        assert row["wrong"] == 0
        assert row["measured"] == 1.0
        assert row["ratio"] > 1.5
