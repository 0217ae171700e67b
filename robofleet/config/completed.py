"""What a loaded configuration gets beside its keys: robots for moving obstacles, numbers, starts.

An obstacle that moves and carries a tag is a bystander without wheels: a robot that no group drives is seen by its tag,
and kept clear of, wherever it stands or is pushed. So each entry of ``arena.moving`` is such a robot: where the poses
are simulated it is a simulated robot that nobody drives, else one whose driver (``robofleet.drivers.cart``) has no
motors.
"""

import math
from itertools import count

from robofleet.config import groups
from robofleet.config.obstacles import Moving
from robofleet.config.plant_errors import NO_ERRORS
from robofleet.config.robots import UNTAGGED, Robot, StartPose, Vehicle
from robofleet.config.tree import Config

CART = "robofleet.drivers.cart:Cart"
_WHEEL_PER_RADIUS, _BASE_PER_RADIUS = 0.25, 1.0  # wheels that it has not, inside its disc


def with_moving_obstacles(config: Config) -> Config:
    """Return a configuration with a robot for each obstacle that moves, after all others.

    One that is there already, as in a configuration that was written by a run, is not added again.
    """
    known = {(robot.id, robot.tag): robot.vehicle for robot in config.robots}
    every = [_robot(config, moving) for moving in config.arena.moving]
    new = [robot for robot in every if known.get((robot.id, robot.tag)) != robot.vehicle]
    return config.model_copy(update={"robots": (*config.robots, *new)}) if new else config


def file_path(config: Config, path: str) -> str:
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


def numbered(config: Config) -> Config:
    """Return the configuration with a number for each robot that wears no tag and needs none: the lowest free ones.

    Messages name a robot by this number, as they do by a tag's. A robot that a camera must see stays without one:
    ``cross_checks`` refuses it.
    """
    lacking = [robot for robot in config.robots if robot.tag == UNTAGGED and not _needs_tag(config, robot)]
    if not lacking:
        return config
    taken = {robot.tag for robot in config.robots} | {floor.tag for floor in config.tracker.floor_tags}
    free = (number for number in count() if number not in taken)
    numbers = {robot.id: next(free) for robot in lacking}
    robots = (robot.model_copy(update={"tag": numbers.get(robot.id, robot.tag)}) for robot in config.robots)
    return config.model_copy(update={"robots": tuple(robots)})


def placed(config: Config) -> Config:
    """Return the configuration with a start for each robot of a group whose behaviour has places.

    Robots stay without a start where there are no such places: checks say why.
    """
    found: dict[str, StartPose] = {}
    for group in config.groups:
        if any(config.robot(name).start is None for name in group.robots):
            for name, (x, y, psi) in zip(group.robots, groups.behaviour(config, group).places() or (), strict=False):
                found[name] = StartPose(x_m=x, y_m=y, heading_deg=round(math.degrees(psi), 2))
    if not found:
        return config
    robots = tuple(
        robot if robot.start is not None else robot.model_copy(update={"start": found.get(robot.id)})
        for robot in config.robots
    )
    return config.model_copy(update={"robots": robots})


def _robot(config: Config, moving: Moving) -> Robot:
    wheel = _WHEEL_PER_RADIUS * moving.radius_m
    vehicle = Vehicle(
        wheel_radius_m=wheel, wheel_base_m=_BASE_PER_RADIUS * moving.radius_m, body_radius_m=moving.radius_m,
        max_wheel_speed_rad_s=moving.speed_m_s / wheel, max_speed_m_s=moving.speed_m_s,
        max_wheel_acceleration_rad_s2=1e3,
        motor_lag_s=0.0, simulated=NO_ERRORS,
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


def _needs_tag(config: Config, robot: Robot) -> bool:
    return config.tracker.source == "camera" and robot.reality == "real"
