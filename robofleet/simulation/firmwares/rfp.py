"""This project's own firmware (``drivers/firmware``), compiled for this computer: the same gate, protocol and loop.

The plant's wheel-speed loops stand for the firmware's own, and aim at its gate's output; the binaries' loops turn
emulated motors in ``arduino_uno.py``.
"""

import math

from robofleet.drivers.rfp_frames import PER_RAD_S
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmware_library import NoCompilerError, firmware_library
from robofleet.vehicles.interface import STOP, RobotFault, WheelSpeeds

_BOOT_NS = 1_000_000_000  # a boot loader waits for a new program for so long
_WATCHDOG_US = 120_000
_POWER_ON, _EXTERNAL, _WATCHDOG = 1, 2, 8  # resets
_EMPTY_MV, _FULL_MV = 6000, 8400
_OUTPUT = 2.0**-16  # [rad/s]


class RfpFirmware:
    """A board whose port resets it when it is opened, as an Arduino's does."""

    baud = 57600
    watchdog_s = 0.125  # since the newest nonce; the loop looks every 5 ms
    reports = RobotFault.BUMPED | RobotFault.CLIFF | RobotFault.WHEEL_DROPPED

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._ffi, self._c = firmware_library({**built_in(hardware), "BUILD": '"twin"'})
        self.board, self.robot = self._ffi.new("struct host *"), self._ffi.new("struct robot *")
        self._ffi.memmove(self.board.eeprom, b"\xff" * len(self.board.eeprom), len(self.board.eeprom))
        self.board.writes_left = 2**31 - 1
        self._ready_ns = 0
        self._ran = False
        self.start(0, _POWER_ON)

    @staticmethod
    def refusal() -> str | None:
        """Return what is missing here."""
        try:
            firmware_library({})
        except NoCompilerError as error:
            return str(error)
        return None

    @property
    def target(self) -> WheelSpeeds:
        """What its gate lets through [rad/s]."""
        gate = self.robot.gate
        return WheelSpeeds(gate.target_left / PER_RAD_S, gate.target_right / PER_RAD_S)

    def opened(self, now_ns: int) -> None:
        """Reset, as a host does that opens the port."""
        self._ready_ns = now_ns + _BOOT_NS
        self.start(self._ready_ns, _EXTERNAL)

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes, which a boot loader would lose, and answer."""
        if now_ns < self._ready_ns:
            return b""
        self._ffi.memmove(self.board.to_robot, data, len(data))
        self.board.received, self.board.arrived = 0, len(data)
        return self.loop(now_ns)

    def loop(self, now_ns: int) -> bytes:
        """Let the board's loop run until it has taken and sent what there is."""
        if now_ns < self._ready_ns:
            return b""
        now_us = _us(now_ns)
        if (now_us - self.board.now_us) % 2**32 > _WATCHDOG_US:
            self.start(now_ns, _WATCHDOG if self._ran else _POWER_ON)
        self._ran = True
        self._look(now_us)
        for _ in range(2):  # while it runs its speed loops it does not listen
            self._c.robot_loop(self.robot)
        before = -1
        while self.board.received < self.board.arrived or self.board.sent != before:
            before = self.board.sent
            self._c.robot_loop(self.robot)
        gate = self.robot.gate
        self._hardware.command = WheelSpeeds(gate.output_left * _OUTPUT, gate.output_right * _OUTPUT)
        sent, self.board.sent = bytes(self._ffi.buffer(self.board.to_host, self.board.sent)), 0
        return sent

    def _look(self, now_us: int) -> None:
        board = self.board
        self._c.host_select(board)
        board.now_us = now_us
        board.counts[0], board.counts[1] = self._hardware.counts
        board.faults = int(self._hardware.feels)
        board.battery_mv = round(_EMPTY_MV + (_FULL_MV - _EMPTY_MV) * self._hardware.charge)

    def start(self, now_ns: int, reset: int) -> None:
        """Switch on, or reset, for a reason; its memory keeps what it holds."""
        self._look(_us(now_ns))
        self.board.reset, self.board.received, self.board.arrived, self.board.sent = reset, 0, 0, 0
        self._c.robot_start(self.robot)
        self._hardware.command = STOP


def built_in(hardware: Hardware) -> dict[str, float]:
    """Return what is built into the firmware of a robot, as drivers/firmware/config.h names it."""
    drive = hardware.drive
    return {
        "COUNTS_PER_TURN": math.tau / hardware.radians_per_count,
        "WHEEL_RADIUS_M": drive.wheel_radius,
        "MAX_WHEEL_RAD_S": drive.max_wheel_speed,
        "MAX_SPEED_M_S": drive.max_speed,
        "MAX_ACCELERATION_RAD_S2": drive.max_wheel_acceleration,
    }


def _us(now_ns: int) -> int:
    return now_ns // 1000 % 2**32
