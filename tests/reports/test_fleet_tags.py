"""A robot of the fleet that is in no group is no false identity."""

from robofleet.config.load import load_config
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from tests.shipped import PLATOON


def test_a_parked_robot_is_no_false_id() -> None:
    config = load_config(PLATOON, ["run.duration_s=1", "tracker.source=truth", "groups.0.robots=[r1, r2]"])
    lockstep = Lockstep(config)
    outcome, cause = lockstep.run()
    figures = summary(lockstep.recording, name="platoon", mode="lockstep", outcome=outcome, cause=cause)
    assert figures["tracker"]["false_ids"] == 0
    assert figures["tracker"]["measured_fraction"] <= 1.0
