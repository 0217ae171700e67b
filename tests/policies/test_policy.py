"""The behaviour ``policy``: what it observes and asks for, what it earns, what is refused, and whole runs."""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from robofleet.cli import app
from robofleet.config.load import ConfigError, load_config, resolved_yaml
from robofleet.core import refusal
from robofleet.policies import described
from robofleet.policies.interface import top_speeds, width
from robofleet.policies.policy import PolicyBehaviour
from robofleet.recording.run import Run
from robofleet.runs.check import load_checked
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.replay import replay
from robofleet.safety.supervisor import Event
from robofleet.testing.behaviours import AHEAD, drive, make, refusals, situation, team
from tests.policies.small_policies import GOALS, SETTINGS, STARTS, column, go_to, laboratory, network, saved, to_goal
from tests.shipped import SHIPPED

POSES = np.array([[x, y, math.radians(heading)] for x, y, heading in STARTS.values()])


def policy(file: Path, *, tick: float = 0.033, **task: Any) -> PolicyBehaviour:
    made = make(PolicyBehaviour, {"file": str(file), "task": SETTINGS | task}, team(4, tick=tick))
    assert isinstance(made, PolicyBehaviour)
    return made


def test_it_drives_its_robots_to_their_goals_and_says_what_that_earned(tmp_path: Path) -> None:
    behaviour = policy(saved(tmp_path / "p.onnx"))
    past = drive(behaviour, POSES, 12.0)
    assert np.hypot(*(past.poses[-1, :, :2] - [*GOALS.values()]).T).max() < 0.05
    assert behaviour.arrived
    (goals,) = behaviour.shapes()
    np.testing.assert_allclose(goals.points, [*GOALS.values()])
    earned = past.figures["reward"]
    assert np.isnan(earned[0]).all()  # nothing was done before
    found = behaviour.summary(past)["final_return"]["per_robot_mean"]
    assert found == pytest.approx(np.nansum(earned, axis=0), abs=1e-4)
    assert past.figures["return"] == pytest.approx(np.nancumsum(earned, axis=0))


def test_it_has_not_arrived_before_its_task_is_done_and_forgets_that_by_a_restart(tmp_path: Path) -> None:
    behaviour = policy(saved(tmp_path / "p.onnx"))
    drive(behaviour, POSES, 1.0)
    assert not behaviour.arrived
    goals = np.array([[x, y, 0.0] for x, y in GOALS.values()])
    drive(behaviour, goals, 1.0)
    assert behaviour.arrived
    behaviour.restart()
    assert not behaviour.arrived


def test_nothing_is_earned_while_the_run_is_held(tmp_path: Path) -> None:
    behaviour = policy(saved(tmp_path / "p.onnx"))
    decisions = [behaviour.decide(situation(POSES, t)) for t in (0.0, 0.033, 0.033, 0.066)]
    rewards = [decision.figures["reward"] for decision in decisions]
    assert [np.isfinite(reward).all() for reward in rewards] == [False, True, False, True]


def test_it_observes_what_its_robots_were_asked_for_in_truth(tmp_path: Path) -> None:
    weights = np.zeros((width(go_to()), 2))
    weights[column("speed"), 0] = weights[column("turn_rate"), 1] = (
        1.0  # an action is the velocity of the tick before, by its scale
    )
    behaviour = policy(saved(tmp_path / "p.onnx", network(weights)))
    behaviour.decide(situation(POSES))
    v, omega, psi = np.array([0.1, -0.05, 0.0, 0.2]), np.array([0.3, 0.0, -1.0, 0.1]), POSES[:, 2]
    c, s = np.cos(psi), np.sin(psi)
    behaviour.changed(np.stack([c * v - AHEAD * s * omega, s * v + AHEAD * c * omega], axis=1))
    decision = behaviour.decide(situation(POSES + np.array([0.01, 0.0, 0.5]), 0.033))
    assert decision.of == "body"
    np.testing.assert_allclose(
        decision.velocities, np.stack([v / 0.2, omega / 3.0], axis=1) * top_speeds(behaviour.team), atol=1e-6
    )


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ({"neighbours": 5}, "settings.file: {file} observes "),
        ({"goals": {"r1": SETTINGS["goals"]["r1"]}}, "settings.task.goals: r2"),
        ({"accuracy": 1.0}, "settings.task.accuracy: Extra inputs are not permitted: it is a key of the task go_to"),
    ],
)
def test_settings_that_its_task_cannot_have_are_refused(task: dict[str, Any], words: str, tmp_path: Path) -> None:
    file = saved(tmp_path / "p.onnx")
    assert refusals(policy(file, **task))[0].startswith(words.format(file=file))


def test_another_tick_and_another_number_of_robots_are_refused(tmp_path: Path) -> None:
    n = 3
    content = network(np.zeros((n * width(go_to()), 2 * n)))
    file = saved(tmp_path / "p.onnx", content, described(go_to(n), form="group"))
    lines = refusals(policy(file, tick=0.05))
    assert lines == [
        f"settings.file: {file} drives 3 robots, and the group has 4: name 3 in robots, or train it again",
        f"settings.file: {file} decides every 0.033 s, and controller.tick_s is 0.05: set it to 0.033, "
        "or train it again",
    ]


def test_a_network_that_takes_longer_than_its_share_of_the_tick_is_refused(tmp_path: Path) -> None:
    (line,) = [line for line in refusals(policy(saved(tmp_path / "p.onnx"), tick=1e-6)) if "decision" in line]
    assert line == "settings.file: a decision of the network the robots would stand, so train a smaller network"


def test_without_onnxruntime_a_line_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refusal, "find_spec", lambda _: None)
    (line,) = refusals(policy(saved(tmp_path / "p.onnx", network(to_goal(go_to()) * 2.0))))
    assert line.startswith("settings.file: this needs onnxruntime: ")


def test_its_file_stands_beside_the_configuration_and_a_resolved_one_names_its_content(tmp_path: Path) -> None:
    config = load_config(laboratory(saved(tmp_path / "go_to.onnx").parent))
    name = str(config.groups[0].settings["file"])
    assert name.startswith(f"{tmp_path / 'go_to.onnx'}#sha256=")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "config.yaml").write_text(resolved_yaml(config))
    assert load_config(elsewhere / "config.yaml") == config


@pytest.mark.parametrize(
    ("name", "words"),
    [("gone.onnx", "{folder}/gone.onnx: there is no such file: mend its name"), ("go_to.pt", "{folder}/go_to.pt: a ")],
)
def test_a_file_that_is_not_there_is_refused_where_it_is_named(name: str, words: str, tmp_path: Path) -> None:
    file = laboratory(saved(tmp_path / "go_to.onnx").parent, file=name)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    (fault,) = caught.value.faults
    line = 1 + next(k for k, text in enumerate(file.read_text().splitlines()) if name in text)
    assert fault.startswith(f"{file}:{line}:11: groups.0.settings.file: {words.format(folder=tmp_path)}")


def test_the_path_of_a_task_is_named_as_that_of_a_behaviour() -> None:
    config = load_config(SHIPPED / "policy-platoon.yaml", ["groups.0.settings.task.path=oval"])
    oval = yaml.safe_load((SHIPPED / "paths" / "oval.yaml").read_text())
    assert config.groups[0].settings["task"] == {"path": oval}


def test_a_task_of_your_own_stands_beside_its_policy(tmp_path: Path) -> None:
    (tmp_path / "my_own_tasks.py").write_text("from robofleet.policies.go_to import GoTo\n\nclass Mine(GoTo): ...\n")
    file = laboratory(saved(tmp_path / "go_to.onnx").parent)
    description = tmp_path / "go_to.json"
    tree = json.loads(description.read_text())
    tree["task"]["name"] = "my_own_tasks:Mine"
    description.write_text(json.dumps(tree))
    load_checked(file, lockstep=True)
    (tmp_path / "my_own_tasks.py").unlink()
    tree["task"]["name"] = "no_tasks:Mine"
    description.write_text(json.dumps(tree))
    with pytest.raises(ConfigError, match="'no_tasks:Mine' cannot be loaded: No module named 'no_tasks'"):
        load_checked(file, lockstep=True)


@pytest.mark.slow
def test_nan_from_the_network_holds_the_run_and_names_the_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    n = len(STARTS)
    weights = np.zeros((n * width(go_to()), 2 * n))
    weights[:, 3] = np.nan  # omega of r2
    saved(tmp_path / "go_to.onnx", network(weights), described(go_to(n), form="group"))
    lockstep = Lockstep(load_checked(laboratory(tmp_path), ["run.duration_s=1"], lockstep=True))
    outcome, cause = lockstep.run()
    assert outcome == "fault"
    assert cause is not None and cause.startswith("r2: the behaviour")
    assert "group policy, r2: PolicyBehaviour returned a velocity" in capsys.readouterr().err
    failed = Run(lockstep.recording, every_tick=True).items["failed"]
    assert failed[failed.any(axis=1)][0].tolist() == [
        Event.BEHAVIOUR_STANDS, Event.BEHAVIOUR_NOT_FINITE, Event.BEHAVIOUR_STANDS, Event.BEHAVIOUR_STANDS,
    ]  # fmt: skip


@pytest.mark.slow
def test_a_run_of_a_policy_arrives_and_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    saved(tmp_path / "go_to.onnx")
    lockstep = Lockstep(load_checked(laboratory(tmp_path), lockstep=True))
    assert lockstep.run() == ("completed", None)
    (group,) = Run(lockstep.recording).parts
    assert np.hypot(*(group.past.poses[-1, :, :2] - [*GOALS.values()]).T).max() < 0.06
    verdict = replay(lockstep.recording, 0.0)
    assert verdict.equal, verdict.lines()
    assert verdict.ticks > 100


@pytest.mark.slow
def test_a_run_is_replayed_by_the_same_policy_wherever_it_is_and_by_no_other(tmp_path: Path) -> None:
    lab, moved = tmp_path / "lab", tmp_path / "moved"
    lab.mkdir()
    moved.mkdir()
    file, run = laboratory(saved(lab / "go_to.onnx").parent), str(tmp_path / "run")
    done = CliRunner().invoke(app, ["run", str(file), "--lockstep", "--set", "run.duration_s=2", "--out", run])
    assert done.exit_code == 0, done.stderr
    figures = json.loads((tmp_path / "run" / "summary.json").read_text())["groups"]["policy"]
    assert {"reward", "final_return"} <= figures.keys()
    for name in ("go_to.onnx", "go_to.json"):
        (lab / name).rename(moved / name)
    assert replayed(run) == (2, "go_to.onnx: is gone")
    assert replayed(run, "--behaviours", str(moved)) == (0, "equal, bit for bit")
    saved(moved / "go_to.onnx", network(2.0 * to_goal(go_to())))
    assert replayed(run, "--behaviours", str(moved)) == (2, "go_to.onnx: it or its JSON is not what it was")


def replayed(run: str, *options: str) -> tuple[int, str]:
    """Return how a replay ended, and what it said."""
    done = CliRunner().invoke(app, ["replay", run, *options])
    words = re.search(r"go_to.onnx: (is gone|it or its JSON is not what it was)|equal, bit for bit", done.output)
    return done.exit_code, "" if words is None else words[0]


@pytest.mark.slow
def test_a_sweep_compares_policies(tmp_path: Path) -> None:
    laboratory(saved(tmp_path / "go_to.onnx").parent)
    saved(tmp_path / "idle.onnx", network(0.01 * to_goal(go_to())))
    sweep = {
        "config": "policy.yaml", "set": {"run.duration_s": 3},
        "grid": {"groups.0.settings.file": ["go_to.onnx", "idle.onnx"]}, "runs": 2,
    }  # fmt: skip
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    done = CliRunner().invoke(app, ["sweep", str(tmp_path / "sweep.yaml"), "--out", str(tmp_path / "found")])
    assert done.exit_code == 0, done.output
    rows = csv.DictReader((tmp_path / "found" / "runs.csv").read_text().splitlines())
    trained, idle = (float(row["groups.policy.final_return.mean"]) for row in rows)
    assert trained > idle
