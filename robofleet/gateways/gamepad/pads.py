"""Gamepads by Linux's event devices, through the library ``evdev``; what reads them asks for a ``Pad``."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

from robofleet.processes.hand import Stick

EV_KEY, EV_ABS = 0x01, 0x03  # kinds of events, linux/input-event-codes.h
ABS_X, ABS_Y = 0x00, 0x01  # the left stick: to the right and to the person are positive
BTN_TL, BTN_TR, BTN_SOUTH = 0x136, 0x137, 0x130
HOLD = BTN_TL, BTN_TR  # the shoulder buttons
_DEAD = 0.08  # of a stick that is let go


class PadError(Exception):
    """There is no gamepad, or it cannot be read; the message is a line that says how to mend it."""


class Pad(Protocol):
    """What is asked of a gamepad. A file descriptor, which is readable when something happened."""

    name: str

    def fileno(self) -> int:
        """Return the descriptor."""

    def read(self) -> Stick:
        """Take what happened, and return how its stick is; OSError where it is gone."""


class Held:
    """The state of a stick and of the buttons, from events: kind, code, value."""

    def __init__(self, ranges: dict[int, tuple[int, int]]) -> None:
        """Take the least and the most of each axis."""
        self._ranges = ranges
        self._at = dict.fromkeys((ABS_X, ABS_Y), 0.0)
        self._pressed: set[int] = set()

    def take(self, events: Iterable[tuple[int, int, int]]) -> Stick:
        """Take events, in order."""
        for kind, code, value in events:
            if kind == EV_KEY:
                (self._pressed.add if value else self._pressed.discard)(code)
            elif kind == EV_ABS and code in self._ranges:
                least, most = self._ranges[code]
                at = 2.0 * (value - least) / (most - least) - 1.0
                self._at[code] = 0.0 if abs(at) < _DEAD else at
        return Stick(-self._at[ABS_Y], -self._at[ABS_X], not self._pressed.isdisjoint(HOLD))


class EventPad:
    """A gamepad of ``evdev``."""

    def __init__(self, device: Any) -> None:
        axes = {code: (info.min, info.max) for code, info in device.capabilities(absinfo=True)[EV_ABS]}
        self.name, self._device = device.name, device
        self._held = Held({axis: axes[axis] for axis in (ABS_X, ABS_Y)})

    def fileno(self) -> int:
        """Return the descriptor."""
        return int(self._device.fd)

    def read(self) -> Stick:
        """Take what happened."""
        return self._held.take((event.type, event.code, event.value) for event in self._device.read())


def opened(path: Path | None) -> EventPad:
    """Return the gamepad that was named, or the only one; PadError where there is none."""
    import evdev  # noqa: PLC0415

    if path is not None:
        try:
            device = evdev.InputDevice(str(path))
        except OSError as error:
            raise PadError(f"--device {path}: {error.strerror or error}: name one of /dev/input/event*") from error
        if not _is_pad(device):
            raise PadError(f"--device {path}: {device.name} has no stick and no shoulder buttons: name a gamepad")
        return EventPad(device)
    devices: list[Any] = [evdev.InputDevice(one) for one in evdev.list_devices()]
    found = [device for device in devices if _is_pad(device)]
    if not found:
        raise PadError(
            "no gamepad is here that this user may read: plug one in; `sudo usermod -aG input $USER`, then log in again"
        )
    if len(found) > 1:
        raise PadError(f"several gamepads are here: name one with --device: {', '.join(one.path for one in found)}")
    return EventPad(found[0])


def _is_pad(device: Any) -> bool:
    has = device.capabilities()
    return {ABS_X, ABS_Y} <= set(has.get(EV_ABS, ())) and not set(HOLD).isdisjoint(has.get(EV_KEY, ()))
