"""What a driver knows of the world around its robot, here and on the robot's own computer."""

import math
from pathlib import Path

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.nodes.handing import packed, unpacked
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.vehicles.interface import World

CONFIGS = Path(__file__).parents[2] / "configs"


def world(config: Config, robot: str = "r1") -> World:
    found = ConfiguredDrivers(config, lambda: 0).context(robot).world
    assert found is not None
    return found


def test_a_driver_knows_all_robots_and_where_they_start() -> None:
    config = load_config(
        CONFIGS / "go-to.yaml", ["robots.1.unit=pair", "robots.4.unit=pair", "robots.2.vehicle=create2"]
    )
    found = world(config)
    assert found.size == (3.2, 2.0)
    assert [robot.robot for robot in found.robots] == list(config.ids)
    second, third = found.robots[1], found.robots[2]
    assert second.start == (0.849, 0.411, math.radians(-154))
    assert (second.radius, second.drive.wheel_radius) == (0.055, 0.016)
    assert third.radius == config.robots[2].vehicle.body_radius_m != second.radius
    assert [robot.robot for robot in found.unit("r5")] == ["r2", "r5"]


def test_a_driver_knows_the_floor_and_the_obstacles() -> None:
    clockwise = "{polygon_m: [[0.6, 0.4], [0.6, 0.2], [0.5, 0.2]], height_m: 0.3}"
    found = world(load_config(CONFIGS / "obstacles.yaml", [f"arena.obstacles.2={clockwise}"]))
    assert found.floor == ((-1.6, -1.0), (1.6, -1.0), (1.6, 0.7), (1.3, 1.0), (-1.6, 1.0))
    box, pillar, triangle = found.obstacles
    assert (box.name, box.height, len(box.points)) == ("box", 0.15, 4)
    assert (pillar.points, pillar.radius, pillar.height) == (((0.1, 0.35),), 0.15, 0.1)
    assert triangle.points == ((0.5, 0.2), (0.6, 0.2), (0.6, 0.4)), "counter-clockwise, however it is written"


def test_a_robots_own_computer_gets_the_same_world() -> None:
    config = load_config(CONFIGS / "obstacles.yaml")
    assert world(unpacked(packed(config))) == world(config)
