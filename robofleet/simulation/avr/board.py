"""An emulated Arduino: simavr's microcontroller, two bridges and two encoders on its pins. It runs the flashed binary.

Shim and binary are compiled at their first use, by this computer's compilers.
"""

import ctypes
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from enum import IntFlag
from functools import cache
from pathlib import Path

from robofleet.core.errors import RobofleetError
from robofleet.simulation import firmware_library
from robofleet.simulation.compiled_c import compiled

CLOCK_HZ = 16_000_000
FULL_VOLTAGE = 255  # that a bridge can put on a motor
_SHIM = Path(__file__).with_name("board.c")
_MCUS = {"uno": b"atmega328p", "mega": b"atmega2560"}
_MOST_BYTES_AT_ONCE = 4096
_DONE, _CRASHED = 6, 7  # simavr: the program ended, or did what no program may do


class NoAvrError(RobofleetError):
    """Raised where the tools that build and emulate an Arduino's firmware are missing."""


class AvrError(RobofleetError):
    """Raised where an Arduino's firmware cannot be built or run."""


class Reset(IntFlag):
    """Why a microcontroller was reset: bits of its MCUSR."""

    POWER_ON = 1
    EXTERNAL = 2
    BROWN_OUT = 4
    WATCHDOG = 8


class Board:
    """One board, just switched on. It counts cycles of its microcontroller; it knows no other time."""

    def __init__(self, name: str, image: Path, baud: int) -> None:
        """Flash ``image`` (ELF) and switch it on. ``name``: ``uno`` or ``mega``."""
        self._c = _library()
        self._board: int | None = self._c.board_new(os.fsencode(image), _MCUS[name], baud)
        if not self._board:
            raise AvrError(f"{image}: simavr cannot run it on the board {name!r}")
        self._bytes = (ctypes.c_uint8 * _MOST_BYTES_AT_ONCE)()
        self.eeprom = self._view("eeprom", 1024)
        self.worn = self._view("worn", 1024)  # not 0: this cell of the EEPROM takes no write any more
        self.memory = self._view("memory", 0x900)  # registers and RAM
        self.flash = self._view("flash", 0x8000)

    def _view(self, what: str, size: int) -> memoryview:
        """Return bytes of the board itself, which whoever tests it may change."""
        start = getattr(self._c, f"board_{what}")(self._board)
        return memoryview((ctypes.c_uint8 * size).from_address(start)).cast("B")

    def __del__(self) -> None:
        if getattr(self, "_board", None):
            self._c.board_free(self._board)

    @property
    def cycle(self) -> int:
        """Cycles since it was switched on."""
        return int(self._c.board_cycle(self._board))

    @property
    def resets(self) -> int:
        """How often it was reset since."""
        return int(self._c.board_resets(self._board))

    @property
    def overruns(self) -> int:
        """Received bytes that it lost because it did not fetch them in time."""
        return int(self._c.board_overruns(self._board))

    @property
    def voltages(self) -> tuple[int, int]:
        """What the bridges put on the motors, left and right, mean over a period of the PWM: +-``FULL_VOLTAGE``."""
        return self._c.board_voltage(self._board, 0), self._c.board_voltage(self._board, 1)

    @property
    def brakes(self) -> tuple[bool, bool]:
        """Whether the bridges, L298 or TB6612, brake the motors, left and right, while they do not drive them."""
        return bool(self._c.board_brakes(self._board, 0)), bool(self._c.board_brakes(self._board, 1))

    def run(self, cycles: int, left_counts: int = 0, right_counts: int = 0) -> None:
        """Let it run; its encoders count meanwhile, at even distances. Forward is +."""
        if self._c.board_run(self._board, cycles, left_counts, right_counts) in (_DONE, _CRASHED):
            raise AvrError("the firmware has crashed: it sleeps without interrupts, or left its program")

    def receive(self, data: bytes) -> None:
        """Put bytes on the line to it; they arrive as its baud rate lets them."""
        self._c.board_receive(self._board, data, len(data))

    def transmitted(self) -> bytes:
        """Return what its UART has sent since the last call."""
        count = self._c.board_transmitted(self._board, self._bytes, _MOST_BYTES_AT_ONCE)
        return bytes(self._bytes[:count])

    def reset(self, causes: Reset, seed: int = 0) -> None:
        """Reset it. Power that went away takes its memory with it: ``seed`` says what stands there then."""
        self._c.board_reset(self._board, int(causes), seed)


@cache
def image(name: str, *flags: str) -> Path:
    """Return the ELF image of a board's firmware, as ``make NAME RFP=FLAGS`` in drivers/firmware builds it.

    Raises:
        NoAvrError: A tool is missing.
        AvrError: It cannot be built.
    """
    if missing := [tool for tool in ("make", "avr-gcc") if shutil.which(tool) is None]:
        raise NoAvrError(f"NO AVR: no {' and no '.join(missing)} here: install Debian's gcc-avr, avr-libc and make")
    make = ["make", "-sC", str(firmware_library.SOURCES), name, f"RFP={' '.join(flags)}"]
    return _built(f"{name}.elf", firmware_library.image_files(), flags, lambda folder: [*make, f"BUILD={folder}"])


@cache
def address(image: Path, variable: str) -> int:
    """Return where a variable of an image stands in ``Board.memory``."""
    symbols = subprocess.run(["avr-nm", str(image)], capture_output=True, text=True, check=True).stdout
    found = re.search(rf"^00(80\w{{4}}) \w {variable}(?:\.\S+)?$", symbols, re.MULTILINE)
    if found is None:
        raise AvrError(f"{image}: it has no variable {variable!r}")
    return int(found[1], 16) - 0x800000


@cache
def _library() -> ctypes.CDLL:
    if shutil.which("cc") is None:
        raise NoAvrError("NO AVR: no cc here: install Debian's gcc")
    command = ["cc", "-O2", "-shared", "-fPIC", str(_SHIM), "-lsimavr", "-o"]
    try:
        shim = _built("board.so", [_SHIM], (), lambda folder: [*command, str(folder / "board.so")])
    except AvrError as error:
        raise NoAvrError(f"NO AVR: {error}: install Debian's libsimavr-dev") from error
    c = ctypes.CDLL(str(shim))
    for name in ("new", "eeprom", "worn", "memory", "flash"):
        getattr(c, f"board_{name}").restype = ctypes.c_void_p
    c.board_cycle.restype = ctypes.c_uint64
    c.board_transmitted.restype = c.board_resets.restype = c.board_overruns.restype = ctypes.c_uint32
    board = ctypes.c_void_p
    c.board_new.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32]
    for name in ("free", "cycle", "resets", "overruns", "eeprom", "worn", "memory", "flash"):
        getattr(c, f"board_{name}").argtypes = [board]
    c.board_run.argtypes = [board, ctypes.c_uint64, ctypes.c_int32, ctypes.c_int32]
    c.board_receive.argtypes = [board, ctypes.c_char_p, ctypes.c_uint32]
    c.board_transmitted.argtypes = [board, ctypes.c_void_p, ctypes.c_uint32]
    c.board_reset.argtypes = [board, ctypes.c_uint8, ctypes.c_uint32]
    c.board_voltage.argtypes = c.board_brakes.argtypes = [board, ctypes.c_int]
    return c


def _built(name: str, sources: Sequence[Path], flags: Sequence[str], command: Callable[[Path], list[str]]) -> Path:
    """Return a file that a command makes of sources into a folder."""

    def make(folder: Path) -> None:
        done = subprocess.run(command(folder), capture_output=True, text=True, check=False)
        if done.returncode:
            why = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip())
            raise AvrError(f"{name} cannot be built: {why}")

    content = [*(part.encode() for part in flags), *(file.read_bytes() for file in sources)]
    return compiled(Path(name).stem, content, make) / name
