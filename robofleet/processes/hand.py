"""A person's hand on a robot: commands of a group whose behaviour is ``teleop``, by the ticks that the person has seen.

Nothing is sent but while the dead-man's button is held; when it is let go, the robots are told at once that they stand.
Silence does the same: a command that is older than the behaviour's ``silent_s`` counts for nothing.
"""

import math
import secrets
from typing import NamedTuple

import numpy as np

from robofleet.behaviours.interface import WishKind
from robofleet.behaviours.teleop import Teleop
from robofleet.comms.bus import Bus
from robofleet.comms.keys import WISH
from robofleet.comms.messages import SCRIPT_WISH
from robofleet.config import groups
from robofleet.config.tree import Config

_EPOCH_BITS = 30  # as of scripts
_MOST_TICKS = 1 << 32  # in a wish


class Stick(NamedTuple):
    """What a person does with a gamepad."""

    forward: float  # -1 to 1
    turn: float  # to the left, -1 to 1
    held: bool  # the dead-man's button

    @property
    def sound(self) -> bool:
        """Whether it can be one: its numbers are finite."""
        return math.isfinite(self.forward) and math.isfinite(self.turn)


def driven(config: Config) -> tuple[str, ...]:
    """Return the groups that a person drives."""
    return groups.wishing(config, Teleop)


class Hand:
    """Commands one group."""

    def __init__(self, bus: Bus, config: Config, group: str) -> None:
        its = next(one for one in config.groups if one.title == group)
        settings = Teleop.Settings.model_validate(its.settings)
        self._most = settings.max_speed_m_s, settings.max_turn_rad_s
        self._publish = bus.publisher(WISH, group)
        self._robots = np.zeros(len(its.robots), SCRIPT_WISH.item_dtype)
        self._values = SCRIPT_WISH.floats(self._robots)  # of the same memory (N, 3)
        self._robots["told"][0] = 1
        self._epoch, self._seq = 1 + secrets.randbits(_EPOCH_BITS - 1), 0
        self._held, self._tick = False, 0

    def drive(self, stick: Stick, tick: int) -> None:
        """Command what the stick says by a tick that the person's computer has seen; the release, once."""
        self._tick = max(self._tick, tick)
        if stick.held and tick > 0:
            forward, turn = (min(max(value, -1.0), 1.0) for value in stick[:2])
            self._values[0, :2] = forward * self._most[0], turn * self._most[1]
            self._say(WishKind.BODY, tick)
            self._held = True
        else:
            self.let_go()

    def let_go(self) -> None:
        """Let the robots stand, if they were driven."""
        if self._held:
            self._values[0, :2] = 0.0
            self._say(WishKind.STAND, self._tick)
            self._held = False

    def _say(self, kind: WishKind, tick: int) -> None:
        self._seq += 1
        self._publish(SCRIPT_WISH.encode_array((self._epoch, self._seq, kind, 0, tick), self._robots))


class Hands:
    """One person's hand on each group that a person can drive."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._hands = {group: Hand(bus, config, group) for group in driven(config)}

    def drive(self, group: str, stick: Stick, tick: int) -> bool:
        """Command a group; returns whether that made sense."""
        if group not in self._hands or not stick.sound or not 0 <= tick < _MOST_TICKS:
            return False
        self._hands[group].drive(stick, tick)
        return True

    def let_go(self) -> None:
        """Let all of them stand."""
        for hand in self._hands.values():
            hand.let_go()
