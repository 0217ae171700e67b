"""The whole stack on MuJoCo's robots and by MuJoCo's pixels, in lockstep."""

import pytest

from robofleet.config.load import load_config
from robofleet.testing import LockstepRun, run_lockstep
from tests.shipped import PLATOON

pytest.importorskip("mujoco")


def driven(*changes: str, seconds: float) -> LockstepRun:
    return run_lockstep(load_config(PLATOON, ["plant.model=mujoco", f"run.duration_s={seconds}", *changes]))


@pytest.mark.slow
def test_the_platoon_drives_as_exactly_as_on_the_own_plant_and_alike_each_time() -> None:
    runs = [driven("tracker.source=truth", "plant.settings={friction_spread: 0.5}", seconds=15) for _ in range(2)]
    assert [run.outcome for run in runs] == ["completed", "completed"]
    assert runs[0].trace_hash == runs[1].trace_hash
    assert runs[0].summary["control_error_mm"]["mean"] < 1.0
    assert runs[0].summary["path_error_mm"]["mean"] < 4.0
    assert "simulated robots: the physics of plant.model 'mujoco'" in runs[0].summary["remarks"]


@pytest.mark.slow
def test_by_its_pixels() -> None:
    pytest.importorskip("OpenGL")
    run = driven("camera.source=mujoco", seconds=2)
    assert run.outcome == "completed"
    assert run.summary["control_error_mm"]["mean"] < 1.0
    assert run.summary["tracker"]["measured_fraction"] > 0.99
    assert run.summary["pose_error"]["rms_mm"] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("settings", "why"), [
    ("{friction: 0.03}", "its tag did not move when its wheels were turned"),
    ("{cables_n: {r2: 3.0}}", "r2"),
])  # fmt: skip
def test_arming_finds_robots_that_cannot_drive(settings: str, why: str) -> None:
    run = driven("tracker.source=truth", f"plant.settings={settings}", seconds=5)
    assert run.outcome == "fault"
    assert why in (run.cause or "")
