"""Robots with worn wheels, a wide dead band and a sagging battery: the paper's law, and the offset-free one."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.robots import stalls

Truth = Callable[..., dict[str, Any]]
WORN = ("wheel_gain_error=-0.08", "deadband_rad_s=1.0", "breakaway_rad_s=1.2", "top_speed_sag=0.3")


@pytest.mark.slow
def test_the_offset_vanishes(truth: Truth) -> None:
    worn = [f"robots.{i}.vehicle.simulated.{fault}" for i in range(4) for fault in WORN]
    runs = [truth(*worn, f"controller.disturbance={how}", "run.duration_s=20") for how in ("none", "estimated")]
    assert [run["outcome"] for run in runs] == ["completed"] * 2
    without, with_estimate = (run["timed_error_mm"]["per_robot_mean"][0] for run in runs)  # the leader's
    assert without > 4.0  # T w: 0.6 s times 8 % of about 0.1 m/s
    assert with_estimate < 2.5
    assert with_estimate < without / 3


@pytest.mark.slow
def test_a_stalled_robot_is_not_run_into(truth: Truth) -> None:
    s = truth("controller.disturbance=estimated", "run.duration_s=20", stalls("r2", 12, 17))
    assert s["outcome"] == "completed"
    assert s["min_centre_distance_mm"] >= 110
