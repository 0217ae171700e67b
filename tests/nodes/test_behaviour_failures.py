"""A behaviour that fails: its group stands at once, the run is held, nobody else is disturbed, and it is named."""

import json
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import MS
from robofleet.nodes.behaviour_runner import BehaviourRunner, timed_by
from robofleet.recording.reading import read
from robofleet.recording.run import Run
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.replay import replay
from robofleet.safety.supervisor import Event, Phase
from tests.command import robofleet
from tests.nodes.broken_behaviours import AT_S, Broken
from tests.runs.realrun import RealRun

SWIRL = Path(__file__).parents[2] / "configs" / "swirl.yaml"
BROKEN = f"{Broken.__module__}:{Broken.__qualname__}"
REST_NS = 130 * MS


def two_groups(how: str) -> tuple[str, ...]:
    """Return the keys of a fleet of which r1 and r2 turn on the spot until their behaviour fails, and r3 goes on."""
    kinds = [("failing", "[r1, r2]", how), ("sound", "[r3]", "never")]
    entries = [
        f"{{name: {name}, behaviour: '{BROKEN}', robots: {robots}, settings: {{how: {what}}}}}"
        for name, robots, what in kinds
    ]
    return f"groups=[{', '.join(entries)}]", "tracker.source=truth", "run.duration_s=2"


def options(how: str) -> list[str]:
    return [word for key in two_groups(how) for word in ("--set", key)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "event", "robot"),
    [
        ("raises", Event.BEHAVIOUR_RAISED, "r1"),
        ("raises_when_told", Event.BEHAVIOUR_RAISED, "r1"),
        ("not_finite", Event.BEHAVIOUR_NOT_FINITE, "r2"),
        ("shape", Event.BEHAVIOUR_SHAPE, "r1"),
        ("array", Event.BEHAVIOUR_RAISED, "r1"),
    ],
)
def test_its_group_stands_at_once_and_the_run_is_held(how: str, event: Event, robot: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    ran = robofleet("run", SWIRL, "--lockstep", *options(how), "--out", out)
    assert ran.exit_code == 1
    stderr = ran.stderr
    assert f"group failing, {robot}: Broken returned" in stderr
    assert "behaviour_runner.py" not in stderr or how.startswith("raises")
    assert ("RuntimeError: the law has no solution" in stderr) == how.startswith("raises")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome"] == "fault"
    assert summary["cause"].startswith(f"{robot}: the behaviour of its group failing ")
    run = Run(read(out), every_tick=True)
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
    is_replayed(out)


def is_replayed(out: Path) -> None:
    verdict = replay(read(out, lambda _: True), 0.0)
    assert verdict.equal, verdict.lines()
    assert verdict.ticks > 0


def told_to_stand_after_ns(run: Run, since_ns: int) -> int:
    """Return how long it takes until every robot's wheels are told to stand."""
    commanded = [(status["stamp_ns"], status["left_told_rad"]) for status in run.statuses]
    return max(int(stamps[1:][np.diff(angles) != 0.0].max()) - since_ns for stamps, angles in commanded)


@pytest.mark.slow
def test_resume_asks_it_again() -> None:
    lockstep = Lockstep(load_config(SWIRL, two_groups("raises")))
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


def test_one_that_takes_longer_than_its_share_of_a_tick_is_named_and_its_group_stands(
    capsys: pytest.CaptureFixture[str],
) -> None:
    read_ns = iter([0, 17 * MS, 17 * MS, 18 * MS])  # the failing group's decision, and the other's
    runner = BehaviourRunner(load_config(SWIRL, two_groups("never")), timed_by(read_ns.__next__, 16.5 * MS))
    everybody = np.full(3, fill_value=True)
    decisions = runner.decide(np.zeros((3, 3)), everybody, everybody, np.zeros((3, 2)), moving=True)
    assert runner.failed.tolist() == [Event.BEHAVIOUR_LATE, Event.BEHAVIOUR_STANDS, Event.NOTHING]
    assert decisions.driving.tolist() == [False, False, True]
    assert decisions.velocities[2].any()
    late = "group failing, r1: Broken returned its decision after its share of the tick was over"
    assert capsys.readouterr().err.startswith(late)


@pytest.mark.long
def test_one_that_is_late_is_named_and_everybody_stands(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*options("sleeps"), config=SWIRL)
    cause = "r1: the behaviour of its group failing took longer than its share of a tick"
    holds = 0
    while f"held: {cause}" not in run.said:
        run.wait_for(lambda holds=holds: run.said.count("held: ") > holds)
        holds += 1
        if cause not in run.said:  # a busy machine made the other group late
            run.robofleet("resume")
    run.wait_for(lambda: at_rest(run.folder))
    run.launcher.send_signal(signal.SIGINT)
    assert run.ended(120) == 1
    assert cause in run.summary["cause"]
    log = (run.folder / "log" / "controller.log").read_text()
    assert "group failing, r1: Broken returned its decision after its share of the tick was over" in log
    ticks = Run(read(run.folder), every_tick=True)
    failed, k = ticks.items["failed"], int((ticks.items["failed"][:, 0] > 0).argmax())
    assert failed[k].tolist() == [Event.BEHAVIOUR_LATE, Event.BEHAVIOUR_STANDS, Event.NOTHING]
    wheels = np.stack([ticks.items["left_rad_s"], ticks.items["right_rad_s"]], axis=-1)
    assert wheels[k - 1].all()
    assert not wheels[k:, :2].any()
    held = k + int((ticks.ticks["run_tick"][k:] < 0).argmax())
    assert not wheels[held:].any()
    is_replayed(run.folder)


def at_rest(folder: Path) -> bool:
    """Return whether the newest that every driver said of its wheels is that they were told to stand and do."""
    statuses = Run(read(folder), every_tick=True).statuses
    return all(not rows[name][-1] for rows in statuses for name in ("left_output_rad_s", "right_output_rad_s"))


def test_a_group_that_finds_no_way_holds_the_run_and_is_named() -> None:
    fence = "{name: fence, polygon_m: [[-0.02, -1.0], [0.02, -1.0], [0.02, 1.0], [-0.02, 1.0]]}"
    config = load_config(SHIPPED / "obstacles.yaml", ["tracker.source=truth", f"arena.obstacles=[{fence}]"])
    run = Lockstep(config)
    run.request(b"start")
    assert run.advance(30.0, lambda: run.status.phase is Phase.HOLD)
    assert run.status.describe(config.ids).startswith("r1: the behaviour of its group go_to finds no way to its goals")
    run.close()
