"""The firmware of an Arduino Uno itself: the binary that is flashed, on an emulated board.

The plant's wheel-speed loops are the motors here: their setpoint is the voltage, as the speed that it gives a motor
without load. The binary's own loop closes around them.
"""

import struct
from typing import NamedTuple

from robofleet.core.clock import S
from robofleet.drivers.rfp_frames import PER_RAD_S
from robofleet.simulation.avr.board import CLOCK_HZ, FULL_VOLTAGE, Board, NoAvrError, Reset, address, image
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.rfp import built_in
from robofleet.vehicles.interface import WheelSpeeds

_BAUD = 250000
_BOOT_NS = 1_000_000_000  # the boot loader waits for a new program for so long
_GATE = struct.Struct("<IHBIIIIIhhIIhhhiiIIIii")  # struct gate of drivers/firmware/gate.h; an AVR aligns nothing
_NO_LOAD = 1.4  # assumed: a motor's speed without load at full voltage, relative to the robot's top speed


class Gate(NamedTuple):
    """What matters of a gate to whoever tests it."""

    latch: int
    target: WheelSpeeds  # that it lets through [rad/s]
    target_after_ms: int  # of the last stop, from the issue of the newest nonce to zero target; -1: none
    output_after_ms: int  # and to zero output


class ArduinoUnoFirmware:
    """An Uno, just switched on; its EEPROM is empty."""

    baud = 1_000_000_000  # of the line: the emulated UART takes the time
    watchdog_s = 0.12

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        values = (f"-DRFP_{name}={float(value):.9g}" for name, value in built_in(hardware).items())
        binary = image("uno", f"-DRFP_BAUD={_BAUD}L", *values)
        self.board = Board("uno", binary, _BAUD)
        self._gate = address(binary, "robot")
        self._counts = hardware.counts
        self._start_ns: int | None = None  # when its cycles began; None: with its first call
        self._ready_ns = 0

    @staticmethod
    def refusal() -> str | None:
        """Return which tools are missing here."""
        try:
            Board("uno", image("uno"), _BAUD)
        except NoAvrError as error:
            return str(error)
        return None

    @property
    def gate(self) -> Gate:
        """Its gate, as it stands in the binary's memory."""
        values = _GATE.unpack_from(self.board.memory, self._gate)
        left, right, target_after_ms, output_after_ms = values[13], values[14], values[20], values[21]
        return Gate(values[2], WheelSpeeds(left / PER_RAD_S, right / PER_RAD_S), target_after_ms, output_after_ms)

    @property
    def target(self) -> WheelSpeeds:
        """What its gate lets through [rad/s]."""
        return self.gate.target

    def opened(self, now_ns: int) -> None:
        """Reset, as a host does that opens the port."""
        self._pass(now_ns)
        self.board.reset(Reset.EXTERNAL)
        self._ready_ns = now_ns + _BOOT_NS

    def receive(self, data: bytes, now_ns: int) -> bytes:
        self._pass(now_ns)
        if now_ns >= self._ready_ns:  # before, the boot loader takes them
            self.board.receive(data)
        return self.board.transmitted()

    def loop(self, now_ns: int) -> bytes:
        self._pass(now_ns)
        return self.board.transmitted()

    def _pass(self, now_ns: int) -> None:
        """Let the microcontroller run until now, while its encoders count what the wheels have turned since."""
        if self._start_ns is None:
            self._start_ns = now_ns
        cycles = (now_ns - self._start_ns) * CLOCK_HZ // S - self.board.cycle
        if now_ns < self._ready_ns:  # its boot loader is not emulated: its cycles stand still
            self._start_ns += cycles * S // CLOCK_HZ
            cycles = 0
        counts = self._hardware.counts
        turned = counts[0] - self._counts[0], counts[1] - self._counts[1]
        self._counts = counts
        self.board.run(max(0, cycles), *turned)
        per_unit = _NO_LOAD * self._hardware.drive.max_wheel_speed / FULL_VOLTAGE
        left, right = self.board.voltages
        self._hardware.command = WheelSpeeds(left * per_unit, right * per_unit)
