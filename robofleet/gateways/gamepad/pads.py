"""Gamepads by Linux's event devices, through the library ``evdev``."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from robofleet.core.errors import RobofleetError
from robofleet.operator.hand import Stick

EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03  # kinds of events, linux/input-event-codes.h
SYN_REPORT, SYN_DROPPED = 0, 3
ABS_X, ABS_Y = 0x00, 0x01  # the left stick: to the right and to the person are positive
BTN_TL, BTN_TR, BTN_SOUTH = 0x136, 0x137, 0x130
HOLD = BTN_TL, BTN_TR  # the shoulder buttons
_DEAD_ZONE = 0.08  # of a stick that is let go
_DEVICES = "/dev/input"
_JOIN = "run `sudo usermod -aG input $USER`, then log in again"


class PadError(RobofleetError):
    """Raised where there is no gamepad, or it cannot be read. The message is a line that says how to mend it."""


class Held:
    """The state of a stick and of the buttons, from events: kind, code, value.

    Where the kernel dropped events (SYN_DROPPED), a release may be among them: every button counts as released until
    it is pressed again, and the stick as at rest until it moves. The rest of the broken report is ignored.
    """

    def __init__(self, ranges: dict[int, tuple[int, int]]) -> None:
        """Take the least and the most of each axis."""
        self._ranges = ranges
        self._at = dict.fromkeys((ABS_X, ABS_Y), 0.0)
        self._pressed: set[int] = set()
        self._broken = False  # the report that is being read

    def take(self, events: Iterable[tuple[int, int, int]]) -> Stick:
        for kind, code, value in events:
            if kind == EV_SYN:
                self._broken = code == SYN_DROPPED or (self._broken and code != SYN_REPORT)
                if code == SYN_DROPPED:
                    self._pressed.clear()
                    self._at = dict.fromkeys(self._at, 0.0)
            elif self._broken:
                continue
            elif kind == EV_KEY:
                (self._pressed.add if value else self._pressed.discard)(code)
            elif kind == EV_ABS and code in self._ranges:
                least, most = self._ranges[code]
                at = 2.0 * (value - least) / (most - least) - 1.0
                self._at[code] = 0.0 if abs(at) < _DEAD_ZONE else at
        return Stick(-self._at[ABS_Y], -self._at[ABS_X], not self._pressed.isdisjoint(HOLD))


class EventPad:
    """A gamepad of ``evdev``: a file descriptor, which is readable when something happened."""

    def __init__(self, device: Any) -> None:
        axes = {code: (info.min, info.max) for code, info in device.capabilities(absinfo=True)[EV_ABS]}
        self.name, self._device = device.name, device
        self._held = Held({axis: axes[axis] for axis in (ABS_X, ABS_Y)})

    def fileno(self) -> int:
        return int(self._device.fd)

    def read(self) -> Stick:
        """Take what happened, and return how its stick is; OSError where it is gone."""
        events: list[Any] = []
        with suppress(BlockingIOError):  # nothing happened
            events = list(self._device.read())
        return self._held.take((event.type, event.code, event.value) for event in events)


def opened(path: Path | None) -> EventPad:
    """Return the gamepad that was named, or the only one; PadError where there is none."""
    import evdev  # noqa: PLC0415

    paths = [str(path)] if path is not None else evdev.list_devices(_DEVICES)
    try:
        devices: list[Any] = [evdev.InputDevice(file) for file in paths]
    except PermissionError as error:
        raise PadError(f"{error.filename}: this user may not read it: {_JOIN}") from error
    except OSError as error:
        raise PadError(f"{error.filename}: {error.strerror}: name a gamepad with --device {_DEVICES}/event*") from error
    found = [device for device in devices if _is_pad(device)]
    if path is not None and not found:
        raise PadError(f"--device {path}: {devices[0].name} has no stick and no shoulder buttons: name a gamepad")
    if not found and any(not os.access(file, os.R_OK | os.W_OK) for file in Path(_DEVICES).glob("event*")):
        raise PadError(f"no gamepad is among the devices of {_DEVICES} that this user may read: {_JOIN}")
    if not found:
        raise PadError("no gamepad is here: plug one in, or switch it on")
    if len(found) > 1:
        raise PadError(
            f"several gamepads are here: name one with --device: {', '.join(device.path for device in found)}"
        )
    return EventPad(found[0])


def _is_pad(device: Any) -> bool:
    has = device.capabilities(absinfo=False)
    return {ABS_X, ABS_Y} <= set(has.get(EV_ABS, ())) and not set(HOLD).isdisjoint(has.get(EV_KEY, ()))
