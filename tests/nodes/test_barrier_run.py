"""The barrier in the controller's tick: what it leaves alone, what it changes, and that everybody is told."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.config.tree import Config
from robofleet.recording.run import Run
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from robofleet.vehicles.differential_drive import body_from_wheels
from tests.robots import stalls

TRUTH = "tracker.source=truth"
CLOSER = "robots.2.start={x_m: -1.463, y_m: 0.116, heading_deg: 50.0}"  # 0.16 m behind r2


@pytest.fixture(scope="module")
def started(platoon_of: Callable[..., Config]) -> Lockstep:
    """Return a run whose robots start too close to each other."""
    run = Lockstep(platoon_of(TRUTH, CLOSER, "run.duration_s=12"))
    assert run.run() == ("completed", None)
    return run


@pytest.mark.slow
def test_a_platoon_that_has_found_its_spacing_is_left_alone(started: Lockstep) -> None:
    run = Run(started.recording)
    filtered = run.items["filtered"]
    assert filtered[run.t < 5.0].any()
    assert not filtered[run.t >= 5.0].any()
    assert not run.items["blocked"].any()
    figures = summary(started.recording, name="platoon", mode="lockstep", outcome="completed", cause=None)
    assert figures["filtered_fraction"] == pytest.approx((filtered > 0).mean(), abs=1e-4)


def test_the_input_on_record_is_what_the_wheels_are_told(started: Lockstep) -> None:
    """Filtered or not: the law predicts with the one, the robot drives by the other."""
    run, config = Run(started.recording), started.recording.config
    items, vehicle = run.items, config.robots[0].vehicle
    assert (items["filtered"] > 0).any()
    v, omega = body_from_wheels(items["left_rad_s"], items["right_rad_s"], vehicle.wheel_radius_m, vehicle.wheel_base_m)
    speeds = np.hypot(v, config.controller.point_ahead_m * omega)
    assert np.hypot(items["u_x_m_s"], items["u_y_m_s"]) == pytest.approx(speeds, abs=1e-9)


@pytest.mark.slow
def test_behind_a_robot_that_stalls_bodies_stay_apart(truth: Callable[..., dict[str, Any]]) -> None:
    s = truth("run.duration_s=20", "groups.0.settings.spacing_m=0.215", stalls("r2", 8, 20))
    assert s["outcome"] == "completed"
    assert s["min_gap_mm"] >= 10.0
