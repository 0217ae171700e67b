"""A person's wish to drive one robot out of a held run: as it is heard, and how fast a wheel may turn for it."""

from collections.abc import Iterator
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.interface import WishKind
from robofleet.behaviours.teleop import Teleop
from robofleet.comms.bus import Bus
from robofleet.comms.keys import WISH, key
from robofleet.comms.messages import SCRIPT_WISH
from robofleet.config import groups, slices
from robofleet.config.tree import Config
from robofleet.safety.rescue import Word
from robofleet.safety.supervisor import NOBODY, Event

_MOST_WORDS = 64  # between two steps, of all groups


class Way(IntEnum):
    """Where a person's command comes from. The wish's field ``order`` holds it."""

    PAGE = 1
    GAMEPAD = 2


_ASKED = {Way.PAGE: Event.DRIVEN_OUT_BY_PAGE, Way.GAMEPAD: Event.DRIVEN_OUT_BY_GAMEPAD}


def crawls(config: Config) -> NDArray[np.float64]:
    """Return the fastest wheel of each member that is driven out [rad/s]; 0 of who is in no group for a person."""
    limits, by_hand = np.zeros(len(config.members)), groups.wishing(config, Teleop)
    for group, rows in zip(config.groups, groups.rows(config.groups), strict=True):
        if group.title in by_hand:
            crawl = Teleop.Settings.model_validate(group.settings).crawl_m_s
            for row in range(rows.start, rows.stop):
                drive = slices.drive(config.members[row])
                limits[row] = min(crawl / drive.wheel_radius, drive.max_wheel_speed)
    return limits


class Words:
    """What persons say to the groups that they may drive; ``crawls``: how fast each robot's wheels may turn then."""

    def __init__(self, config: Config, bus: Bus) -> None:
        self.crawls = crawls(config)
        by_hand = groups.wishing(config, Teleop)
        rows = zip(config.groups, groups.rows(config.groups), strict=True)
        self._rows = {key(config.arena.name, WISH, group.title): own for group, own in rows if group.title in by_hand}
        self._stream = bus.stream(*self._rows, capacity=_MOST_WORDS) if self._rows else None

    def new(self) -> Iterator[Word]:
        """Yield the words since the last call, in the order in which they came."""
        for _, full, payload in self._stream.drain() if self._stream is not None else ():
            if (message := SCRIPT_WISH.view(payload)) is None:
                continue
            head, robots = message
            own = self._rows[full]
            told = np.flatnonzero(robots["told"]).tolist()
            out = head.kind == WishKind.RESCUE and len(told) == 1 and len(robots) == own.stop - own.start
            held = head.kind in (WishKind.BODY, WishKind.RESCUE)
            asked = _ASKED.get(head.order, Event.NOTHING)  # type: ignore[call-overload]
            out = out and asked is not Event.NOTHING
            yield Word(head.epoch, held, own.start + told[0] if out else NOBODY, asked, head.echo_tick)
