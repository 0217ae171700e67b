"""The memory of a board that has flash only, a log, compiled for this computer: what a loss of power leaves of it."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from robofleet.simulation.compiled_c import compiled
from robofleet.simulation.firmware_library import FLAGS, SOURCES

UNITS = (
    *(SOURCES / name for name in ("flash_log.c", "memory.c", "rfp.c")),
    Path(__file__).with_name("flash_host.c"),
)
SECTOR_WORDS, FOR_EVER = 1024, 2**31 - 1


class KeptState(ctypes.Structure):
    """``struct kept`` of memory.h."""

    _fields_ = (("latch", ctypes.c_uint8), ("latch_id", ctypes.c_uint32), ("boot_id", ctypes.c_uint32))


class MemoryState(ctypes.Structure):
    """``struct memory`` of memory.h."""

    _fields_ = (
        ("newest", KeptState), ("wanted", KeptState), ("sequence", ctypes.c_uint32), ("slot", ctypes.c_uint8),
        ("bytes", ctypes.c_uint8 * 17), ("at", ctypes.c_uint8), ("pending", ctypes.c_bool), ("broken", ctypes.c_bool),
    )  # fmt: skip


class Chip:
    """A board that is switched on and off."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._c = library
        library.memory_start.restype = KeptState
        self._words_left = ctypes.c_int32.in_dll(library, "words_left")
        self._torn = ctypes.c_uint32.in_dll(library, "torn")
        self.flash = (ctypes.c_uint32 * (2 * SECTOR_WORDS)).in_dll(library, "flash")
        self.worn = (ctypes.c_uint32 * (2 * SECTOR_WORDS)).in_dll(library, "worn")
        self.erased = (ctypes.c_uint32 * 2).in_dll(library, "erased")
        self.flash[:] = [0xFFFFFFFF] * len(self.flash)
        self.worn[:] = [0] * len(self.worn)
        self.erased[:] = [0, 0]
        self.memory = MemoryState()

    def start(self) -> KeptState:
        self._words_left.value = FOR_EVER
        self._c.flash_log_start()
        return self._c.memory_start(ctypes.byref(self.memory))  # type: ignore[no-any-return]

    def fill(self, free: int) -> None:
        """Fill the sectors with torn words, but for so many."""
        for sector in (0, SECTOR_WORDS):
            if self.flash[sector] != 0xFFFFFFFF:
                for word in range(sector, sector + SECTOR_WORDS - free):
                    if self.flash[word] == 0xFFFFFFFF:
                        self.flash[word] = 0

    def keep(self, latch: int, latch_id: int, words: int = FOR_EVER, torn: int = 0) -> bool:
        """Write a latch; returns whether it was written before the power failed, after so many words."""
        self._words_left.value, self._torn.value = words, torn
        self._c.memory_keep(ctypes.byref(self.memory), latch, latch_id)
        for _ in range(150):
            self._c.memory_step(ctypes.byref(self.memory))
        return self._words_left.value > 0


@pytest.fixture(scope="module")
def library() -> ctypes.CDLL:
    if shutil.which("cc") is None:
        pytest.skip("NO C COMPILER: apt install gcc")

    def make(folder: Path) -> None:
        target = ["-o", str(folder / "flash_log.so")]
        subprocess.run(["cc", *FLAGS, "-fPIC", "-shared", f"-I{SOURCES}", *map(str, UNITS), *target], check=True)

    content = [file.read_bytes() for file in (*UNITS, *sorted(SOURCES.rglob("*.h")))]
    return ctypes.CDLL(str(compiled("flash_log", content, make) / "flash_log.so"))


@pytest.mark.slow_after_first
@pytest.mark.parametrize("torn", [0xFF00, 0, 0xFFFFFFFF])
def test_wherever_power_fails_the_latch_is_the_old_or_the_new_one(library: ctypes.CDLL, torn: int) -> None:
    for free in range(0, 40, 6):  # words that are left of the sector
        for words in range(1, 60):
            chip = Chip(library)
            chip.start()
            assert chip.keep(4, 1)
            if words % 2:
                chip.fill(0)
                chip.start()
            chip.fill(free)
            before = chip.start()
            assert before.latch == 4
            written = chip.keep(2, 2, words, torn)
            after = chip.start()
            assert after.latch in ((2,) if written else (2, 4))
            assert after.boot_id > before.boot_id
            chip.fill(0)
            assert chip.start().latch == after.latch
            assert not chip.memory.broken


def test_a_full_sector_is_left_for_the_other_one(library: ctypes.CDLL) -> None:
    chip = Chip(library)
    chip.start()
    for number in range(1, 1001):
        assert chip.keep(2 if number % 2 else 0, number)
    assert not chip.memory.broken
    assert 3 <= sum(chip.erased) <= 12
    kept = chip.start()
    assert (kept.latch, kept.latch_id, kept.boot_id) == (0, 1000, 2)


def test_a_worn_flash_is_noticed(library: ctypes.CDLL) -> None:
    chip = Chip(library)
    chip.start()
    chip.worn[:] = [1 << 9] * len(chip.worn)
    chip.keep(4, 1)
    assert chip.memory.broken


def test_a_sector_that_takes_no_number_is_not_used(library: ctypes.CDLL) -> None:
    chip = Chip(library)
    chip.start()
    chip.keep(4, 1)
    chip.worn[0] = 1 << 16  # of the sector that is not valid
    chip.fill(12)
    chip.start()
    for number in (2, 3, 4):
        chip.keep(3, number)
    assert chip.memory.broken
    assert chip.start().latch >= 3
