"""Tag and robot: one pose from the other."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.config.calibrated import TagOffset
from robofleet.tracking.offset import centre_from_tag, tag_from_centre

METRES, ANGLES = st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi)


def test_a_tag_ahead_and_to_the_left() -> None:
    offset = TagOffset(forward_m=0.02, left_m=0.01, heading_deg=90.0)
    assert tag_from_centre(1.0, 2.0, math.pi / 2, offset) == pytest.approx((0.99, 2.02, math.pi))
    assert centre_from_tag(0.99, 2.02, math.pi, offset) == pytest.approx((1.0, 2.0, math.pi / 2))


@given(METRES, METRES, ANGLES, METRES, METRES, st.floats(-180.0, 180.0))
def test_there_and_back_again(x: float, y: float, psi: float, forward: float, left: float, heading: float) -> None:
    offset = TagOffset(forward_m=forward, left_m=left, heading_deg=heading)
    tag = tag_from_centre(x, y, psi, offset)
    assert math.dist(tag[:2], (x, y)) == pytest.approx(math.hypot(forward, left), abs=1e-12)
    again = centre_from_tag(*tag, offset)
    assert again[:2] == pytest.approx((x, y), abs=1e-12)
    assert abs(math.remainder(again[2] - psi, math.tau)) < 1e-12
    assert abs(again[2]) <= math.pi
