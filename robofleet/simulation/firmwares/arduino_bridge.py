"""ros_arduino_bridge, the sketch of an Arduino that runs two motors, as its public source describes it.

Source: github.com/hbrobotics/ros_arduino_bridge. A command is a letter and up to two arguments, ended by a CR; each has
one answer, ended by CR LF. The reader knows no errors: the last character before the first space is the letter; in the
second argument spaces count for nothing; what is no number is 0, and what follows a number is passed over. A line that
lost its CR stays there until one comes. A target is in counts per frame of the speed loop, which runs 30 times a second
by name and every ``1000 / 30 = 33`` whole milliseconds in truth.
"""

import re

from robofleet.simulation.firmware import Hardware
from robofleet.vehicles.interface import STOP, WheelSpeeds

_BOOT_NS = 1_500_000_000  # assumed: the boot loader waits for a new sketch for so long
_AUTO_STOP_S = 2.0
_ROOM = 31  # characters of an argument; a real board writes what is more over its other variables
_NUMBER = re.compile(rb"[\t-\r]*([+-]?\d+)")
_CR, _SPACE = 13, 32
# what this robot does not have: pins, a sonar, servos
_OTHERS = dict.fromkeys(b"cwxsjvyz", b"OK") | dict.fromkeys(b"adpt", b"0")


class ArduinoBridgeFirmware:
    """The sketch on an Arduino with an AVR: its ``int`` has 16 bits, and opening its port resets it."""

    baud = 57600
    watchdog_s = _AUTO_STOP_S  # since the last ``m``; nothing else feeds it

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._start(0)

    def opened(self, now_ns: int) -> None:
        """Reset, as a host does that opens the port."""
        self._start(now_ns + _BOOT_NS)

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Read characters, and answer the commands that are complete with them."""
        if now_ns < self._ready_ns:
            return b""  # the boot loader takes them
        return b"".join(self._read(character, now_ns) for character in data)

    def loop(self, now_ns: int) -> bytes:
        if now_ns - self._moved_ns > _AUTO_STOP_S * 1e9:
            self._moving, self._hardware.command = False, STOP
        if self._moving:
            rad_s = self._hardware.radians_per_count / self._hardware.loop_period
            self._hardware.command = WheelSpeeds(self._target[0] * rad_s, self._target[1] * rad_s)
        return b""

    def _start(self, ready_ns: int) -> None:
        self._ready_ns = self._moved_ns = ready_ns
        self.gains = (20, 12, 0, 50)  # Kp, Kd, Ki, Ko: told and kept; the motors' loop is the plant's
        self._zero = self._hardware.counts
        self._moving, self._target = False, (0, 0)
        self._hardware.command = STOP
        self._forget()

    def _forget(self) -> None:
        self._letter, self._arguments, self._at = 0, (bytearray(), bytearray()), -1

    def _read(self, character: int, now_ns: int) -> bytes:
        if character == _CR:
            answer = self._run(now_ns) + b"\r\n"
            self._forget()
            return answer
        if character == _SPACE:
            self._at = min(self._at + 1, 1)
        elif self._at < 0:
            self._letter = character
        elif len(self._arguments[self._at]) < _ROOM:
            self._arguments[self._at].append(character)
        return b""

    def _run(self, now_ns: int) -> bytes:
        letter = chr(self._letter)
        if letter == "b":
            return b" %d" % self.baud
        if letter == "e":
            (left, right), (left_zero, right_zero) = self._hardware.counts, self._zero
            return b"%d %d" % (_wrapped(left - left_zero, 32), _wrapped(right - right_zero, 32))
        if letter == "m":
            left, right = map(_integer, self._arguments)
            self._moved_ns, self._target = now_ns, (left, right)
            self._moving = self._target != (0, 0)
            if not self._moving:
                self._hardware.command = STOP  # at once; a motion waits for the next frame
        elif letter == "r":
            self._zero, self._target = self._hardware.counts, (0, 0)
        elif letter == "u":
            gains = [_integer(part) for part in self._arguments[0].split(b"\0")[0].split(b":") if part]
            # a gain that is missing is whatever stood on the stack: here the one from before
            kp, kd, ki, ko = (*gains[:4], *self.gains[len(gains) :])
            self.gains = kp, kd, ki, ko
        else:
            return _OTHERS.get(self._letter, b"Invalid Command")
        return b"OK"


def _integer(text: bytes | bytearray) -> int:
    """Return what C's ``atoi`` makes of it on this computer."""
    number = _NUMBER.match(text)
    return 0 if number is None else _wrapped(int(number[1]), 16)


def _wrapped(value: int, bits: int) -> int:
    half = 1 << (bits - 1)
    return (value + half) % (2 * half) - half
