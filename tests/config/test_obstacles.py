"""Obstacles and carts in a configuration, and what they become."""

from pathlib import Path

from robofleet.config import obstacles, slices
from robofleet.config.load import load_config
from robofleet.core.plugins import load
from robofleet.drivers.cart import Cart
from robofleet.vehicles.solids import distances

SHIPPED = Path(__file__).parents[2] / "configs"
OURS, PLATOON = SHIPPED / "obstacles.yaml", SHIPPED / "platoon.yaml"


def test_distance_sensors_see_the_sides_of_obstacles_and_of_the_floor() -> None:
    config = load_config(OURS)
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
