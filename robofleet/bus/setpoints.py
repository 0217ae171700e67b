"""Who may send a group's setpoints: a program or a person, as its behaviour says."""

from robofleet.behaviours.teleop import Teleop
from robofleet.bus.keys import TELEOP, WISH, Topic
from robofleet.config import groups
from robofleet.config.tree import Config


def setpoint_topics(config: Config) -> dict[str, Topic]:
    """Return the topic of each group whose behaviour takes setpoints, by the group's name."""
    by_hand = groups.taking_setpoints(config, Teleop)
    return {group: TELEOP if group in by_hand else WISH for group in groups.scripted(config)}
