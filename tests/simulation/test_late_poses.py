"""Poses that come later than the next tick are late, and not gone."""

import pytest

from robofleet.config.load import load_config
from robofleet.recording.run import Run
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Event, Phase
from tests.shipped import PLATOON


@pytest.mark.slow
@pytest.mark.parametrize("change", ["tracker.truth.delay_s=0.045", "lockstep.tracker_delay_s=0.03"])
def test_late_poses_come(change: str) -> None:
    source = "truth" if "truth" in change else "camera"
    lockstep = Lockstep(load_config(PLATOON, ["run.duration_s=1", f"tracker.source={source}", change]))
    assert lockstep.run() == ("completed", None)
    run = Run(lockstep.recording)
    assert len(run.frames) > 10
    delays_ns = [frame.sent_ns - frame.exposure_ns for frame in run.frames]
    assert min(delays_ns) > 0.9 * 1e9 * float(change.rpartition("=")[2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "held"),
    [
        (["faults=[{kind: pose_delay, at_s: 2, delay_s: 0.08}]"], False),
        (["faults=[{kind: pose_delay, at_s: 2, delay_s: 0.25}]"], True),
        (["tracker.truth.delay_s=0.25"], False),  # it is stated
    ],
)
def test_poses_that_are_later_than_stated_hold_the_run(changes: list[str], held: bool) -> None:
    lockstep = Lockstep(load_config(PLATOON, ["tracker.source=truth", *changes]))
    lockstep.request(b"start")
    assert lockstep.advance(60.0, lambda: lockstep.status.phase is Phase.RUNNING)
    assert lockstep.advance(5.0, lambda: lockstep.status.phase is not Phase.RUNNING) is held
    if held:
        assert (lockstep.status.phase, lockstep.status.cause) == (Phase.HOLD, Event.TRACKER_SILENT)
    lockstep.close()
