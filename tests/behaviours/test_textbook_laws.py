"""Consensus, cyclic pursuit and coverage: what their textbooks prove of them holds in the closed loop."""

import numpy as np
import pytest

from robofleet.behaviours.consensus import Consensus
from robofleet.behaviours.coverage import Coverage
from robofleet.behaviours.cyclic_pursuit import CyclicPursuit
from robofleet.testing import drive, make, refusals, situation, team

MONOTONE = 1e-9
SLOW = 0.1  # a tick that is fast enough for these laws [s]


def anywhere(n: int, seed: int) -> np.ndarray:
    """Return poses anywhere in the arena."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-1.3, 1.3, n), rng.uniform(-0.8, 0.8, n), rng.uniform(-np.pi, np.pi, n)])


# Consensus


STAR = {"edges": [["r1", "r4"], ["r2", "r4"], ["r3", "r4"]]}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("graph", [{"graph": "ring"}, {"graph": "line"}, {"graph": "complete"}, STAR])
def test_consensus_leads_all_to_one_point_and_the_edges_never_grow(graph: dict[str, object]) -> None:
    behaviour = make(Consensus, graph, team(4, tick=SLOW))
    past = drive(behaviour, anywhere(4, 1), 120.0)
    near = behaviour.settings.adjacency(behaviour.team.robots)
    between = past.points[:, :, None] - past.points[:, None]
    potential = (near * (between**2).sum(axis=-1)).sum(axis=(1, 2))
    assert np.diff(potential).max() < MONOTONE
    assert past.figures["disagreement"][-1].max() < 1e-3
    assert past.figures["disagreement"][0].max() > 0.3


def test_consensus_asks_for_no_more_than_its_speed() -> None:
    behaviour = make(Consensus, {"gain_per_s": 10.0, "speed_m_s": 0.05}, team(3, tick=SLOW))
    velocities = behaviour.decide(situation(anywhere(3, 2))).velocities
    assert np.linalg.norm(velocities, axis=1) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"edges": [["r1", "r9"], ["r1", "r2"], ["r2", "r3"]]}, "settings.edges.0.1: r9 is not in the group"),
        ({"edges": [["r1", "r2"]]}, "settings.edges: no edges lead from r1 to r3"),
        ({"edges": [["r1", "r2"], ["r2", "r3"], ["r3", "r3"]]}, "settings.edges.2: r3 is no neighbour of itself"),
        ({"speed_m_s": 0.19}, "settings.speed_m_s: the speed of a robot's point ahead"),
    ],
)  # fmt: skip
def test_consensus_refuses(settings: dict[str, object], complaint: str) -> None:
    found = refusals(make(Consensus, settings, team(3, tick=SLOW)))
    assert len(found) == 1
    assert found[0].startswith(complaint)


# Cyclic pursuit


@pytest.mark.slow_after_first
@pytest.mark.parametrize("n", [2, 5])
@pytest.mark.parametrize("settings", [{}, {"centre_m": [0.2, -0.1]}])
def test_cyclic_pursuit_ends_on_the_circle_equally_spaced(n: int, settings: dict[str, object]) -> None:
    behaviour = make(CyclicPursuit, {"radius_m": 0.5, "speed_m_s": 0.1} | settings, team(n, tick=SLOW))
    past = drive(behaviour, anywhere(n, 3), 120.0)
    points = past.points[-1]
    centre = np.array(settings.get("centre_m", points.mean(axis=0)))
    assert np.linalg.norm(points - centre, axis=1) == pytest.approx(0.5, abs=3e-3)
    angle = np.unwrap(np.arctan2(*(points - centre).T[::-1]))
    assert np.exp(1j * np.diff(angle)) == pytest.approx(np.exp(2j * np.pi / n), abs=0.01)  # the next one is ahead
    speed = np.linalg.norm(past.points[-1] - past.points[-2], axis=1) / (past.t[-1] - past.t[-2])
    assert speed == pytest.approx(0.1, rel=0.02)


def test_cyclic_pursuit_refuses_circles_and_groups_that_cannot_be() -> None:
    assert refusals(make(CyclicPursuit, {"radius_m": 0.5}, team(5, tick=SLOW))) == []
    assert "add one" in refusals(make(CyclicPursuit, {"radius_m": 0.5}, team(1, tick=SLOW)))[0]
    assert "raise radius_m" in refusals(make(CyclicPursuit, {"radius_m": 0.2}, team(8, tick=SLOW)))[0]
    outside = refusals(make(CyclicPursuit, {"radius_m": 0.5, "centre_m": [0.0, 0.6]}, team(5, tick=SLOW)))
    assert outside
    assert all("leaves the arena on the circle" in line for line in outside)


# Coverage


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"peak_m": [0.8, 0.4], "peak_width_m": 0.4}])
def test_the_locational_cost_never_rises_and_the_robots_end_in_the_middles_of_their_cells(
    settings: dict[str, object],
) -> None:
    behaviour = make(Coverage, settings, team(5, tick=SLOW))
    past = drive(behaviour, anywhere(5, 4), 120.0)
    cost = past.figures["locational_cost"][:, 0]
    assert np.diff(cost).max() < MONOTONE
    assert cost[-1] < 0.7 * cost[0]
    assert past.points[-1] == pytest.approx(past.references[-1], abs=0.01)


@pytest.mark.slow
def test_a_peak_draws_the_robots_near() -> None:
    settings = {"peak_m": [0.8, 0.4], "peak_width_m": 0.3}
    even, drawn = (
        drive(make(Coverage, s, team(4, tick=SLOW)), anywhere(4, 5), 60.0).points[-1] for s in ({}, settings)
    )
    away = [float(np.linalg.norm(points - [0.8, 0.4], axis=1).mean()) for points in (even, drawn)]
    assert away[1] < 0.5 * away[0]


def test_one_robot_covers_from_the_middle_and_robots_at_one_place_get_finite_velocities() -> None:
    past = drive(make(Coverage, {}, team(1, tick=SLOW)), np.array([[-1.0, 0.5, 0.0]]), 60.0)
    assert past.points[-1] == pytest.approx(np.zeros((1, 2)), abs=1e-3)
    assert np.isfinite(make(Coverage, {}, team(3, tick=SLOW)).decide(situation(np.zeros((3, 3)))).velocities).all()
