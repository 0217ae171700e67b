"""A person's hand on a robot: commands of a group whose behaviour is ``teleop``, by the ticks that the person has seen.

A stick is a gamepad's, or the page's, by a finger, a mouse or keys. It is held while the dead-man's button is, or while
a finger, a mouse or a key holds it. Nothing is sent but while it is held; when it is let go, and when it is seen up for
the first time, the robots are told at once that they stand.
Silence does the same: a command that is older than the behaviour's ``silent_s`` counts for nothing.

In a held run the person may drive one robot of the group out, at a crawl. A stick that was held for something else,
as when the run is held, or before this hand began, counts for nothing until it was let go.
"""

import secrets
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from robofleet.behaviours import described
from robofleet.behaviours.interface import WishKind
from robofleet.behaviours.teleop import Teleop
from robofleet.bus.bus import Bus
from robofleet.bus.keys import TELEOP
from robofleet.bus.messages import SCRIPT_WISH, TickRecord
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import MS
from robofleet.nodes.setpoints import LEASE_EXPIRES_S

_EPOCH_BITS = 30  # as of scripts
_MOST_TICKS = 1 << 32  # in a message of setpoints
_LEAST_GAP_NS = 4 * MS  # between two commands of a page; it repeats them at each picture of its screen


class Stick(NamedTuple):
    """What a person does with a stick."""

    forward: float  # -1 to 1
    turn: float  # to the left, -1 to 1
    held: bool


def driven(config: Config) -> tuple[str, ...]:
    """Return the groups that a person drives."""
    return groups.taking_setpoints(config, Teleop)


def drivers(described_groups: Sequence[described.Group], record: TickRecord | None) -> dict[str, int]:
    """Return which hand drives each group at a tick, by its ``epoch``; a group that nobody drives is left out."""
    if record is None or len(record.figures) < described.size(described_groups):
        return {}
    values = described.told(described_groups, np.array([record.figures]))
    figures = ((group.name, part.figures) for group, part in zip(described_groups, values, strict=True))
    return {
        name: int(by_name["wish_epoch"][0, 0])
        for name, by_name in figures
        if {"wish_epoch", "command_age"} <= by_name.keys() and (by_name["command_age"] <= LEASE_EXPIRES_S).any()
    }


class Hand:
    """Commands one group. ``epoch`` is the hand's own number, by which ``drivers`` names it."""

    def __init__(self, bus: Bus, config: Config, group: str) -> None:
        own = next(candidate for candidate in config.groups if candidate.title == group)
        settings = Teleop.Settings.model_validate(own.settings)
        self._most = {
            WishKind.BODY: (settings.max_speed_m_s, settings.max_turn_rad_s),
            WishKind.RESCUE: (min(settings.crawl_m_s, settings.max_speed_m_s), settings.max_turn_rad_s),
        }
        self._ids = own.robots
        self._publish = bus.publisher(TELEOP, group)
        self._robots = np.zeros(len(own.robots), SCRIPT_WISH.item_dtype)
        self._values = SCRIPT_WISH.floats(self._robots)  # of the same memory (N, 3)
        self.epoch, self._seq = 1 + secrets.randbits(_EPOCH_BITS - 1), 0
        self._tick = 0
        self._held: tuple[WishKind, int] | None = None  # what the stick is held for, and of which robot
        self._spent = True  # the stick may be held for something else, and was not seen let go since

    def drive(self, stick: Stick, tick: int, out: str | None = None) -> bool:
        """Command what the stick says by a tick that the person's computer has seen; the release, once.

        ``out``: the robot that is driven out of a held run. Returns whether it is one of the group's.
        """
        if out is not None and out not in self._ids:
            return False
        kind, row = (WishKind.BODY, 0) if out is None else (WishKind.RESCUE, self._ids.index(out))
        self._command(kind, row, stick, tick)
        return True

    def _command(self, kind: WishKind, row: int, stick: Stick, tick: int) -> None:
        self._tick = max(self._tick, tick)
        if not stick.held:
            if self._spent:
                self._stand()
                self._spent = False
            self.let_go()
            return
        if tick <= 0:
            self.let_go()
            return
        if self._held not in (None, (kind, row)):
            self.let_go()
            self._spent = True
        if self._spent:
            return
        forward, turn = (min(max(value, -1.0), 1.0) for value in stick[:2])
        self._robots["told"] = np.arange(len(self._robots)) == row
        self._values[row, :2] = np.multiply((forward, turn), self._most[kind])
        self._say(kind, tick)
        self._held = kind, row

    def let_go(self) -> None:
        """Let the robots stand, if they were driven."""
        if self._held is not None:
            self._stand()

    def _stand(self) -> None:
        self._values[:, :2] = 0.0
        self._say(WishKind.STAND, self._tick)
        self._held = None

    def _say(self, kind: WishKind, tick: int) -> None:
        self._seq += 1
        self._publish(SCRIPT_WISH.encode_array((self.epoch, self._seq, kind, 0, tick), self._robots))


class Hands:
    """One person's hand on each group that a person can drive, by a page."""

    def __init__(self, bus: Bus, config: Config, now_ns: Callable[[], int]) -> None:
        self._hands, self._now_ns = {group: Hand(bus, config, group) for group in driven(config)}, now_ns
        self._held_ns = 0  # when a stick was held last

    @property
    def epochs(self) -> dict[str, int]:
        """The hand's number on each group."""
        return {group: hand.epoch for group, hand in self._hands.items()}

    def drive(self, group: str, stick: Stick, tick: int, out: str | None = None) -> bool:
        """Command a group, or drive its robot ``out`` of a held run; returns whether that made sense.

        A held stick that comes too soon after the one before is left out.
        """
        if not (group in self._hands and all(-1.0 <= value <= 1.0 for value in stick[:2]) and 0 <= tick < _MOST_TICKS):
            return False
        now_ns = self._now_ns()
        if stick.held and now_ns - self._held_ns < _LEAST_GAP_NS:
            return True
        if stick.held:
            self._held_ns = now_ns
        return self._hands[group].drive(stick, tick, out)

    def let_go(self) -> None:
        for hand in self._hands.values():
            hand.let_go()
