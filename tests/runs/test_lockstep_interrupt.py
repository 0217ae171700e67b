"""Ctrl-C ends a lockstep run as it ends one in real time: with what was recorded until then."""

from collections.abc import Callable
from typing import Any

from robofleet.recording.run import Recording
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep


def test_ctrl_c_in_lockstep_leaves_a_summary(platoon_of: Callable[..., Any]) -> None:
    seconds = iter(range(2))

    def watch(_recording: Recording, _phase: str) -> None:
        if next(seconds, None) is None:
            raise KeyboardInterrupt

    lockstep = Lockstep(platoon_of("tracker.source=truth", "run.duration_s=60"))
    outcome, cause = lockstep.run(watch)
    assert (outcome, cause) == ("stopped", "the operator interrupted")
    figures = summary(lockstep.recording, name="platoon", mode="lockstep", outcome=outcome, cause=cause)
    assert 2.5 < figures["duration_s"] < 4.0
