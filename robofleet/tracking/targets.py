"""What the tracker looks for."""

from typing import NamedTuple

from robofleet.config.tree import Config
from robofleet.settings import FAMILIES

_ANY_S = 1e9


class Target(NamedTuple):
    """A tag to follow."""

    tag: int
    side: float  # of its square [m]
    height: float  # above the floor [m]
    max_speed: float  # 0 for a tag that lies still [m/s]
    family: str = "36h11"  # one for all of a tracker
    drives_on_s: float = 0.75  # for so long it may drive though this camera does not see it: then it is stopped

    @property
    def whole(self) -> float:
        """The side of the whole print [m]."""
        return self.side * FAMILIES[self.family].whole


def robot_targets(config: Config) -> list[Target]:
    """Return the tags of the robots that a camera can see, in the configuration's order."""
    t = config.tracker
    alone = len(config.views) == 1  # else another camera may see it
    return [
        Target(
            robot.tag,
            t.tag_side_m,
            t.tag_height_m if robot.tag_height_m is None else robot.tag_height_m,
            robot.vehicle.max_speed_m_s,
            t.family,
            *(() if alone else (_ANY_S,)),
        )
        for robot in config.seen
    ]


def floor_targets(config: Config) -> list[Target]:
    """Return the tags that lie on the floor, in the configuration's order."""
    t = config.tracker
    return [Target(floor.tag, floor.side_m, floor.height_m, 0.0, t.family) for floor in t.floor_tags]
