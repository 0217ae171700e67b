"""A robot in no image, whose own word of where it is cannot be used: it is not seen, and nobody drives blindly."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from robofleet.drivers.simulated import SimulatedRobot
from robofleet.vehicles.readings import TruePose

Make = Callable[..., dict[str, Any]]


class Nowhere(SimulatedRobot):
    """A robot that does not know any more where it is once it has gone some way."""

    def truth(self) -> TruePose:
        """Return the true pose, at last one that cannot be."""
        pose = super().truth()
        return pose if self.read().left_angle < 20.0 else pose._replace(y=math.nan)


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", ["tracker.source=truth", pytest.param("robots.1.reality=simulated", marks=pytest.mark.long)]
)
def test_a_robot_that_says_it_is_nowhere_ends_the_run_and_is_named(lockstep: Make, how: str) -> None:
    s = lockstep(how, "run.duration_s=20", f"robots.1.driver='{__name__}:Nowhere'")
    assert s["outcome"] == "fault"
    assert s["cause"] == "r2: the tracker lost the robot"
    assert s["stops"], "it was made to stand before"
