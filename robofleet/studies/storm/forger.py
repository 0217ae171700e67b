"""Messages that nobody may obey, made from those that are on the bus: the newest nonce, and one thing wrong."""

from collections.abc import Callable

import numpy as np

from robofleet.clock import MS
from robofleet.comms.bus import MemoryBus
from robofleet.comms.keys import COMMAND, ENABLE, key
from robofleet.comms.messages import ENABLE as ENABLE_LAYOUT
from robofleet.comms.messages import WHEEL_COMMAND, Enable, WheelCommand
from robofleet.recording.run import Recording

_OLD_NS = 130 * MS
_FAST = 3.0  # times the limit; the true command may be slow


def _after(seq: int) -> int:
    """Return the next sequence number; an operator's emergency stop has the last one."""
    return (seq + 1) % (1 << 64)


_COMMANDS: tuple[Callable[[WheelCommand, float], WheelCommand], ...] = (
    lambda c, _: c._replace(seq=c.seq + 1, epoch=max(0, c.epoch - 1)),
    lambda c, _: c._replace(seq=c.seq + 1, session=c.session + 1),
    lambda c, _: c._replace(seq=c.seq + 1, boot_id=c.boot_id ^ 1),
    lambda c, _: c._replace(seq=c.seq + 1, nonce=c.nonce - _OLD_NS),
    lambda c, top: c._replace(seq=c.seq + 1, left_rad_s=_FAST * top, right_rad_s=-_FAST * top),
    lambda c, _: c._replace(left_rad_s=1.0, right_rad_s=1.0),  # a sequence number once more
)
_ENABLES: tuple[Callable[[Enable], Enable], ...] = (
    lambda e: e._replace(seq=_after(e.seq), epoch=e.epoch + 1, limit_rad_s=5.0),
    lambda e: e._replace(seq=_after(e.seq), boot_id=e.boot_id ^ 1, limit_rad_s=5.0),
    lambda e: e._replace(seq=_after(e.seq), nonce=e.nonce - _OLD_NS, limit_rad_s=5.0),
    lambda e: e._replace(limit_rad_s=5.0),
)


class Forger:
    """Somebody on the network who means no good, or a program that is broken."""

    def __init__(self, arena: str, bus: MemoryBus, recording: Recording, tops: dict[str, float]) -> None:
        self._arena, self._bus, self._recording, self._tops = arena, bus, recording, tops
        self._robots = tuple(tops)

    def forge(self, rng: np.random.Generator) -> None:
        """Say one wrong command and one wrong enable."""
        robot = self._robots[int(rng.integers(len(self._robots)))]
        said = self._recording.messages
        commands, enables = (said.get(key(self._arena, topic, robot), ()) for topic in (COMMAND, ENABLE))
        if commands and (command := WHEEL_COMMAND.decode(commands[-1])) is not None:
            wrong = _COMMANDS[int(rng.integers(len(_COMMANDS)))](command, self._tops[robot])
            self._bus.publisher(COMMAND, robot)(WHEEL_COMMAND.encode(wrong))
        if enables and (enable := ENABLE_LAYOUT.decode(enables[-1])) is not None:
            broken = _ENABLES[int(rng.integers(len(_ENABLES)))](enable)
            self._bus.publisher(ENABLE, robot)(ENABLE_LAYOUT.encode(broken))
