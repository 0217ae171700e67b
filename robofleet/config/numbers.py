"""Who is who on the bus: the number of a robot's tag, or, where no camera needs a tag, any number that is free."""

from collections.abc import Iterator
from itertools import count

from robofleet.config.robots import UNTAGGED, Robot
from robofleet.config.tree import Config


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


def untagged(config: Config) -> Iterator[tuple[str, str]]:
    """Yield the robots that lack the tag by which a camera knows them: (dotted path, what is wrong)."""
    for i, robot in enumerate(config.robots):
        if robot.tag == UNTAGGED:
            yield f"robots.{i}.tag", f"is missing: a camera knows {robot.id} by its tag: add `tag: NUMBER`"


def _needs_tag(config: Config, robot: Robot) -> bool:
    return config.tracker.source == "camera" and robot.reality == "real"
