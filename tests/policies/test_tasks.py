"""Tasks: what they observe, what earns, when they are done, and where their episodes begin."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from robofleet.config.load import load_config
from robofleet.core.arrays import Array
from robofleet.core.plugins import known
from robofleet.envs import Episodes
from robofleet.policies.interface import GROUP, Task, TaskView, load_task, observed
from robofleet.safety.distances import apart, from_edge
from robofleet.testing.behaviours import team
from robofleet.vehicles.solids import Solid, distances
from tests.shipped import SHIPPED

N, ARENAS = 4, 3
PATH = yaml.safe_load((SHIPPED / "paths" / "platoon.yaml").read_text())
SETTINGS: dict[str, dict[str, Any]] = {
    "platoon": {"path": PATH, "spacing_m": 0.25, "path_rate": 0.0455},
    "formation": {"path": PATH, "path_rate": 0.0455, "offsets_m": [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]},
}
TASKS = [name for name in known(GROUP) if not name.startswith("test")]
SEES_EDGES = {"coverage", "navigation", "pursuit"}


def task(name: str, arenas: int = ARENAS, **settings: Any) -> Task:
    kind = load_task(name)
    return kind(kind.Settings.model_validate(SETTINGS.get(name, {}) | settings), team(N), arenas)


def view(
    made: Task, poses: Array, velocities: Array | float = 0.0, others: Array | None = None, t: float = 0.0
) -> TaskView:
    none = np.zeros((len(poses), 0, 3))
    every = np.broadcast_to(velocities, (*poses.shape[:2], 2))
    return TaskView(t=np.full(len(poses), t), poses=poses, velocities=every, others=none if others is None else others,
                team=made.team)  # fmt: skip


def moved(x: Array, turn: float, by: tuple[float, float]) -> Array:
    """Return points or poses (..., 2 or 3 or more) in another world frame."""
    c, s = np.cos(turn), np.sin(turn)
    found = x.copy()
    found[..., 0], found[..., 1] = c * x[..., 0] - s * x[..., 1] + by[0], s * x[..., 0] + c * x[..., 1] + by[1]
    return found


def moved_settings(settings: dict[str, Any], turn: float, by: tuple[float, float]) -> dict[str, Any]:
    found = dict(settings)
    if "goals" in found:
        goals = {r: moved(np.array([g["x_m"], g["y_m"]]), turn, by) for r, g in found["goals"].items()}
        found["goals"] = {r: {"x_m": float(x), "y_m": float(y)} for r, (x, y) in goals.items()}
    if "path" in found:
        knots = [(np.array(k["at_m"]), np.array(k["derivative_m"])) for k in found["path"]["knots"]]
        found["path"] = {"knots": [
            {"at_m": moved(at, turn, by).tolist(), "derivative_m": moved(d, turn, (0.0, 0.0)).tolist()}
            for at, d in knots
        ]}  # fmt: skip
    return found


@pytest.mark.parametrize("name", TASKS)
def test_what_is_observed_and_earned_is_the_same_in_every_world_frame(name: str) -> None:
    rng = np.random.default_rng(0)
    poses = rng.uniform(-1, 1, (5, N, 3)) * (1.4, 0.8, np.pi)  # of five ticks
    others, velocities = (
        rng.uniform(-1, 1, (1, 2, 3)) * (1.4, 0.8, 0.0) + (0, 0, 0.1),
        rng.uniform(-0.1, 0.1, (1, N, 2)),
    )
    settings = SETTINGS.get(name, {})
    if name in ("go_to", "navigation"):
        goals = rng.uniform(-1, 1, (N, 2))
        settings = {"goals": {f"r{k + 1}": {"x_m": x, "y_m": y} for k, (x, y) in enumerate(goals.tolist())}}
    turn, by = (np.pi, (0.0, 0.0)) if name in SEES_EDGES else (2.1, (0.05, -0.03))

    def episode(turn: float, by: tuple[float, float]) -> list[tuple[Array, Array]]:
        made = task(name, 1, **moved_settings(settings, turn, by))
        at = moved(poses, turn, by)
        at[..., 2] += turn
        made.begin(np.zeros(1, np.int64), at[:1], np.random.default_rng(0))
        views = [view(made, at[k : k + 1], velocities, moved(others, turn, by), 0.033 * k) for k in range(len(at))]
        return [
            (observed(made, now), made.reward(replace(now, team=replace(made.team, arena=(9, 9))))) for now in views
        ]

    for (seen, earned), (again, also) in zip(episode(0.0, (0.0, 0.0)), episode(turn, by), strict=True):
        assert again == pytest.approx(seen, abs=1e-5)
        assert also == pytest.approx(earned, abs=1e-8)
    assert np.ptp(seen) > 0.1


def towards(x: Array, y: Array) -> Array:
    """Return actions that drive along directions in the robots' frames."""
    return np.stack([np.clip(4.0 * x, -1.0, 1.0), np.clip(2.0 * np.arctan2(y, x), -1.0, 1.0)], axis=-1)


def knowing(name: str, seen: dict[str, Array]) -> Array:
    """Return what somebody does who knows the task."""
    if name in ("go_to", "navigation"):
        return towards(*np.moveaxis(seen["goal"], -1, 0))
    if name in ("platoon", "formation"):
        x, y = np.moveaxis(seen["target"] + 0.5 * seen["target_velocity"], -1, 0)
        return np.stack([np.clip(10.0 * x, -1, 1), np.clip(2.0 * np.arctan2(y, np.abs(x) + 0.05), -1, 1)], axis=-1)
    if name == "pursuit":
        return towards(*np.moveaxis(seen["prey"], -1, 0))
    bearings = np.linspace(0.0, 2.0 * np.pi, seen["rays"].shape[-1], endpoint=False)
    push = 1.0 / np.maximum(seen["rays"], 0.05)
    return towards(-(push * np.cos(bearings)).sum(axis=-1), -(push * np.sin(bearings)).sum(axis=-1))


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", TASKS)
def test_who_knows_the_task_earns_more_than_who_drives_at_random(name: str) -> None:
    config = load_config(SHIPPED / ("obstacles.yaml" if name == "navigation" else "platoon.yaml"))
    episodes = Episodes(config, name, arenas=8, settings=SETTINGS.get(name, {}), barrier=False, threads=1)
    terms = episodes.task.terms
    ends = np.cumsum([term.size for term in terms])[:-1]
    counted = slice(1, None) if name == "pursuit" else slice(None)

    def earned(knows: bool) -> float:
        rng, total, rows = np.random.default_rng(1), 0.0, episodes.reset(seed=1)
        for _ in range(240):
            actions = rng.uniform(-1, 1, (8, N, 2))
            if knows:
                parts = zip(terms, np.split(rows, ends, axis=2), strict=True)
                actions[:, counted] = knowing(name, {t.name: t.scale * part for t, part in parts})[:, counted]
            step = episodes.step(actions)
            rows, total = step.observations, total + float(step.rewards[:, counted].mean())
            assert np.abs(step.rewards).max() < 3.0
        return total

    assert earned(True) > earned(False) + 3.0


@pytest.mark.parametrize("name", TASKS)
def test_episodes_begin_where_the_barrier_lets_robots_be(name: str) -> None:
    made = task(name)
    pillar = Solid("pillar", ((0.3, 0.1),), 0.2)
    if name not in SETTINGS:  # a path leads where it leads
        made.team = replace(made.team, keepout=replace(made.team.keepout, solids=(pillar,)))
    starts, keepout, body = (
        made.starts(50, np.random.default_rng(0)),
        made.team.keepout,
        made.team.bodies[0],
    )
    assert starts.shape == (50, N, 3)
    ahead = keepout.ahead * np.stack([np.cos(starts[..., 2]), np.sin(starts[..., 2])], axis=-1)
    points = starts[..., :2] + ahead
    between = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1) + np.eye(N)
    assert between.min() > apart(keepout, body, body)
    assert (np.array(made.team.arena) / 2 - np.abs(points)).min() > from_edge(keepout, body)
    if made.team.keepout.solids:
        assert distances((pillar,), points.reshape(-1, 2)).min() > from_edge(keepout, body)


@pytest.mark.parametrize("name", ["go_to", "navigation"])
def test_done_where_every_robot_is_at_its_goal(name: str) -> None:
    goals = np.array([(0.8, 0.5), (0.8, -0.5), (-0.8, 0.5), (-0.8, -0.5)])
    given = {f"r{k + 1}": {"x_m": x, "y_m": y} for k, (x, y) in enumerate(goals.tolist())}
    made = task(name, goals=given, accuracy_m=0.05)
    poses = np.concatenate([np.repeat(goals[None], ARENAS, axis=0), np.zeros((ARENAS, N, 1))], axis=2)
    poses[1, 2, 0] += 0.06
    poses[2, 2, 1] += 0.04
    made.begin(np.arange(ARENAS), poses, np.random.default_rng(0))
    assert made.done(view(made, poses)).tolist() == [True, False, True]


def test_goals_are_drawn_anew_in_the_arenas_that_begin_and_kept_in_the_others() -> None:
    made, poses = task("go_to"), np.zeros((ARENAS, N, 3))
    made.begin(np.arange(ARENAS), poses, np.random.default_rng(0))
    before = observed(made, view(made, poses))[..., :2]
    made.begin(np.array([1]), poses[:1], np.random.default_rng(1))
    after = observed(made, view(made, poses))[..., :2]
    assert (after == before).all(axis=(1, 2)).tolist() == [True, False, True]


def test_a_pursuit_is_done_where_a_chaser_is_near() -> None:
    made = task("pursuit", catch_m=0.2)
    poses = np.zeros((ARENAS, N, 3))
    poses[:, 1:, 0] = 0.19, 0.6, 0.9
    poses[1, 1, 0] = 0.21
    assert made.done(view(made, poses)).tolist() == [True, False, True]


def test_a_platoon_on_its_path_earns_most() -> None:
    made = task("platoon", 8)
    poses = made.starts(8, np.random.default_rng(0))
    made.begin(np.arange(8), poses, np.random.default_rng(0))
    first = made.reward(view(made, poses))
    assert first.min() > 0.2  # starts are a few centimetres off
    late = made.reward(view(made, poses, t=10.0))
    assert late[:, 0].max() < 0.3  # the leader's target went on
    assert late[:, 1:] == pytest.approx(first[:, 1:])  # the others follow who stands


def test_a_shape_of_other_size_than_the_group_is_refused() -> None:
    assert not [*task("formation").refusals()]
    (refusal,) = task("formation", offsets_m=[(0, 0)]).refusals()
    assert refusal.key == "offsets_m"


def test_neighbours_are_the_nearest_first_in_the_robots_frame_with_their_velocities() -> None:
    made = task("go_to", 1, neighbours=2, range_m=0.5)
    poses = np.array([[[0.0, 0.0, np.pi / 2], [0.0, 0.3, np.pi], [0.4, 0.0, 0.0], [9.0, 0.0, 0.0]]])
    others = np.array([[[0.0, -0.2, 0.1]]])
    seen = observed(made, view(made, poses, (0.1, 0.0), others))[0, 0, -10:] * 0.5
    assert seen[:5] == pytest.approx([-0.2, 0.0, 0.0, 0.0, 1.0], abs=1e-6)  # no robot of the group
    assert seen[5:] == pytest.approx([0.3, 0.0, 0.0, 0.1, 1.0], abs=1e-6)  # to the left at 0.1 m/s
