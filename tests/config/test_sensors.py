"""Sensors in a configuration: what is refused, and what a run's units tell."""

import pytest

from robofleet.config import slices
from robofleet.config.load import ConfigError, load_config
from tests.shipped import PLATOON

VEHICLE = "robots.1.vehicle.sensors"
REFUSED = [
    (("robots.1.sensors=true", "robots.1.vehicle=create2"), "robots.1.sensors: its vehicle has no sensors: describe"),
    (("robots.1.sensors=true", f"{VEHICLE}={{period_s: 0.1}}"), "robots.1.sensors: its vehicle has no sensors"),
    (("robots.1.sensors=1",), "robots.1.sensors: must be true or false, not 1"),
    ((f"{VEHICLE}.period_s=0.001",), f"{VEHICLE}.period_s: must be at least 0.01, not 0.001"),
    ((f"{VEHICLE}.gyro.noise_rad_s=[0.1,0.1]",), f"{VEHICLE}.gyro.noise_rad_s.2: has too few values: add one"),
    ((f"{VEHICLE}.gyro.noise_rad_s=[0.1,0.1,-0.1]",), f"{VEHICLE}.gyro.noise_rad_s.2: must be at least 0, not -0.1"),
    ((f"{VEHICLE}.gyro.bias_deg_s=1",), f"{VEHICLE}.gyro.bias_deg_s: unknown key"),
    ((f"{VEHICLE}.distances.dropout=1.5",), f"{VEHICLE}.distances.dropout: must be at most 1, not 1.5"),
    ((f"{VEHICLE}.distances.places=[]",), f"{VEHICLE}.distances.places: needs 1 or more, has 0"),
    ((f"{VEHICLE}.distances.range_m=1200",), f"{VEHICLE}.distances.range_m: must be at most 1000, not 1200"),
    (("arena.walls=[[0,0,1]]",), "arena.walls.0.3: has too few values: add one"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "line"), REFUSED)
def test_what_cannot_be_is_refused_in_one_line(changes: tuple[str, ...], line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(PLATOON, changes)
    (fault,) = caught.value.faults
    assert line in fault


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
