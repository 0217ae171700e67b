"""Poses that come later than the next tick are late, and not gone."""

import pytest

from robofleet.config.load import load_config
from robofleet.recording.run import Run
from robofleet.runs.lockstep import Lockstep
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
