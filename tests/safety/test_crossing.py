"""Robots on crossing paths, seen late, one of them stalled: the program's figures hold for a few seeds."""

import pytest

from robofleet.config.tree import Config
from tests.safety.crossing import configuration, cross


@pytest.fixture(scope="module")
def config() -> Config:
    return configuration()


@pytest.mark.parametrize("seed", [3, 4, 11, 12, 17, 49])
def test_bodies_stay_apart_whoever_stalls_and_who_cannot_arrive_is_said_to_be_blocked(
    config: Config, seed: int
) -> None:
    crossing = cross(config, seed)
    assert crossing.gap >= 0.010
    assert crossing.edge >= 0.0
    assert crossing.no_answer == 0
    assert crossing.arrived + crossing.blocked == crossing.moving == 7


def test_where_nobody_stalls_all_arrive(config: Config) -> None:
    crossing = cross(config, 1, stalled=False)
    assert crossing.gap >= 0.010
    assert (crossing.arrived, crossing.moving) == (8, 8)
