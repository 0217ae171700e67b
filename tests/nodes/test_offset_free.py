"""Robots with worn wheels, a wide dead band and a sagging battery: the paper's law, and the offset-free one."""

import pytest

from robofleet.config.load import load_config
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from tests.robots import stalls
from tests.shipped import PLATOON

WORN = ("wheel_gain_error=-0.08", "deadband_rad_s=1.0", "breakaway_rad_s=1.2", "top_speed_sag=0.3")


def leader_timed_error_mm(disturbance: str) -> float:
    overrides = [f"robots.{i}.vehicle.simulated.{fault}" for i in range(4) for fault in WORN]
    run = Lockstep(
        load_config(
            PLATOON,
            [*overrides, f"controller.disturbance={disturbance}", "tracker.source=truth", "run.duration_s=20"],
        )
    )
    assert run.run() == ("completed", None)
    figures = summary(run.recording, name="worn", mode="lockstep", outcome="completed", cause=None)
    mean: float = figures["timed_error_mm"]["per_robot_mean"][0]
    return mean


@pytest.mark.slow
def test_the_offset_vanishes() -> None:
    without, with_estimate = leader_timed_error_mm("none"), leader_timed_error_mm("estimated")
    assert without > 4.0  # T w: 0.6 s times 8 % of about 0.1 m/s
    assert with_estimate < 2.5
    assert with_estimate < without / 3


@pytest.mark.slow
def test_a_stalled_robot_is_not_run_into() -> None:
    overrides = ["tracker.source=truth", "controller.disturbance=estimated", "run.duration_s=20"]
    run = Lockstep(load_config(PLATOON, [*overrides, stalls("r2", 12, 17)]))
    assert run.run() == ("completed", None)
    figures = summary(run.recording, name="stall", mode="lockstep", outcome="completed", cause=None)
    assert figures["min_centre_distance_mm"] >= 110
