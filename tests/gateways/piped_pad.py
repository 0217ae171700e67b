"""Event devices of evdev whose events come through a pipe: /dev/uinput is not everywhere. What reads them is evdev."""

import os
import struct

import evdev

from robofleet.gateways.gamepad.pads import ABS_X, ABS_Y, BTN_TL, BTN_TR, EV_ABS, EV_KEY

STICK = [(ABS_X, (128, 0, 255, 0, 0, 0)), (ABS_Y, (0, -32768, 32767, 0, 0, 0))]  # as the kernel tells axes
SHOULDERS = [BTN_TL, BTN_TR]


class PipedDevice(evdev.InputDevice):  # type: ignore[type-arg]
    """A gamepad, unless it is told that it has something else."""

    def __init__(self, path: str = "a pipe", has: dict[int, list[object]] | None = None) -> None:
        self.fd, self._writing = os.pipe()
        os.set_blocking(self.fd, False)
        self.path = self.name = path
        self._rawcapabilities = has if has is not None else {EV_KEY: SHOULDERS, EV_ABS: STICK}

    def happens(self, *events: tuple[int, int, int]) -> None:
        """Let events come, in one read."""
        os.write(self._writing, b"".join(struct.pack("llHHi", 0, 0, *event) for event in events))

    def close(self) -> None:
        super().close()
        if self._writing >= 0:
            os.close(self._writing)
            self._writing = -1
