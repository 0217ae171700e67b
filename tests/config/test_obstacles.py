"""Obstacles in a configuration: what cannot be is refused where it stands, and how to mend it."""

from pathlib import Path

import pytest

from robofleet.config import obstacles, slices
from robofleet.config.load import ConfigError, load_config, resolved_yaml
from robofleet.core.plugins import load
from robofleet.drivers.cart import Cart
from robofleet.runs.check import load_checked
from robofleet.vehicles.solids import distances

SHIPPED = Path(__file__).parents[2] / "configs"
OURS, PLATOON = SHIPPED / "obstacles.yaml", SHIPPED / "platoon.yaml"
TRUTH = "tracker.source=truth"


def refused(file: Path, *overrides: str) -> list[str]:
    with pytest.raises(ConfigError) as error:
        load_checked(file, [TRUTH, *overrides], lockstep=True)
    return str(error.value).splitlines()


@pytest.mark.parametrize(
    ("override", "key", "words"),
    [
        ("arena.obstacles.1={circle: {x_m: -1.3, y_m: 0.55, radius_m: 0.1}}", "robots.0.start", "move r1 or obstacle2"),
        ("arena.obstacles.1.circle={x_m: 1.25, y_m: -0.2, radius_m: 0.35}", "groups.0.settings.goals.r2", "pillar"),
        ("arena.floor_m=[[-1.6,-1],[1.6,-1],[1.6,0.5],[-1.6,0.5]]", "robots.0.start", "move r1"),
        ("arena.floor_m.0=[-1.7, -1.0]", "arena.floor_m.0", "outside the arena"),
        ("arena.obstacles.1.circle.x_m=100", "arena.obstacles.1", "outside the arena"),
        ("arena.obstacles.1={name: p}", "arena.obstacles.1", "circle or a polygon"),
        ("arena.obstacles.0.name=wall", "arena.obstacles.2.name", "obstacles.0's already"),
        ("arena.obstacles.0.polygon_m=[[0,0],[0.2,0.2],[0.2,0],[0,0.2]]", "arena.obstacles.0.polygon_m", "crosses"),
        ("arena.obstacles.0.polygon_m=[[0,0],[0.1,0.1],[0.2,0.2]]", "arena.obstacles.0.polygon_m", "on one line"),
        ("arena.obstacles.0.polygon_m=[[0,0],[0,0],[0.2,0.2]]", "arena.obstacles.0.polygon_m", "the same"),
        ("arena.obstacles.0.polygon_m=[[0,0],[0,0.1]]", "arena.obstacles.0.polygon_m", "needs 3"),
        ("arena.obstacles.1.circle.radius=0.2", "arena.obstacles.1.circle.radius", "did you mean 'radius_m'?"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line_that_says_where(override: str, key: str, words: str) -> None:
    assert [line for line in refused(OURS, override) if f" {key}: " in line and words in line]


def test_an_obstacle_on_a_platoon_s_path_is_refused() -> None:
    (line,) = refused(PLATOON, "arena.obstacles=[{name: box, circle: {x_m: 0.9, y_m: 0.62, radius_m: 0.1}}]")
    assert "parameter 0.85, so move box or the path" in line


def test_a_goal_to_which_no_way_leads_is_refused() -> None:
    wall = "{name: fence, polygon_m: [[-0.02, -1.0], [0.02, -1.0], [0.02, 1.0], [-0.02, 1.0]]}"
    lines = refused(OURS, f"arena.obstacles=[{wall}]")
    assert len(lines) == 4
    assert all("no way leads from" in line and "fence" in line for line in lines)


NEAREST = "groups.0.settings.assignment=nearest"
FENCE = "arena.obstacles=[{name: fence, polygon_m: [[-0.02, -1.0], [0.02, -1.0], [0.02, 1.0], [-0.02, 1.0]]}]"


def test_goals_that_are_shared_out_must_leave_each_robot_one_to_which_a_way_leads() -> None:
    """Two robots stand on either side of the fence, and so do two goals: who has which is left to them."""
    load_checked(OURS, [TRUTH, NEAREST, FENCE], lockstep=True)
    away = "groups.0.settings.goals.r1={x_m: -0.9, y_m: 0.2, heading_deg: 0}"
    (line,) = refused(OURS, NEAREST, FENCE, away)
    assert "groups.0.settings.goals: no way leads from r" in line
    assert "to a goal that is left for it past fence" in line


def test_a_configuration_with_obstacles_is_written_and_read_back(tmp_path: Path) -> None:
    config = load_config(OURS)
    (tmp_path / "again.yaml").write_text(resolved_yaml(config))
    assert load_config(tmp_path / "again.yaml") == config


def test_distance_sensors_see_the_sides_of_obstacles_and_of_the_floor() -> None:
    config = load_config(OURS)
    walls = slices.walls(config.arena)
    ends = [end for x, y, to_x, to_y in walls for end in ((x, y), (to_x, to_y))]
    away = distances(obstacles.every(config.arena), ends).__abs__().min(axis=0)
    assert away.max() < 0.002  # a disc is seen as a polygon around it
    assert len(walls) == 5 + 4 + 24 + 6


CART = "{name: cart, tag: %s, radius_m: 0.12, start: {x_m: %s, y_m: %s, heading_deg: 0}}"


@pytest.mark.parametrize(
    ("moving", "key", "words"),
    [
        (CART % (1, 0, 0), "arena.moving.0.tag", "1 is robots.0's already"),
        ("{name: r1, tag: 40, radius_m: 0.12}", "arena.moving.0.name", "r1 is robots.0's already"),
        ("{name: r1, tag: 1, radius_m: 0.12}", "arena.moving.0.name", "r1 is robots.0's already"),
        ("{name: cart, tag: 40, radius_m: 0.12}", "arena.moving.0.start", "missing"),
        (CART % (40, 0.9, 0.62), "arena.moving.0.start", "park cart further away"),
    ],
)
def test_a_cart_that_cannot_be_is_refused_where_it_is_written(moving: str, key: str, words: str) -> None:
    assert [line for line in refused(PLATOON, f"arena.moving=[{moving}]") if key in line and words in line]


def test_a_cart_under_a_real_camera_has_a_driver_that_moves_nothing() -> None:
    cart = load_config(SHIPPED / "lab.yaml", ["arena.moving=[{name: cart, tag: 40, radius_m: 0.12}]"]).robots[-1]
    assert load("robofleet.drivers", cart.driver) is Cart
    reading = Cart(None).read()  # type: ignore[arg-type]
    assert reading[:4] == (0.0, 0.0, 0.0, 0.0)


def test_a_cart_is_a_bystander_and_is_written_and_read_back(tmp_path: Path) -> None:
    config = load_config(PLATOON, [f"arena.moving=[{CART % (40, 0, 0)}]"])
    (cart,) = config.bystanders
    assert (cart.id, cart.tag, cart.vehicle.body_radius_m, cart.driver) == ("cart", 40, 0.12, "simulated")
    (tmp_path / "again.yaml").write_text(resolved_yaml(config))
    assert load_config(tmp_path / "again.yaml") == config
