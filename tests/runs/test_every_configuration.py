"""Every shipped configuration in lockstep: a seed gives the same bytes, and a recording replays to the last bit."""

from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.recording.run import Recording
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.replay import replay

CONFIGS = Path(__file__).parents[2] / "configs"
# Robots, or twins of them on serial lines, that are there or not.
OF_A_LABORATORY = {"firmware", "lab", "mixed", "platoon-serial"}
SHIPPED = sorted({file.stem for file in CONFIGS.glob("*.yaml")} - OF_A_LABORATORY)
QUICK = {"go-to", "two-groups"}
SLOW = pytest.mark.long  # of some: the same test


def driven(name: str, *changes: str) -> Recording:
    """Return a run of some seconds; a group that a script or a person drives hears nothing."""
    run = Lockstep(load_config(CONFIGS / f"{name}.yaml", changes))
    outcome, cause = run.run()
    assert outcome == "completed", cause
    return run.recording


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else SLOW) for name in SHIPPED])
def test_two_runs_of_a_seed_are_equal_and_one_replays_to_the_last_bit(name: str) -> None:
    duration = f"run.duration_s={2 if name in QUICK else 6}"
    first, other = driven(name, duration), driven(name, duration)
    assert first.trace_hash == other.trace_hash
    assert first.messages == other.messages
    verdict = replay(first, 0.0)
    assert verdict.equal, verdict.lines()
    assert verdict.ticks > 0
    assert verdict.commands > 0


def test_every_shipped_configuration_is_among_them() -> None:
    assert len(SHIPPED) > 15
    assert {"platoon", "script", "teleop", "mocap", "two-cameras"} <= {*SHIPPED}
