"""What other rooms get of a configuration: drives, sensors, walls, carts, and the world that a driver knows."""

import math

import pytest

from robofleet.config import obstacles, slices
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.plugins import load
from robofleet.drivers.cart import Cart
from robofleet.nodes.handing import packed, unpacked
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.vehicles.interface import World
from robofleet.vehicles.solids import distances
from tests.shipped import PLATOON

OBSTACLES = SHIPPED / "obstacles.yaml"
MEASURED = "{robot: r1, wheel_radius_m: 0.0158, motor_lag_s: 0.061, delay_s: 0.045}"


def test_a_calibration_goes_before_the_vehicle() -> None:
    config = load_config(PLATOON, [f"robots.0.calibration={MEASURED}"])
    measured, other = slices.drive(config.robots[0]), slices.drive(config.robots[1])
    assert (measured.wheel_radius, measured.motor_lag) == (0.0158, 0.061)
    assert (measured.wheel_base, measured.max_wheel_speed) == (other.wheel_base, other.max_wheel_speed)
    assert other == slices.vehicle_drive(config.robots[0].vehicle)
    assert slices.delay_ns(config, config.robots[0]) == 45_000_000
    assert slices.delay_ns(config, config.robots[1]) == round(config.controller.command_delay_s * 1e9)


@pytest.mark.parametrize("value", ["0", "0.0"])
def test_a_measured_zero_is_a_measurement(value: str) -> None:
    config = load_config(PLATOON, [f"robots.0.calibration={{robot: r1, delay_s: {value}, motor_lag_s: {value}}}"])
    assert slices.delay_ns(config, config.robots[0]) == 0
    assert slices.drive(config.robots[0]).motor_lag == 0.0


def test_units_tell_as_often_as_their_fastest_sensors() -> None:
    overrides = ("drivers.robots_per_process=2", "robots.1.sensors=true", "robots.3.sensors=true")
    config = load_config(PLATOON, ["tracker.source=truth", *overrides, "robots.3.vehicle.sensors.period_s=0.2"])
    assert config.sensing == ("r1", "r3")
    assert [slices.sensing_period_ns(config, unit) for unit in config.units] == [33_000_000, 200_000_000]
    assert [slices.sensors(robot) is not None for robot in config.robots] == [False, True, False, True]
    plain = load_config(PLATOON)
    assert plain.sensing == () and slices.sensing_period_ns(plain, "r1") is None


def test_the_walls_are_the_edges_of_the_floor_unless_others_are_named() -> None:
    arena = load_config(PLATOON).arena
    ends = {(x, y) for wall in slices.walls(arena) for x, y in (wall[:2], wall[2:])}
    assert len(slices.walls(arena)) == 4
    assert ends == {(s * arena.size_m[0] / 2, t * arena.size_m[1] / 2) for s in (-1, 1) for t in (-1, 1)}
    assert slices.walls(load_config(PLATOON, ["arena.walls=[[0,0,1.5,1]]"]).arena) == ((0.0, 0.0, 1.5, 1.0),)


def test_distance_sensors_see_the_sides_of_obstacles_and_of_the_floor() -> None:
    config = load_config(OBSTACLES)
    walls = slices.walls(config.arena)
    ends = [end for x, y, to_x, to_y in walls for end in ((x, y), (to_x, to_y))]
    away = distances(obstacles.every(config.arena), ends).__abs__().min(axis=0)
    assert away.max() < 0.002  # a disc is seen as a polygon around it
    assert len(walls) == 5 + 4 + 24 + 6


CART = "arena.moving=[{name: cart, tag: 40, radius_m: 0.12, start: {x_m: 0, y_m: 0, heading_deg: 0}}]"


def test_a_cart_under_a_real_camera_has_a_driver_that_moves_nothing() -> None:
    cart = load_config(SHIPPED / "lab.yaml", ["arena.moving=[{name: cart, tag: 40, radius_m: 0.12}]"]).robots[-1]
    assert load("robofleet.drivers", cart.driver) is Cart
    reading = Cart(None).read()  # type: ignore[arg-type]
    assert reading[:4] == (0.0, 0.0, 0.0, 0.0)


def test_a_cart_is_a_bystander() -> None:
    (cart,) = load_config(PLATOON, [CART]).bystanders
    assert (cart.id, cart.tag, cart.vehicle.body_radius_m, cart.driver) == ("cart", 40, 0.12, "simulated")


def world(config: Config, robot: str = "r1") -> World:
    found = ConfiguredDrivers(config, lambda: 0).context(robot).world
    assert found is not None
    return found


def test_a_driver_knows_all_robots_and_where_they_start() -> None:
    config = load_config(
        SHIPPED / "go-to.yaml", ["robots.1.unit=pair", "robots.4.unit=pair", "robots.2.vehicle=create2"]
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
    found = world(load_config(OBSTACLES, [f"arena.obstacles.2={clockwise}"]))
    assert found.floor == ((-1.6, -1.0), (1.6, -1.0), (1.6, 0.7), (1.3, 1.0), (-1.6, 1.0))
    box, pillar, triangle = found.obstacles
    assert (box.name, box.height, len(box.points)) == ("box", 0.15, 4)
    assert (pillar.points, pillar.radius, pillar.height) == (((0.1, 0.35),), 0.15, 0.1)
    assert triangle.points == ((0.5, 0.2), (0.6, 0.2), (0.6, 0.4)), "counter-clockwise, however it is written"


def test_a_robots_own_computer_gets_the_same_world() -> None:
    config = load_config(OBSTACLES)
    assert world(unpacked(packed(config))) == world(config)
