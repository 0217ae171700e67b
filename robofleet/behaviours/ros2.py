"""ros2: what ROS 2 nodes command by ``cmd_vel``; ``robofleet ros2`` brings it here.

Each robot does its newest command for as long as that is fresh, and stands when its node says no more. The run is not
held: the robot goes on with the next command.
"""

from typing import Annotated

import numpy as np

from robofleet.behaviours.interface import Behaviour, Decision, Figure, Situation, Team, WishKind
from robofleet.core.settings import Model, within

_ROUNDING = 1e-9


class Ros2(Behaviour):
    """What ROS 2 nodes command."""

    class Settings(Model):
        """How long a node may say nothing."""

        silent_s: Annotated[float, within(0.05, 10)] = 0.15
        """Age at which a command is too old: the robot stands until the next one. It counts from the command's
        publication to the controller's tick."""

    settings: Settings
    takes_wishes = True
    figures = (Figure("command_age", "s", meaning="time since the robot's newest command was published"),)

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._stand = np.zeros((len(team), 2))

    def decide(self, now: Situation) -> Decision:
        """Do what was commanded; stand where nothing was, or long ago."""
        wish = now.wish
        if wish is None or wish.kind is not WishKind.BODY:
            return Decision(self._stand, "body")
        own = np.maximum(wish.values[:, 2], -self.team.tick)  # none is younger than the tick that it echoes by more
        ages = np.where(wish.told, wish.age + own, np.nan)
        fresh = ages <= self.settings.silent_s + _ROUNDING
        return Decision(np.where(fresh[:, None], wish.values[:, :2], 0.0), "body", figures={"command_age": ages})
