"""A person's commands to drive one robot out of a held run: as received, and how fast a wheel may turn for them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.interface import WishKind
from robofleet.behaviours.teleop import Teleop
from robofleet.bus.bus import Bus
from robofleet.bus.keys import TELEOP, key, split
from robofleet.bus.messages import SCRIPT_WISH
from robofleet.bus.permissions import PAGE
from robofleet.config import groups, slices
from robofleet.config.tree import Config
from robofleet.safety.rescue import Word
from robofleet.safety.supervisor import NOBODY, Event

_MOST_WORDS = 64  # between two steps, of a group


def crawls(config: Config) -> NDArray[np.float64]:
    """Return the fastest wheel of each member that is driven out [rad/s]; 0 of who is in no group for a person."""
    limits, by_hand = np.zeros(len(config.members)), groups.taking_setpoints(config, Teleop)
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
        by_hand = groups.taking_setpoints(config, Teleop)
        self._groups = [
            (bus.stream(key(config.arena.name, TELEOP, group.title), capacity=_MOST_WORDS), rows)
            for group, rows in zip(config.groups, groups.rows(config.groups), strict=True)
            if group.title in by_hand
        ]

    def new(self) -> Iterator[Word]:
        """Yield the words since the last call, in the order in which they came."""
        for stream, rows in self._groups:
            for _, full, payload in stream.drain():
                if (message := SCRIPT_WISH.view(payload)) is None:
                    continue
                head, robots = message
                sender = split(full)[1]
                by_page = sender.partition("/")[0] == PAGE
                commanded = np.flatnonzero(robots["told"]).tolist()
                out = head.kind == WishKind.RESCUE and len(commanded) == 1 and len(robots) == rows.stop - rows.start
                held = head.kind in (WishKind.BODY, WishKind.RESCUE)
                robot = rows.start + commanded[0] if out else NOBODY
                event = Event.DRIVEN_OUT_BY_PAGE if by_page else Event.DRIVEN_OUT_BY_GAMEPAD
                yield Word((sender, head.epoch), held, robot, event, head.echo_tick)
