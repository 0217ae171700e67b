"""Two cameras in lockstep: the same bytes for the same seed, a replay bit for bit, and one that is knocked."""

from pathlib import Path

import numpy as np
import pytest

from robofleet.runs.check import load_checked
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.replay import replay
from tools.measure.tracking.cameras import KNOCK_S, driven, errors, news, overlapping

KNOCK = f"cameras.1.simulated.knocks=[{{at_s: {KNOCK_S}, rotation_deg: [0.3, 0, 0]}}]"


@pytest.mark.long
def test_a_run_of_two_cameras_is_repeated_and_replayed(tmp_path: Path) -> None:
    config = load_checked(overlapping(tmp_path), ["run.duration_s=1"], lockstep=True)
    runs = [Lockstep(config) for _ in range(2)]
    assert {run.run() for run in runs} == {("completed", None)}
    first, second = (run.recording for run in runs)
    assert first.trace_hash == second.trace_hash
    verdict = replay(first, 0.0)
    assert verdict.ticks > 30
    assert verdict.equal, verdict.lines()


@pytest.mark.long
def test_a_knocked_camera_is_named_and_costs_no_accuracy(tmp_path: Path) -> None:
    recording = driven(overlapping(tmp_path), f"run.duration_s={KNOCK_S + 2}", KNOCK)
    assert recording.outcome == "completed"
    ((camera, sentence),) = news(recording)
    assert camera == "two"
    assert sentence.startswith("camera two sees robots 0.01")
    camera_errors = errors(recording)
    assert 1e3 * np.linalg.norm(camera_errors.off[camera_errors.t >= KNOCK_S + 1], axis=-1).max() <= 0.2
