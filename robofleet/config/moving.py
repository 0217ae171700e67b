"""Obstacles that move and carry a tag: bystanders without wheels.

A robot that no group drives is seen by its tag, and kept clear of, wherever it stands or is pushed. So each entry of
``arena.moving`` is such a robot: where the poses are simulated it is a simulated robot that nobody drives, else one
whose driver (``robofleet.drivers.cart``) has no motors.
"""

from robofleet.config.obstacles import Moving
from robofleet.config.robots import PlantErrors, Robot, Vehicle
from robofleet.config.tree import Config

CART = "robofleet.drivers.cart:Cart"
_WHEEL, _BASE = 0.25, 1.0  # of the radius: wheels that it has not, inside its disc

_IDEAL = PlantErrors(
    motor_lag_s=0.0, speed_quantum_rad_s=0.0, loop_period_s=0.01, deadband_rad_s=0.0, breakaway_rad_s=0.0,
    wheel_gain_spread=0.0, wheel_base_spread=0.0, slip_s_per_rad=0.0, slip_noise=0.0, top_speed_sag=0.0,
    battery_life_s=1e9,
)  # fmt: skip


def added(config: Config) -> Config:
    """Return the configuration with a robot for each obstacle that moves, after all others.

    One that is there already, as in a configuration that was written by a run, is not added again.
    """
    known = {(robot.id, robot.tag): robot.vehicle for robot in config.robots}
    every = [_robot(config, moving) for moving in config.arena.moving]
    new = [robot for robot in every if known.get((robot.id, robot.tag)) != robot.vehicle]
    return config.model_copy(update={"robots": (*config.robots, *new)}) if new else config


def place(config: Config, path: str) -> str:
    """Return where in the file a complaint belongs: one about such a robot belongs to its obstacle."""
    first, _, rest = path.partition(".")
    row, _, key = rest.partition(".")
    if first != "robots" or not row.isdigit() or not config.arena.moving or int(row) >= len(config.robots):
        return path
    names = [moving.name for moving in config.arena.moving]
    robot = config.robots[int(row)]
    if robot.id not in names or int(row) < len(config.robots) - len(names):
        return path
    keys = {"id": "name", "tag": "tag", "start": "start", "tag_height_m": "tag_height_m"}
    own = next((own for theirs, own in keys.items() if key.partition(".")[0] == theirs), "")
    return f"arena.moving.{names.index(robot.id)}.{own}".rstrip(".")


def _robot(config: Config, moving: Moving) -> Robot:
    wheel = _WHEEL * moving.radius_m
    vehicle = Vehicle(
        wheel_radius_m=wheel, wheel_base_m=_BASE * moving.radius_m, body_radius_m=moving.radius_m,
        max_wheel_speed_rad_s=moving.speed_m_s / wheel, max_speed_m_s=moving.speed_m_s,
        max_wheel_acceleration_rad_s2=1e3,
        motor_lag_s=0.0, simulated=_IDEAL,
    )  # fmt: skip
    driver = "simulated" if config.poses_simulated else CART
    return Robot(
        id=moving.name,
        tag=moving.tag,
        tag_height_m=moving.tag_height_m,
        driver=driver,
        vehicle=vehicle,
        start=moving.start,
    )
