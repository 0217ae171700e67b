"""The firmware of an Uno as it is flashed, in simavr: its wheels obey only a fresh, whole, permitted command."""

import random
import subprocess
from pathlib import Path

import pytest

from robofleet.core.clock import MS
from robofleet.drivers.rfp_frames import Command, frame
from robofleet.runs import check_drivers
from robofleet.simulation.avr.board import Reset, image
from robofleet.vehicles.interface import WheelSpeeds
from tests.simulation.rfp_host import EMERGENCY_STOP, LATCHED, NO_LEASE, OPEN
from tests.simulation.uno import UNO_SETTINGS, Uno, uno_behind_its_driver
from tests.twins import config_of

SLEEP, LOOP = b"\x88\x95", b"\xff\xcf"  # instructions: sleep, once in each loop of the program; jump to yourself
ROBOT_MEMORY, EEPROM_MS = 5, 4  # as a latch; more than a cell of the EEPROM takes


def hang(uno: Uno) -> slice:
    """Let the program hang; returns where ``SLEEP`` stood in its flash."""
    at = bytes(uno.board.flash).index(SLEEP)
    where = slice(at, at + len(LOOP))
    uno.board.flash[where] = LOOP
    return where


def latched_by_an_emergency_stop(uno: Uno) -> None:
    uno.commands = None
    uno.command(0.0, 0.0, latch=EMERGENCY_STOP, limit=0)


def sizes(image: Path) -> tuple[int, int]:
    """Return bytes of flash and of RAM, without a stack."""
    words = subprocess.run(["avr-size", image], capture_output=True, text=True, check=True).stdout.split()
    text, data, bss = map(int, words[6:9])
    return text + data, data + bss


@pytest.mark.slow_after_first
@pytest.mark.parametrize("board", ["uno", "mega"])
def test_at_20000_counts_a_second_it_is_small_and_no_loop_takes_a_millisecond(board: str) -> None:
    uno = Uno(board=board, counts_per_turn=13962.634)  # at 9 rad/s
    flash, ram = sizes(uno.built)
    end = 0x900  # of an Uno's RAM
    free = range(end - 0x400, end - 0x80)  # where the stack may be when it is deep
    for address in free:
        uno.board.memory[address] = 0xA5
    uno.drive(9.0, 9.0)
    uno.commands = 9.0, -9.0
    uno.pass_ms(500)
    uno.commands = None
    uno.pass_ms(400)
    assert (uno.status.left_count, uno.status.right_count) == tuple(uno.turned)
    assert uno.board.overruns == uno.health.struck == uno.health.lost == uno.health.refused == 0
    assert uno.health.loop_us <= 1000
    assert flash <= 16 * 1024
    if board == "uno":
        stack = end - next(address for address in free if uno.board.memory[address] != 0xA5)
        assert ram + stack <= 1200


@pytest.mark.slow
@pytest.mark.parametrize("board", ["uno", "mega"])
def test_its_motors_turn_both_ways_and_brake_between_the_pulses_and_at_rest(board: str) -> None:
    uno = Uno(board=board)
    assert uno.board.voltages == (0, 0)
    braked = {uno.board.brakes}
    uno.drive(9.0, -4.0)
    braked.add(uno.board.brakes)
    left, right = uno.board.voltages
    assert left > 0 > right
    uno.commands = -4.0, 9.0
    uno.pass_ms(300, lambda: braked.add(uno.board.brakes))
    left, right = uno.board.voltages
    assert right > 0 > left
    uno.commands = None
    uno.pass_ms(300, lambda: braked.add(uno.board.brakes))
    assert uno.board.voltages == (0, 0)
    assert braked == {(True, True)}


def test_it_says_who_it_is() -> None:
    uno = Uno("-DRFP_BUILD='\"robot 7\"'")
    identity = uno.identity()
    assert (identity.board.rstrip(b"\0"), identity.build.rstrip(b"\0")) == (b"uno", b"robot 7")
    assert identity.reset == Reset.POWER_ON


@pytest.mark.slow_after_first
@pytest.mark.parametrize("silent_after_ms", range(0, 20, 7))
def test_a_host_that_falls_silent_stops_it_130_ms_after_its_newest_nonce(silent_after_ms: int) -> None:
    uno = Uno()
    uno.drive(9.0, 8.0)
    uno.pass_ms(silent_after_ms)
    uno.commands = None
    uno.pass_ms(330)
    assert uno.board.voltages == (0, 0)
    assert 110 <= uno.health.target_after_ms <= 130
    assert uno.health.output_after_ms <= 130 + 92  # down the ramp


def test_no_struck_frame_moves_it() -> None:
    uno, rng = Uno(), random.Random(1)
    uno.drive(3.0, 3.0)
    for _ in range(40):
        nonce = uno.status.boot_id, uno.status.nonce
        line = bytearray(frame(Command(uno.health.epoch, 7, 1 << 20, *nonce, 4608, 4608), 0))
        line[rng.randrange(len(line))] ^= 1 << rng.randrange(8)
        uno.board.receive(b"\0" + line + b"\0")
        uno.pass_ms(20)
        assert uno.status.left_output == 3 * 512
    assert uno.health.struck >= 40
    assert uno.status.gate == OPEN


@pytest.mark.parametrize("cause", ["watchdog", "brown-out"])
def test_a_reset_in_mid_drive_leaves_it_standing_and_it_says_why(cause: str) -> None:
    uno = Uno()
    uno.drive(5.0, 5.0)
    before = uno.status.boot_id
    if cause == "watchdog":
        where = hang(uno)
        uno.commands = None
        uno.pass_ms(200)  # 120 ms, and 15 ms until its reset
        uno.board.flash[where] = SLEEP
        assert uno.board.resets == 1
    else:
        uno.board.reset(Reset.BROWN_OUT, seed=3)
        uno.commands = None
    assert uno.board.voltages == (0, 0)
    uno.commands = 5.0, 5.0  # of before
    uno.pass_ms(400)
    assert uno.board.voltages == (0, 0)
    assert (uno.status.gate, uno.status.latch) == (NO_LEASE, 0)
    assert uno.status.boot_id != before
    assert uno.health.reset == (Reset.WATCHDOG if cause == "watchdog" else Reset.BROWN_OUT)
    uno.drive(2.0, 2.0)


@pytest.mark.slow
def test_a_program_that_hangs_lets_its_motors_run_no_longer_than_130_ms() -> None:
    uno = Uno()
    uno.drive(9.0, 9.0)
    hang(uno)
    uno.pass_ms(130)
    assert uno.board.voltages == (0, 0)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("after_ms", [40, 10, 25, 55, 70, 85, 200])
def test_a_latch_outlasts_a_loss_of_power_also_while_it_is_being_written(after_ms: int) -> None:
    uno = Uno()
    uno.drive(5.0, 5.0)
    latched_by_an_emergency_stop(uno)
    uno.pass_ms(after_ms)
    uno.board.reset(Reset.BROWN_OUT, seed=after_ms)
    uno.pass_ms(400)
    assert uno.status.gate == LATCHED
    assert uno.status.latch >= EMERGENCY_STOP
    assert uno.board.voltages == (0, 0)


@pytest.mark.slow
def test_a_worn_memory_latches_it() -> None:
    uno = Uno()
    uno.board.worn[:34] = bytes([1]) * 34
    uno.board.reset(Reset.POWER_ON)
    uno.pass_ms(400)
    assert (uno.status.gate, uno.status.latch, uno.health.memory_lost) == (LATCHED, ROBOT_MEMORY, 1)


def test_where_tools_are_missing_the_check_says_which(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robofleet.simulation.avr.board.shutil.which", lambda _: None)
    image.cache_clear()
    config = config_of(twin="arduino_uno", vehicle="arduino_uno")
    why = "NO AVR: no make and no avr-gcc here: install Debian's gcc-avr, avr-libc and make"
    assert ("robots.0.twin", why) in check_drivers.of_robot(config, 0)


@pytest.mark.slow
def test_behind_its_driver_its_wheels_turn_as_commanded_and_its_encoders_tell_so() -> None:
    with uno_behind_its_driver(MS) as bench:
        bench.open(**UNO_SETTINGS)
        bench.pass_time(0.5, WheelSpeeds(4.0, 5.0))
        before = bench.read()
        bench.pass_time(1.0, WheelSpeeds(4.0, 5.0))
        after = bench.read()
        assert after.left_angle - before.left_angle == pytest.approx(4.0, rel=0.01)
        assert after.right_angle - before.right_angle == pytest.approx(5.0, rel=0.01)
        assert bench.firmware.gate.target == (4.0, 5.0)
        bench.let_pass(0.5)
        assert bench.read().left_speed == 0.0
        assert bench.firmware.gate.target == (0.0, 0.0)
        assert 110 <= bench.firmware.gate.target_after_ms <= 130
