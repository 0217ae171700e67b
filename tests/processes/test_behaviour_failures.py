"""A behaviour that fails: its group stands at once, the run is held, nobody else is disturbed, and it is named."""

from pathlib import Path

import numpy as np
import pytest

from robofleet.clock import MS
from robofleet.config.load import load_config
from robofleet.processes.lockstep import Lockstep
from robofleet.processes.replay import replay, tolerance
from robofleet.recording.run import Run
from robofleet.safety.supervisor import Event, Phase
from tests.processes.broken_behaviours import AT_S, Broken

SWIRL = Path(__file__).parents[2] / "configs" / "swirl.yaml"
BROKEN = f"{Broken.__module__}:{Broken.__qualname__}"
REST_NS = 130 * MS


def two_groups(how: str) -> Lockstep:
    """Return a fleet of which r1 and r2 turn on the spot until their behaviour fails, and r3 goes on turning."""
    kinds = [("failing", "[r1, r2]", how), ("sound", "[r3]", "never")]
    entries = [
        f"{{name: {name}, behaviour: '{BROKEN}', robots: {robots}, settings: {{how: {what}}}}}"
        for name, robots, what in kinds
    ]
    groups = f"groups=[{', '.join(entries)}]"
    return Lockstep(load_config(SWIRL, [groups, "tracker.source=truth", "run.duration_s=2"]))


@pytest.mark.parametrize(
    ("how", "event", "robot"),
    [
        ("raises", Event.BEHAVIOUR_RAISED, "r1"),
        ("not_finite", Event.BEHAVIOUR_NOT_FINITE, "r2"),
        ("shape", Event.BEHAVIOUR_SHAPE, "r1"),
    ],
)
def test_its_group_stands_at_once_and_the_run_is_held(
    how: str, event: Event, robot: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lockstep = two_groups(how)
    outcome, cause = lockstep.run()
    assert outcome == "fault"
    assert cause is not None
    assert cause.startswith(f"{robot}: the behaviour of its group failing ")
    run = Run(lockstep.recording, every_tick=True)
    failed = run.items["failed"]
    k = int((failed[:, 0] > 0).argmax())
    named = int(robot == "r2")
    assert run.ticks["run_tick"][k] == pytest.approx(AT_S / 0.033, abs=1.5)
    assert failed[k, named] == event
    assert failed[k, 1 - named] == Event.BEHAVIOUR_STANDS
    assert not failed[:, 2].any()  # the other group
    wheels = np.stack([run.items["left_rad_s"], run.items["right_rad_s"]], axis=-1)
    assert wheels[k - 1].all()
    assert not wheels[k:, :2].any()
    held = k + int((run.ticks["run_tick"][k:] < 0).argmax())
    assert held - k <= 2
    assert wheels[k : held - 1, 2].all()  # it drives on until the run is held
    assert not wheels[held:, 2].any()
    assert told_to_stand_after_ns(run, int(run.ticks["stamp_ns"][k])) <= REST_NS
    told = capsys.readouterr().err
    assert f"group failing, {robot}: Broken returned" in told
    assert ("RuntimeError: the law has no solution" in told) == (how == "raises")
    verdict = replay(lockstep.recording, tolerance(lockstep.recording))
    assert verdict.equal, verdict.lines()


def told_to_stand_after_ns(run: Run, since_ns: int) -> int:
    """Return how long it takes until every robot's wheels are told to stand."""
    told = [(status["stamp_ns"], status["left_told_rad"]) for status in run.statuses]
    return max(int(stamps[1:][np.diff(angles) != 0.0].max()) - since_ns for stamps, angles in told)


def test_resume_asks_it_again() -> None:
    lockstep = two_groups("raises")
    lockstep.request(b"start")
    assert lockstep.advance(30.0, lambda: lockstep.status.phase is Phase.HOLD)
    lockstep.advance(0.5)
    lockstep.request(b"resume")
    assert lockstep.advance(1.0, lambda: lockstep.status.phase is Phase.RUNNING)
    lockstep.advance(1.0)
    assert lockstep.status.phase is Phase.RUNNING
    run = Run(lockstep.recording)
    lockstep.close()
    assert not run.items["failed"][-1].any()
    assert run.items["left_rad_s"][-1].all()
