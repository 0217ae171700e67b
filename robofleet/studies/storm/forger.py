"""Forged messages that every gate must refuse: copies of messages on the bus, with one field wrong."""

from collections.abc import Callable
from typing import Any

import numpy as np

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import COMMAND, ENABLE
from robofleet.bus.messages import UNIT_COMMAND, UNIT_ENABLE, UnitCommand, UnitEnable
from robofleet.core.clock import MS
from robofleet.recording.run import Recording

_OLD_NS = 130 * MS
_SPEED_FACTOR = 3.0  # of the limit; the true command may be slow


def _after(seq: int) -> int:
    """Return the next sequence number; an operator's emergency stop has the last one."""
    return (seq + 1) % (1 << 64)


def _all(message: Any, **changes: Any) -> Any:
    """Return a message in which something is changed for every robot."""
    return message._replace(robots=tuple(robot._replace(**changes) for robot in message.robots))


_COMMANDS: tuple[Callable[[UnitCommand, float], UnitCommand], ...] = (
    lambda c, _: c._replace(seq=c.seq + 1, robots=tuple(r._replace(epoch=max(0, r.epoch - 1)) for r in c.robots)),
    lambda c, _: c._replace(seq=c.seq + 1, session=c.session + 1),
    lambda c, _: c._replace(seq=c.seq + 1, boot_id=c.boot_id ^ 1),
    lambda c, _: c._replace(seq=c.seq + 1, nonce=c.nonce - _OLD_NS),
    lambda c, top: _all(c._replace(seq=c.seq + 1), left_rad_s=_SPEED_FACTOR * top, right_rad_s=-_SPEED_FACTOR * top),
    lambda c, _: _all(c, left_rad_s=1.0, right_rad_s=1.0),  # a sequence number once more
    lambda c, _: c._replace(seq=c.seq + 1, robots=(*c.robots, *c.robots[:1])),  # of another unit
)
_ENABLES: tuple[Callable[[UnitEnable], UnitEnable], ...] = (
    lambda e: e._replace(
        seq=_after(e.seq), robots=tuple(r._replace(epoch=r.epoch + 1, limit_rad_s=5.0) for r in e.robots)
    ),
    lambda e: _all(e._replace(seq=_after(e.seq), boot_id=e.boot_id ^ 1), limit_rad_s=5.0),
    lambda e: _all(e._replace(seq=_after(e.seq), nonce=e.nonce - _OLD_NS), limit_rad_s=5.0),
    lambda e: _all(e, limit_rad_s=5.0),
)


def forge(bus: MemoryBus, recording: Recording, losing: Callable[[str], bool], rng: np.random.Generator) -> None:
    """Say one wrong command and one wrong enable, as an attacker on the network or a broken program does.

    A sequence number once more is wrong only where the first one came: where it may be lost, nothing is forged so.
    ``losing``: whether messages of a topic may be lost now.
    """
    units = recording.config.units
    unit = tuple(units)[int(rng.integers(len(units)))]
    command, enable = (recording.newest(topic, unit) for topic in (COMMAND, ENABLE))
    if command is not None:
        top = max(recording.config.robot(robot).vehicle.max_wheel_speed_rad_s for robot in units[unit])
        wrong = _COMMANDS[int(rng.integers(len(_COMMANDS)))](command, top)
        if wrong.seq != command.seq or not losing("cmd"):
            bus.publisher(COMMAND, unit)(UNIT_COMMAND.encode(wrong))
    if enable is not None:
        broken = _ENABLES[int(rng.integers(len(_ENABLES)))](enable)
        if broken.seq != enable.seq or not losing("enable"):
            bus.publisher(ENABLE, unit)(UNIT_ENABLE.encode(broken))
