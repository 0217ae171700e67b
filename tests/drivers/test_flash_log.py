"""The memory of a board that has flash only, under failing power: the C sources, compiled for this computer."""

from collections.abc import Iterator
from random import Random

import pytest

from robofleet.simulation.firmware_library import firmware_library

HALF, BYTES, ERASED = 4096, 34, 0xFFFFFFFF


class PowerCutError(Exception):
    pass


class Flash:
    """Words whose bits become 0 when they are written; power fails in the middle of the operation after ``left``."""

    def __init__(self) -> None:
        self.ffi, self.c = firmware_library({})
        self.words, self.left, self.random = [ERASED] * 2 * HALF, 10**9, Random(1)
        self._calls = (
            self.ffi.callback("uint32_t(uint32_t)", lambda word: self.words[word]),
            self.ffi.callback("void(uint32_t, uint32_t)", self._write),
            self.ffi.callback("void(uint32_t)", self._erase),
        )
        self._flash = self.ffi.new("struct flash *", self._calls)
        self.log = self.ffi.new("struct flash_log *")

    def _write(self, word: int, value: int) -> None:
        self.left -= 1
        if self.left < 0:
            value |= self.random.getrandbits(32) if self.left == -1 else ERASED
        self.words[word] &= value

    def _erase(self, word: int) -> None:
        self.left -= 1
        count = HALF if self.left >= 0 else self.random.randrange(HALF) if self.left == -1 else 0
        self.words[word : word + count] = [ERASED] * count

    def start(self) -> list[int]:
        self.c.flash_log_start(self.log, self._flash)
        return self.read()

    def read(self) -> list[int]:
        return [self.c.flash_log_read(self.log, k) for k in range(BYTES)]


@pytest.fixture
def flash() -> Iterator[Flash]:
    yield Flash()


def test_a_new_memory_is_erased(flash: Flash) -> None:
    assert flash.start() == flash.start() == [0xFF] * BYTES


def test_what_was_written_outlasts_starts_and_a_loss_of_power_at_any_moment(flash: Flash) -> None:
    """What is being written at that moment may be lost; all else is there."""
    random, kept = Random(2), [0xFF] * BYTES
    flash.start()
    for _ in range(300):
        flash.left = random.randrange(60)
        writing: tuple[int, int] | None = None
        for _ in range(random.randrange(20)):
            address, value = random.randrange(BYTES), random.randrange(256)
            flash.c.flash_log_write(flash.log, address, value)
            if flash.left < 0:
                writing = writing or (address, value)
            else:
                kept[address] = value
        if flash.left >= 0:
            flash.start()  # and here it may fail, too
        flash.left = 10**9
        found = flash.start()
        if writing is not None and found[writing[0]] == writing[1]:
            kept[writing[0]] = writing[1]
        assert found == kept


def test_a_log_that_is_full_or_worn_does_not_show_what_was_not_kept(flash: Flash) -> None:
    flash.start()
    for value in range(HALF):
        flash.c.flash_log_write(flash.log, 3, value % 251)
    full = flash.read()
    assert full[3] == (HALF - 1 - BYTES - 1) % 251
    assert flash.start() == full
    flash.words[flash.log.next] = 0  # worn
    flash.c.flash_log_write(flash.log, 3, 255)
    assert flash.read() == full
