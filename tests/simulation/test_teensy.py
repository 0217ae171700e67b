"""The firmware of a GTernal's Teensy as it is flashed, on a model of its chip: the image starts, and its gate works."""

import struct

import pytest

from tests.simulation.rfp_host import EMERGENCY_STOP, LATCHED, NO_LEASE
from tests.simulation.teensy import ENTRY, POWER_ON, WAIT, WATCHDOG, Teensy, program

LOOP = b"\xfe\xe7"  # an instruction: jump to yourself
ON_THE_LINE = {POWER_ON: 1, WATCHDOG: 8}


def test_its_boot_rom_finds_what_it_looks_for() -> None:
    image = program()
    assert image[:4] == b"FCFB"
    header, entry, reserved, dcd, data, own = struct.unpack_from("<6I", image, ENTRY - 4)
    assert (header, reserved, dcd, own) == (0x432000D1, 0, 0, 0x60000000 + ENTRY - 4)
    assert 0x60001000 < entry < 0x60000000 + len(image)
    assert struct.unpack_from("<3I", image, data - 0x60000000) == (0x60000000, len(image), 0)


@pytest.mark.slow
def test_it_says_who_it_is_and_how_full_its_battery_is() -> None:
    teensy = Teensy()
    assert teensy.identity().board.rstrip(b"\0") == b"teensy"
    assert teensy.health.reset == ON_THE_LINE[POWER_ON]
    assert teensy.health.battery_mv == pytest.approx(2200, abs=2)


@pytest.mark.slow
def test_its_wheels_turn_as_commanded_and_stand_when_its_host_falls_silent() -> None:
    teensy = Teensy()
    assert teensy.board.voltages == (0, 0)
    teensy.drive(9.0, -6.0)
    left, right = teensy.board.voltages
    assert left > 0.3 > -0.3 > right
    teensy.commands = None
    teensy.pass_ms(330)
    assert teensy.board.voltages == (0, 0)
    assert 110 <= teensy.health.target_after_ms <= 130
    assert (teensy.status.left_count, teensy.status.right_count) == tuple(teensy.turned)
    assert teensy.health.struck == teensy.health.lost == teensy.health.refused == 0


@pytest.mark.slow
def test_a_program_that_hangs_is_reset_and_says_so() -> None:
    teensy = Teensy()
    teensy.drive(5.0, 5.0)
    memory = bytes(teensy.board.core.mem_read(0x20200000, 0x8000))
    teensy.board.core.mem_write(0x20200000 + memory.index(WAIT), LOOP)
    teensy.board.core.ctl_flush_tb()
    teensy.pass_ms(300)
    assert teensy.board.resets == 1
    assert teensy.board.voltages == (0, 0)
    assert (teensy.status.gate, teensy.health.reset) == (NO_LEASE, ON_THE_LINE[WATCHDOG])


@pytest.mark.slow
@pytest.mark.parametrize("after_ms", [3, 40])
def test_a_latch_outlasts_a_loss_of_power(after_ms: int) -> None:
    teensy = Teensy()
    teensy.command(0.0, 0.0, latch=EMERGENCY_STOP, limit=0)
    teensy.pass_ms(after_ms)
    teensy.board.reset(POWER_ON)
    teensy.pass_ms(120)
    assert (teensy.status.gate, teensy.status.latch) == (LATCHED, EMERGENCY_STOP)
