"""Sensors in a configuration: what a run's units tell."""

from robofleet.config import slices
from robofleet.config.load import load_config
from tests.shipped import PLATOON


def test_units_tell_as_often_as_their_fastest_sensors() -> None:
    overrides = ("drivers.robots_per_process=2", "robots.1.sensors=true", "robots.3.sensors=true")
    config = load_config(PLATOON, ["tracker.source=truth", *overrides, "robots.3.vehicle.sensors.period_s=0.2"])
    assert config.sensing == ("r1", "r3")
    assert [slices.sensing_period_ns(config, unit) for unit in config.units] == [33_000_000, 200_000_000]
    assert [slices.sensors(robot) is not None for robot in config.robots] == [False, True, False, True]
    plain = load_config(PLATOON)
    assert plain.sensing == () and slices.sensing_period_ns(plain, "r1") is None


def test_the_walls_are_the_edges_of_the_floor_unless_others_are_named() -> None:
    x, y = load_config(PLATOON).arena.size_m
    edges = slices.walls(load_config(PLATOON).arena)
    assert {tuple(sorted((abs(a), abs(b)))) for wall in edges for a, b in (wall[:2], wall[2:])} == {
        tuple(sorted((x / 2, y / 2)))
    }
    assert len(edges) == 4
    assert slices.walls(load_config(PLATOON, ["arena.walls=[[0,0,1.5,1]]"]).arena) == ((0.0, 0.0, 1.5, 1.0),)
