"""An iRobot Create 2 as its Open Interface describes it: opcodes with their data, modes, a stream every 15 ms.

What the description leaves open is assumed: an unknown opcode is passed over, a speed beyond 500 mm/s is clipped,
cleaning drives straight on, a reset takes 3 s. Opcodes that the driver has no use for are taken with their data and do
nothing, the other ways to drive and another baud rate too.
"""

import struct
from collections.abc import Callable
from enum import IntEnum

from robofleet.simulation.firmware import Hardware
from robofleet.vehicles.interface import STOP, RobotFault, WheelSpeeds

_FASTEST_MM_S = 500
_CLEANING_MM_S = 300
_CAPACITY_MAH = 2696
_SLEEP_NS = 300_000_000_000
_RESET_NS = 3_000_000_000
_RESET, _START, _BAUD, _SAFE, _FULL, _POWER, _STOP_OI = 7, 128, 129, 131, 132, 133, 173
_DRIVE_DIRECT, _STREAM, _PAUSE = 145, 148, 150
_CLEANING_OPCODES = (134, 135, 136, 143)  # spot, clean, max, seek dock
_DATA = {  # bytes that follow an opcode; none after all others
    **{_BAUD: 1, 137: 4, 138: 1, 139: 3, 141: 1, 142: 1, 144: 3, _DRIVE_DIRECT: 4, 146: 4, _PAUSE: 1},
    **{162: 2, 163: 4, 164: 4, 165: 1, 167: 15, 168: 3},
}
_COUNTED = {140: (2, 2), _STREAM: (1, 1), 149: (1, 1)}  # songs and lists: where their length stands, bytes an item


class Mode(IntEnum):
    """Of the Open Interface."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


class Create2Firmware:
    """One Create 2, switched on: its interface is off until it is started."""

    baud = 115200
    watchdog_s: float | None = None  # none is described
    reports = RobotFault.BUMPED | RobotFault.CLIFF | RobotFault.WHEEL_DROPPED

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self.mode = Mode.OFF
        self._pending = b""  # of an opcode whose data have not all come
        self._stream: tuple[int, ...] = ()
        self._streams = False
        self._requested = (0, 0)  # left, right [mm/s]
        self._idle_ns: int | None = None  # since when it is passive
        self._deaf_until_ns = 0
        self._packets = self._sensors()

    def opened(self, now_ns: int) -> None:
        """Nothing: its interface does not feel that the port was opened."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Carry out what is complete; nothing is answered but by the stream."""
        if now_ns < self._deaf_until_ns or self._asleep(now_ns):
            return b""
        pending = self._pending + data
        while pending and len(pending) >= (needed := self._needed(pending)):
            self._execute(pending[0], pending[1:needed], now_ns)
            pending = pending[needed:]
        self._pending = pending
        return b""

    def loop(self, now_ns: int) -> bytes:
        """Stop by itself where safe mode does; return what is streamed."""
        if self._idle_ns is None:
            self._idle_ns = now_ns
        if self.mode is Mode.SAFE and self._in_danger():
            self._enter(Mode.PASSIVE, now_ns)
        if not self._streams or not self._stream or self.mode is Mode.OFF or self._asleep(now_ns):
            return b""
        body = b"".join(bytes((packet,)) + self._packets[packet]() for packet in self._stream)
        frame = bytes((19, len(body))) + body
        return frame + bytes((-sum(frame) % 256,))

    def _needed(self, pending: bytes) -> int:
        """Return how many bytes the first opcode takes with its data."""
        opcode = pending[0]
        if self.mode is Mode.OFF:
            return 1  # it looks for start and for reset
        if opcode in _COUNTED:
            where, each = _COUNTED[opcode]
            return where + 1 + (each * pending[where] if len(pending) > where else 0)
        return 1 + _DATA.get(opcode, 0)

    def _execute(self, opcode: int, data: bytes, now_ns: int) -> None:
        if opcode == _RESET:
            self._enter(Mode.OFF, now_ns)
            self._deaf_until_ns = now_ns + _RESET_NS
        elif opcode == _START:
            self._enter(Mode.PASSIVE, now_ns)
        elif self.mode is Mode.OFF:
            return
        elif opcode in (_POWER, _STOP_OI):
            self._enter(Mode.OFF, now_ns)
        elif opcode in _CLEANING_OPCODES:
            self._enter(Mode.PASSIVE, now_ns)
            self._drive(_CLEANING_MM_S, _CLEANING_MM_S)
        elif opcode in (_SAFE, _FULL):
            self._enter(Mode.SAFE if opcode == _SAFE else Mode.FULL, now_ns)
        elif opcode == _DRIVE_DIRECT and self.mode in (Mode.SAFE, Mode.FULL):
            right, left = struct.unpack(">hh", data)
            self._drive(left, right)
        elif opcode == _STREAM:
            self._stream, self._streams = tuple(packet for packet in data[1:] if packet in self._packets), True
        elif opcode == _PAUSE:
            self._streams = data[0] == 1

    def _enter(self, mode: Mode, now_ns: int) -> None:
        """Change the mode. Whoever gets or loses control over the wheels finds them stopped."""
        controlled = (Mode.SAFE, Mode.FULL)
        if mode not in controlled or self.mode not in controlled:
            self._drive(0, 0)
        if mode is Mode.OFF:
            self._streams = False
        self.mode, self._idle_ns = mode, now_ns

    def _drive(self, left: int, right: int) -> None:
        left, right = (max(-_FASTEST_MM_S, min(_FASTEST_MM_S, speed)) for speed in (left, right))
        self._requested = left, right
        per_mm_s = 1e-3 / self._hardware.drive.wheel_radius
        self._hardware.command = WheelSpeeds(left * per_mm_s, right * per_mm_s) if left or right else STOP

    def _in_danger(self) -> bool:
        feels = self._hardware.feels
        forward = max(self._requested) > 0
        return bool(feels & (RobotFault.WHEEL_DROPPED | RobotFault.CHARGING)) or (forward and RobotFault.CLIFF in feels)

    def _asleep(self, now_ns: int) -> bool:
        """Return whether it saves power: then it hears nothing until somebody presses its Clean button."""
        idle = self.mode in (Mode.OFF, Mode.PASSIVE) and self._idle_ns is not None
        return idle and now_ns - (self._idle_ns or 0) > _SLEEP_NS

    def _sensors(self) -> dict[int, Callable[[], bytes]]:
        hardware = self._hardware

        def byte(value: Callable[[], int]) -> Callable[[], bytes]:
            return lambda: bytes((value(),))

        def word(value: Callable[[], int]) -> Callable[[], bytes]:
            return lambda: struct.pack(">H", value() % 65536)

        def felt(fault: RobotFault, bits: int) -> Callable[[], bytes]:
            return byte(lambda: bits if fault in hardware.feels else 0)

        return {
            7: byte(
                lambda: (
                    (3 if RobotFault.BUMPED in hardware.feels else 0)
                    | (12 if RobotFault.WHEEL_DROPPED in hardware.feels else 0)
                )
            ),
            **{packet: felt(RobotFault.CLIFF, 1) for packet in (9, 10, 11, 12)},
            14: felt(RobotFault.OVERCURRENT, 0b11000),
            21: felt(RobotFault.CHARGING, 2),
            22: word(lambda: 12000 + round(4000 * hardware.charge)),
            25: word(lambda: round(_CAPACITY_MAH * hardware.charge)),
            26: word(lambda: _CAPACITY_MAH),
            34: felt(RobotFault.CHARGING, 2),
            35: byte(lambda: self.mode),
            41: word(lambda: self._requested[1]),
            42: word(lambda: self._requested[0]),
            43: word(lambda: hardware.counts[0]),
            44: word(lambda: hardware.counts[1]),
        }
