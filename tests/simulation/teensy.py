"""A model of a GTernal's Teensy for the image that is flashed: unicorn's core, and of the chip what the image uses.

The model knows of the chip what the firmware knows: the manual. So it finds a firmware that does not start, hangs or
mixes up pins, not a mistake that both share. Interrupts come where the program waits for them.
"""

import struct
from contextlib import suppress
from typing import Any

import pytest

from tests.simulation.pico import flashed
from tests.simulation.rfp_host import RfpHost

BAUD = 500000
COUNTS_PER_TURN = 2800.0
POWER_ON, WATCHDOG = 1, 1 << 7  # resets, in the chip's register
BATTERY = 2048  # of 4095, behind the divider
WAIT = b"\x20\xbf"  # an instruction: wait for an event, once in each loop of the program
ENTRY = 0x1004  # in the image: the address of the first instruction
_FLASH, _FLASH_BYTES, _RAM, _RAM_BYTES = 0x60000000, 2**21, 0x20200000, 2**19
_PERIPHERALS, _PERIPHERAL_BYTES, _CORE = 0x40000000, 0x500000, 0xE000E000
_RETURN = _FLASH + _FLASH_BYTES - 16  # where a called function comes back to
_UART, _TIMER, _WATCHDOG, _FLEXSPI, _ADC = 0x40188000, 0x401EC000, 0x400BC000, 0x402A8000, 0x400C4000
_UART_IRQ, _TIMER_IRQ = 21, 100
_ENCODERS = ((0x401B8000, 27, 26, 81), (0x401C4000, 4, 5, 86))  # port, A, B, interrupt
_FORWARD = ((1, 1), (0, 1), (0, 0), (1, 0))  # A and B, from count to count
_BITE_US = 120_000
_STUCK = 3_000_000  # instructions without waiting


class Board:
    """One Teensy, just switched on."""

    def __init__(self, program: bytes) -> None:
        self.program = program
        self.flash = bytearray(self.program.ljust(_FLASH_BYTES, b"\xff"))
        self.levels: dict[int, int] = {}
        self.resets = 0
        self.now_us = 0
        self._counts = [0, 0]
        self._start(POWER_ON)

    def _start(self, cause: int) -> None:
        import unicorn as u

        self.core: Any = u.Uc(u.UC_ARCH_ARM, u.UC_MODE_THUMB | u.UC_MODE_MCLASS)
        self.core.ctl_set_cpu_model(u.arm_const.UC_CPU_ARM_CORTEX_M7)
        self.core.mem_map(_FLASH, _FLASH_BYTES)
        self.core.mem_write(_FLASH, bytes(self.flash))
        self.core.mem_map(_RAM, _RAM_BYTES)
        self.core.mem_write(_RAM, b"\xa5" * _RAM_BYTES)
        for base, size in ((_PERIPHERALS, _PERIPHERAL_BYTES), (_CORE, 0x1000)):
            self.core.mmio_map(base, size, self._read, base, self._write, base)
        self._registers = {0x400F8008: cause}
        self._received, self._sent, self._enabled, self._pending = bytearray(), bytearray(), set[int](), set[int]()
        self._started_us = self._fed_us = self.now_us
        self.levels = {}
        for side in (0, 1):
            self._count(side, 0)
        self._at = struct.unpack_from("<I", self.program, ENTRY)[0]
        self._context: Any = None  # of the core, where the program waits
        self._writable, self._left, self._at_flash = False, 0, 0

    def _read(self, _core: Any, offset: int, _size: int, base: int) -> int:
        address = base + offset
        if address == _TIMER + 0x24:
            return self.now_us - self._started_us & 0xFFFFFFFF
        if address == _UART + 0x2C:
            return min(len(self._received), 4) << 24
        if address == _UART + 0x1C:
            return self._received.pop(0)
        if address == _FLEXSPI + 0x14:
            return 1 << 6 | 1
        if address == _ADC + 0x24:
            return BATTERY
        ready = {_WATCHDOG: 1 << 11 | 1 << 10, _ADC + 0x20: 1}
        return self._registers.get(address, 0) | ready.get(address, 0) | self.levels.get(address, 0)

    def _write(self, _core: Any, offset: int, _size: int, value: int, base: int) -> None:
        address = base + offset
        self._registers[address] = value
        port, register = address & ~0xFFF, address & 0xFFF
        if port in (0x401B8000, 0x401BC000, 0x401C4000) and register in (0x84, 0x88):
            before = self._registers.get(port, 0)
            self._registers[port] = before | value if register == 0x84 else before & ~value
        elif address == _UART + 0x1C:
            self._sent.append(value & 0xFF)
        elif address == _WATCHDOG + 4 and value == 0xB480A602:
            self._fed_us = self.now_us
        elif address == _FLEXSPI + 0xB0:
            self._run_sequence()
        elif address in (_FLEXSPI + 0x180, _FLEXSPI + 0x184):
            self._program(struct.pack("<I", value))
        elif base == _CORE and register & ~0x1F in (0x100, 0x200):
            lines = {8 * (register & 0x1F) + bit for bit in range(32) if value >> bit & 1}
            (self._enabled if register < 0x200 else self._pending).update(lines)

    def _run_sequence(self) -> None:
        self._at_flash = self._registers[_FLEXSPI + 0xA0]
        number, self._left = divmod(self._registers[_FLEXSPI + 0xA4], 1 << 16)
        command = self._registers[_FLEXSPI + 0x200 + 16 * number]
        assert command >> 8 & 0xFF == 4, "a command, on one wire"
        match command & 0xFF:
            case 0x03:
                self._registers[_FLEXSPI + 0x100] = struct.unpack_from("<I", self.flash, self._at_flash)[0]
            case 0x05:
                self._registers[_FLEXSPI + 0x100] = 0
            case 0x06:
                self._writable = True
            case 0x20 if self._writable:
                self.flash[self._at_flash : self._at_flash + 4096] = b"\xff" * 4096
                self._writable = False
            case 0x02:
                assert self._writable

    def _program(self, data: bytes) -> None:
        data = data[: self._left]
        self._left -= len(data)
        for byte in data:
            self.flash[self._at_flash] &= byte
            self._at_flash += 1
        self._writable = self._left > 0

    @property
    def voltages(self) -> tuple[float, float]:
        """What the bridge puts on the motors, left and right, of the full one. NaN: the outputs are not set up."""
        registers = self._registers
        enabled = self._level(0x401BC000, 10) and self._level(0x401C4000, 8)
        left = self._level(0x401BC000, 16) - self._level(0x401BC000, 17)
        right = self._level(0x401B8000, 3) - self._level(0x401B8000, 2)
        sizes = []
        for pwm, module, pad in ((0x403E8000, 1, 0x120), (0x403E0000, 0, 0x02C)):
            top = registers.get(pwm + 0x60 * module + 0x0E, 0) + 1
            ready = registers.get(pwm + 0x180, 0) >> 8 + module & registers.get(pwm + 0x188, 0) >> 8 + module & 1
            ready &= registers.get(0x401F8000 + pad) == 1
            sizes.append(registers.get(pwm + 0x60 * module + 0x16, 0) / top if ready else float("nan"))
        return (left * sizes[0], right * sizes[1]) if enabled else (0.0, 0.0)

    def _level(self, port: int, bit: int) -> int:
        """Return the level of an output; one that is none is low."""
        return self._registers.get(port, 0) >> bit & self._registers.get(port + 4, 0) >> bit & 1

    def run(self, ms: int, left_counts: int = 0, right_counts: int = 0) -> None:
        """Let it run; its encoders count meanwhile, at even distances. Forward is +."""
        begin_us, end_us = self.now_us, self.now_us + 1000 * ms
        edges = sorted(
            (begin_us + int(1000 * ms * (k + 0.5) / abs(counts)), side, 1 if counts > 0 else -1)
            for side, counts in enumerate((left_counts, right_counts))
            for k in range(abs(counts))
        )
        while self.now_us < end_us:
            while edges and edges[0][0] <= self.now_us:
                _, side, step = edges.pop(0)
                self._count(side, step)
                self._pending.add(_ENCODERS[side][3])
            if self.now_us >= self._timer_us:
                self._pending.add(_TIMER_IRQ)
            if self._received:
                self._pending.add(_UART_IRQ)
            if not self._work():  # it hangs
                self.now_us = self._fed_us + _BITE_US
            if self.now_us - self._fed_us >= _BITE_US:
                self.resets += 1
                self._start(WATCHDOG)
                continue
            instants = end_us, self._timer_us, *(edge[0] for edge in edges[:1])
            self.now_us = min(instant for instant in instants if instant > self.now_us)

    @property
    def _timer_us(self) -> int:
        return self._started_us + self._registers.get(_TIMER + 0x10, 0)

    def _work(self) -> bool:
        """Serve what is due, and go on until the program waits; returns whether it does."""
        from unicorn import UcError
        from unicorn import arm_const as arm

        if self._context is not None:
            vectors = self._registers.get(_CORE + 0xD08, 0)
            for line in sorted(self._pending & self._enabled):
                self._pending.discard(line)
                self.core.reg_write(arm.UC_ARM_REG_LR, _RETURN | 1)
                handler = struct.unpack("<I", self.core.mem_read(vectors + 4 * (16 + line), 4))[0]
                self.core.emu_start(handler | 1, _RETURN, count=_STUCK)
                self.core.context_restore(self._context)
        with suppress(UcError):  # it does not know the instruction that waits
            self.core.emu_start(self._at | 1, _RETURN, count=_STUCK)
        self._at = self.core.reg_read(arm.UC_ARM_REG_PC)
        self._context = self.core.context_save()
        return bytes(self.core.mem_read(self._at - 2, 2)) == WAIT

    def receive(self, data: bytes) -> None:
        """Put bytes on the line to it; they are there at once."""
        self._received += data

    def transmitted(self) -> bytes:
        """Return what its UART has sent since the last call."""
        sent = bytes(self._sent)
        self._sent.clear()
        return sent

    def reset(self, cause: int) -> None:
        """Reset it; its memory is lost, its flash is not."""
        self._start(cause)

    def _count(self, side: int, step: int) -> None:
        self._counts[side] += step
        port, a, b, _ = _ENCODERS[side]
        a_level, b_level = _FORWARD[self._counts[side] % 4]
        self.levels[port + 8] = a_level << a | b_level << b


class Teensy(RfpHost):
    """One board."""

    board: Board

    def __init__(self) -> None:
        super().__init__(COUNTS_PER_TURN)
        pytest.importorskip("unicorn", reason="NO TEENSY: no emulator here: pip install unicorn")
        self.board = Board(program())
        self.pass_ms(120)

    def run_board(self, ms: int, left_counts: int, right_counts: int) -> None:
        self.board.run(ms - self.board.now_us // 1000, left_counts, right_counts)


def program() -> bytes:
    """Return what the loader writes to a Teensy's flash, from the first byte on."""
    image, upper = b"", 0
    for line in flashed("teensy.hex", BAUD, COUNTS_PER_TURN).decode().splitlines():  # Intel's format
        size, address, kind = struct.unpack_from(">BHB", record := bytes.fromhex(line[1:]))
        assert sum(record) % 256 == 0
        match kind:
            case 0:
                assert upper + address == _FLASH + len(image)  # no gap
                image += record[4 : 4 + size]
            case 4:
                upper = int.from_bytes(record[4:6]) << 16
    return image
