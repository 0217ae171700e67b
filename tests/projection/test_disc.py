"""Discs around robots, and what light in them tags bear."""

import pytest

from robofleet.config.load import load_config
from robofleet.projection.disc import brightest_gray, disc_radii
from tests.shipped import PLATOON


def test_a_disc_covers_body_and_tag() -> None:
    small, large = (disc_radii(load_config(PLATOON, [f"tracker.tag_side_m={side}"])) for side in (0.04, 0.12))
    assert small == pytest.approx([0.055 + 0.02] * 4)  # GTernals
    assert large == pytest.approx([0.12 * 1.25 / 2**0.5 + 0.02] * 4)


def test_white_paper_in_a_disc_stays_below_saturation() -> None:
    """Paper at a grey of 215 in the room's light; light grows with the 2.2th power of a grey."""
    for white_over_room in (0.01, 0.5, 1.0, 20.0):
        paper = 215.0 * (1.0 + white_over_room * brightest_gray(white_over_room) ** 2.2)
        assert paper < 250.0
        assert paper > 247.0 or brightest_gray(white_over_room) == 1.0
