"""Where robots stand at first whose ``start`` is left out: the places that their group's behaviour has for them."""

import math

from robofleet.config import groups
from robofleet.config.robots import StartPose
from robofleet.config.tree import Config


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
