"""Robots on crossing ways, seen late, one of them stalled: the program's figures hold for a few seeds."""

import pytest

from tools.measure.behaviours.crossing import SCENARIOS, Crossing, configuration, cross


def crossed(name: str, seed: int) -> Crossing:
    """Return what came of a scenario, in which bodies kept apart and inside the arena."""
    scenario = SCENARIOS[name]
    crossing = cross(configuration(scenario.robots), seed, scenario)
    assert crossing.gap >= 0.010
    assert crossing.edge >= 0.0
    assert crossing.no_answer == 0
    return crossing


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 11, 12, 17, 49])
def test_bodies_stay_apart_whoever_stalls_and_who_cannot_arrive_is_said_to_be_blocked(seed: int) -> None:
    crossing = crossed("circle, 8, one stalls", seed)
    assert crossing.arrived + crossing.blocked == crossing.moving == 7


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ellipse, 10", "consensus, 8"])
@pytest.mark.parametrize("seed", [1, 2])
def test_where_nobody_stalls_all_arrive_and_nobody_is_blocked(name: str, seed: int) -> None:
    crossing = crossed(name, seed)
    assert crossing.arrived == crossing.moving
    assert crossing.ever_blocked == 0
