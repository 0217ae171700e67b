"""The example scripts do what each is for: in lockstep, as a user starts them."""

import os
import pty
import re
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet import Fleet
from tests.runs.realrun import wait
from tests.scripts.examples import EXAMPLES, Watched, loaded, seen, started

BARRIER_MM = 10  # gap_m of the configuration


def kept(ran: dict[str, Any]) -> dict[str, Any]:
    """Return the figures that an example keeps, of a run in which no body came too near to another."""
    summary = ran["fleet"].summary
    assert summary["outcome"] == "completed"
    assert summary["min_gap_mm"] >= BARRIER_MM
    return dict(summary["groups"]["script"]["kept"])


def test_every_example_is_short_and_says_how_it_is_started() -> None:
    table = (EXAMPLES / "README.md").read_text()
    for file in EXAMPLES.glob("*.py"):
        text = file.read_text()
        assert f"\nStart it with: python configs/examples/{file.name}" in text
        lines = text.count("\n")
        assert lines <= 85
        assert re.search(rf"^\| \[{file.name}\]\({file.name}\) \| .* \| {lines} \|$", table, re.MULTILINE)
    assert len([*EXAMPLES.glob("*.py")]) == table.count(".py](")


@pytest.mark.slow
def test_hello_stops_on_each_corner_of_the_square_and_the_others_stand() -> None:
    ran = started("hello")
    at = np.array(ran["fleet"].arrived)
    assert at[:, 0, :2] == pytest.approx(np.array(ran["CORNERS"])[:, :2], abs=0.005)
    assert np.ptp(at[:, 1:], axis=0).max() < 0.005


@pytest.mark.slow
def test_consensus_is_at_least_as_fast_as_the_connectivity_says() -> None:
    ran = started("consensus")
    times, _, points = seen(ran)
    spread = np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=(1, 2))
    assert kept(ran)["spread_m"] == pytest.approx(spread[-1])
    early = times < 10.0
    ring_of_four = 2.0
    assert (spread <= 1.02 * spread[0] * np.exp(-ran["K"] * ring_of_four * times))[early].all()
    assert spread[-1] < 0.6  # as near as bodies come


@pytest.mark.slow
def test_formation_has_each_shape() -> None:
    ran = started("formation")
    figures = kept(ran)
    assert max(max(figures[f"{name}_error_mm"]) for name in ran["SHAPES"]) < 25
    last = seen(ran)[2][-1]
    assert last - last.mean(axis=0) == pytest.approx(ran["shape"], abs=0.025)


@pytest.mark.slow
def test_followers_keep_their_gaps_behind_a_leader_on_its_way() -> None:
    ran = started("leader_followers")
    times, _, points = seen(ran)
    assert np.array(kept(ran)["gap_mm"]) == pytest.approx(300, abs=15)
    gaps = np.linalg.norm(np.diff(points, axis=1), axis=2)
    assert gaps == pytest.approx(0.3, abs=0.06)
    late = times > 5.0
    assert np.array([ran["oval"](t)[0] for t in times[late]]) == pytest.approx(points[late, 0], abs=0.02)


@pytest.mark.slow
def test_cyclic_pursuit_ends_on_the_circle_equally_spaced() -> None:
    ran = started("cyclic_pursuit")
    figures = kept(ran)
    assert np.array(figures["off_circle_mm"]) == pytest.approx(0, abs=40)
    assert np.array(figures["gap_mm"]) == pytest.approx(1e3 * ran["chord"], abs=40)
    z = seen(ran)[2][-60:] @ [1, 1j]
    turned = np.unwrap(np.angle(z - z.mean(axis=1, keepdims=True)), axis=0)
    assert turned[-1] - turned[0] == pytest.approx(2.0 * ran["SPEED"] / ran["RADIUS"], rel=0.2)  # of 2 s


@pytest.mark.slow
def test_coverage_goes_down_the_locational_cost() -> None:
    ran = started("voronoi_coverage")
    figures, costs = kept(ran), np.array(ran["costs"])
    assert figures["cost_after_m2"] < 0.6 * figures["cost_before_m2"]
    assert np.diff(costs).max() < 1e-3 * costs[0]  # noise of the poses


@pytest.mark.slow
def test_the_flow_tracks_within_the_papers_error_and_its_sensitivity_is_the_derivative() -> None:
    ran = started("newton_raphson_flow")
    figures = kept(ran)
    assert figures["control_error_mm"] < 5.0  # the paper's robots
    assert figures["tracking_error_mm"] < 5.0
    times, _, points = seen(ran)
    radius = np.linalg.norm(points[times > 1.4] / ran["RADII"], axis=2)
    assert radius == pytest.approx(1.0, abs=0.01)
    x, u, step = np.array([0.1, -0.2, 0.7]), np.array([0.12, 0.9]), 1e-6
    _, sensitivity = ran["predict"](x, u)
    for d, derivative in zip(step * np.eye(2), sensitivity.T, strict=True):
        by_differences = (ran["predict"](x, u + d)[0] - ran["predict"](x, u - d)[0]) / (2 * step)
        assert derivative == pytest.approx(by_differences, abs=1e-8)


@pytest.mark.slow
def test_robots_reach_their_goals_between_obstacles() -> None:
    ran = started("obstacles")
    figures = kept(ran)
    assert max(figures["from_goal_mm"]) < 15
    points = seen(ran)[2]
    away = np.linalg.norm(points[:, :, None] - ran["DISCS"], axis=3)
    assert figures["nearest_to_an_obstacle_mm"] == pytest.approx(1e3 * away.min())
    assert away.min() > ran["KEEP"] - 0.01


@pytest.mark.slow
def test_model_predictive_control_parks_round_the_obstacle() -> None:
    ran = started("mpc")
    figures = kept(ran)
    assert figures["from_goal_mm"] < 1e3 * ran["NEAR"][0]
    assert abs(ran["off"][2]) < ran["NEAR"][1]
    centres = seen(ran)[1][:, 0, :2]
    assert np.linalg.norm(centres - ran["OBSTACLE"], axis=1).min() > ran["RADIUS"] - 0.005


def test_without_casadi_a_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(SystemExit) as ended:
        started("mpc")
    assert (ended.value.code, capsys.readouterr().err.count("\n")) == (2, 1)


@pytest.mark.slow
def test_keys_drive_the_chosen_robot() -> None:
    teleop = loaded("teleop")
    with Watched(teleop.CONFIG, lockstep=True) as fleet:
        before = fleet.poses
        teleop.teleoperate(fleet, ["w"] * 4 + [""] * 60 + [" "] + [""] * 30)
        ahead = fleet.poses - before
        assert ahead[0, 0] == pytest.approx(0.08 * 62 * fleet.tick_s, rel=0.15)
        assert not np.abs(ahead[1:]).max() > 0.003
        teleop.teleoperate(fleet, [*"3aa", *[""] * 30, "9", "?", *" w"])
        turned = fleet.poses[:, 2] - before[:, 2]
        assert np.remainder(turned[2], 2 * np.pi) == pytest.approx(0.6 * 32 * fleet.tick_s, rel=0.2)
        before = fleet.poses
        teleop.teleoperate(fleet, "s" * 90)
        backed = before[0, 0] - fleet.poses[0, 0]
        assert 0.3 < backed < 90 * fleet.tick_s * teleop.LIMIT[0]
    assert fleet.summary["min_gap_mm"] >= BARRIER_MM


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Make stdin a terminal; return the end at which keys are pressed."""
    ours, theirs = pty.openpty()
    before = os.dup(0)
    os.dup2(theirs, 0)
    yield ours
    os.dup2(before, 0)
    for descriptor in (before, ours, theirs):
        os.close(descriptor)


def test_keys_come_one_by_one_without_enter_until_q_and_the_terminal_is_given_back(keyboard: int) -> None:
    before = termios.tcgetattr(0)
    keys = loaded("teleop").keyboard()
    assert next(keys) == ""
    os.write(keyboard, b"wd")
    assert wait(lambda: next(keys) == "w", 5)
    assert next(keys) == "d"
    os.write(keyboard, b"q")
    assert set(keys) <= {""}
    assert termios.tcgetattr(0) == before


@pytest.mark.slow
def test_a_policy_that_knows_how_reaches_the_goals_and_equal_seeds_give_equal_episodes() -> None:
    rollout = loaded("rollout")
    env, rng = rollout.Reach(), np.random.default_rng(0)
    total, steps = rollout.rollout(env, rollout.straight, 1)
    assert steps * env.fleet.tick_s < rollout.LIMIT_S
    assert -0.6 < total < 0.0
    assert rollout.rollout(env, rollout.straight, 1) == (total, steps)
    assert env.step(np.zeros((4, 2)))[0] == pytest.approx(0.0, abs=rollout.NEAR)
    seen, _ = env.reset(2)
    *_, terminated, over, _ = [env.step(rng.uniform(-1, 1, seen.shape)) for _ in range(3)][-1]
    assert (terminated, over) == (False, False)
    env.close()


@pytest.mark.slow
def test_an_experiment_repeats_a_seed_to_the_bit_and_feedback_helps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ten_seeds = loaded("ten_seeds")
    first, again, other = (ten_seeds.trial(seed, True, 1.0) for seed in (1, 1, 2))
    assert first == again
    assert first[2] != other[2]
    ten_seeds.plot(range(2), 6.0, tmp_path / "plot.svg")
    assert (tmp_path / "plot.svg").read_text().count("<path") > 4
    without, within = (float(line.split(" at worst ")[1].split()[0]) for line in capsys.readouterr().out.splitlines())
    assert within < 5  # mm
    assert without > 10


@pytest.mark.slow
def test_what_the_command_line_asks_for_is_done_and_what_is_wrong_is_a_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    config = EXAMPLES.parent / "script.yaml"
    with Fleet.from_arguments(
        config, ["--seed=5", "--set=tracker.source=truth", "--out", str(tmp_path / "kept")]
    ) as fleet:
        assert (fleet.config.run.seed, fleet.config.tracker.source) == (5, "truth")
    assert (tmp_path / "kept" / "summary.json").is_file()
    assert capsys.readouterr().out == f"{tmp_path / 'kept' / 'report.html'}\n"
    for wrong, why in [
        (["nowhere"], "a run"),
        (["--set=run.sed=5"], "did you mean 'seed'"),
        (["--lockstep"], "unrecognized arguments"),
        (["no.yaml", "--real-time"], "no.yaml"),
    ]:
        with pytest.raises(SystemExit) as ended, Fleet.from_arguments(config, wrong):
            pass
        assert ended.value.code == 2
        assert why in capsys.readouterr().err
    with pytest.raises(SystemExit), pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys.modules["__main__"], "__doc__", "About this script.\n\nIn two parts.")
        Fleet.from_arguments(config, ["--help"])
    assert "\nAbout this script.\n\nIn two parts.\n" in capsys.readouterr().out
