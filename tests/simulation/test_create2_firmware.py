"""A Create 2's twin, byte by byte: its modes, its stream, its own stops."""

import struct

import numpy as np
import pytest

from robofleet.core.clock import S
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.create2 import Create2Firmware, Mode
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, RobotFault, WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import CREATE2, CREATE2_IDEAL

LOOP_NS = 15_000_000


class Bench:
    """A firmware and the robot below it."""

    def __init__(self, drive: DifferentialDrive = CREATE2) -> None:
        self.plant = Plant(drive, CREATE2_IDEAL, (0.0, 0.0, 0.0), np.random.default_rng(1))
        self.hardware = Hardware(drive, CREATE2_IDEAL, self.plant)
        self.firmware = Create2Firmware(self.hardware)
        self.now_ns = 0

    def say(self, *data: int) -> None:
        assert self.firmware.receive(bytes(data), self.now_ns) == b""

    def loop(self, times: int = 1) -> bytes:
        """Let loops pass; returns what was streamed in the last."""
        answer = b""
        for _ in range(times):
            self.now_ns += LOOP_NS
            self.plant.step(self.hardware.command, LOOP_NS * 1e-9)
            answer = self.firmware.loop(self.now_ns)
        return answer


@pytest.fixture
def bench() -> Bench:
    return Bench()


def drive(left: int, right: int) -> bytes:
    return struct.pack(">Bhh", 145, right, left)


def test_nothing_moves_it_before_it_is_started_and_has_a_mode_for_it(bench: Bench) -> None:
    for opening in ((), (131,), (132,), (128,)):
        bench.say(*opening, *drive(100, 100))
        assert bench.hardware.command == STOP
    bench.say(131, *drive(100, -50))
    assert bench.hardware.command == pytest.approx(WheelSpeeds(0.1 / 0.036, -0.05 / 0.036))


def test_speeds_are_clipped_at_what_it_can(bench: Bench) -> None:
    bench.say(128, 132, *drive(32767, -32768))
    assert bench.hardware.command == pytest.approx(WheelSpeeds(0.5 / 0.036, -0.5 / 0.036))


@pytest.mark.parametrize("opcode", [128, 133, 173, 7])
def test_what_takes_its_mode_takes_its_motors(bench: Bench, opcode: int) -> None:
    bench.say(128, 131, *drive(100, 100), opcode)
    assert bench.hardware.command == STOP
    bench.say(*drive(100, 100))
    assert bench.hardware.command == STOP


def test_bytes_may_come_one_by_one(bench: Bench) -> None:
    for byte in (128, 131, *drive(100, 200)):
        assert bench.hardware.command == STOP
        bench.say(byte)
    assert bench.hardware.command == pytest.approx(WheelSpeeds(0.1 / 0.036, 0.2 / 0.036))


def test_an_opcode_takes_its_data_whatever_they_say(bench: Bench) -> None:
    bench.say(128, 131, *drive(100, 100))
    song = (140, 0, 2, 128, 128, 7, 7)
    for command in (song, (149, 2, 128, 7), (162, 7, 7), (142, 128), (0,), (255,)):
        bench.say(*command)
    assert bench.firmware.mode is Mode.SAFE
    assert bench.hardware.command.left > 0.0


def test_a_stream_is_as_described(bench: Bench) -> None:
    bench.say(128, 148, 2, 35, 43)
    frame = bench.loop()
    assert frame[:3] == bytes((19, 5, 35))
    assert frame[3] == Mode.PASSIVE
    assert frame[4:7] == bytes((43, 0, 0))
    assert sum(frame) % 256 == 0
    assert bench.loop() == frame
    bench.say(150, 0)
    assert bench.loop() == b""
    bench.say(150, 1)
    assert bench.loop() == frame
    bench.say(173)
    assert bench.loop() == b""


def test_its_counters_wrap(bench: Bench) -> None:
    bench.say(128, 132, *drive(-400, 400), 148, 2, 43, 44)
    bench.loop(100)
    _, _, _, left, _, right, _ = struct.unpack(">BBBHBHB", bench.loop())
    turned = 101 * LOOP_NS * 1e-9 * 0.4 / (0.036 * 2 * np.pi) * 508.8
    assert right == pytest.approx(turned, abs=2)
    assert left == pytest.approx(65536 - turned, abs=2)


@pytest.mark.parametrize("fault", [RobotFault.WHEEL_DROPPED, RobotFault.CLIFF, RobotFault.CHARGING])
def test_in_safe_mode_it_stops_by_itself_and_in_full_mode_it_does_not(fault: RobotFault) -> None:
    for mode, still_drives in ((131, False), (132, True)):
        bench = Bench()
        bench.say(128, mode, *drive(100, 100))
        bench.hardware.feels = fault
        bench.loop()
        assert (bench.hardware.command != STOP) is still_drives
        assert bench.firmware.mode is (Mode.FULL if still_drives else Mode.PASSIVE)


def test_it_may_back_away_from_a_cliff(bench: Bench) -> None:
    bench.hardware.feels = RobotFault.CLIFF
    bench.say(128, 131, *drive(-100, -100))
    bench.loop()
    assert bench.hardware.command.left < 0.0


def test_nothing_stops_it_when_nobody_talks_to_it(bench: Bench) -> None:
    bench.say(128, 131, *drive(100, 100))
    bench.loop(4000)
    assert bench.hardware.command.left > 0.0
    assert bench.firmware.watchdog_s is None


def test_passive_it_sleeps_after_five_minutes_and_controlled_never(bench: Bench) -> None:
    bench.say(128, 131, 148, 1, 35)
    bench.now_ns += 400 * S
    assert bench.loop()
    bench.say(128)
    bench.now_ns += 299 * S
    assert bench.loop()
    bench.now_ns += 2 * S
    assert bench.loop() == b""
    bench.say(128, 131)
    assert bench.loop() == b""
