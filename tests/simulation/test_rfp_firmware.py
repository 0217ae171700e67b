"""The loop of this project's firmware and its memory, compiled for this computer: a test holds the board's pins."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robofleet.bus.private_folder import PlaceError
from robofleet.drivers import rfp_frames
from robofleet.drivers.rfp_frames import (
    Command,
    Gains,
    Health,
    Hello,
    Identity,
    Lease,
    LeaseAnswer,
    Message,
    Permission,
    Settings,
    Status,
    frame,
    message,
)
from robofleet.runs.check_drivers import of_robot
from robofleet.safety.latches import GateStatus, Latch
from robofleet.simulation import firmware_library
from robofleet.vehicles.interface import RobotFault
from tests.twins import config_of

SESSION, COUNTS, NO_LOAD = 21, 2248, 15.0  # rad/s of a wheel at full duty
POWER_ON, BROWN_OUT = 1, 4


@pytest.fixture(scope="module")
def library() -> Any:
    return firmware_library.firmware_library({}, firmware_library.SOURCES)


class Bench:
    """A board, a robot's motors (first order) and a host."""

    def __init__(self, library: Any) -> None:
        self.ffi, self.c = library
        self.board, self.robot = self.ffi.new("struct host *"), self.ffi.new("struct robot *")
        self.board.eeprom, self.board.writes_left = b"\xff" * 34, 10**6
        self.receiver, self.got = rfp_frames.Receiver(), list[Message]()
        self.speeds, self.angles = [0.0, 0.0], [0.0, 0.0]
        self.lag_s = 0.05
        self.blocked = False
        self.seq = self.epoch = self.sent = 0
        self.start(POWER_ON)

    def start(self, reset: int = BROWN_OUT) -> None:
        self.c.host_select(self.board)
        self.board.reset, self.board.sent, self.board.duty = reset, 0, [0, 0]
        self.c.robot_start(self.robot)

    def send(self, *messages: Message) -> None:
        data = b"".join(frame(each, self.sent + k) for k, each in enumerate(messages))
        self.sent += len(messages)
        self.ffi.memmove(self.board.to_robot, data, len(data))
        self.board.received, self.board.arrived = 0, len(data)
        while self.board.received < self.board.arrived:
            self.loop()

    def loop(self) -> None:
        self.c.host_select(self.board)
        self.c.robot_loop(self.robot)
        data, self.board.sent = bytes(self.ffi.buffer(self.board.to_host, self.board.sent)), 0
        self.got += [got for body in self.receiver.receive(data) if (got := message(body)) is not None]

    def let_pass(self, ms: int) -> None:
        for _ in range(ms):
            for side in (0, 1):
                aim = 0.0 if self.blocked else NO_LOAD * self.board.duty[side] / 1024
                self.speeds[side] += (aim - self.speeds[side]) * 0.001 / self.lag_s
                self.angles[side] += self.speeds[side] * 0.001
                self.board.counts[side] = int(self.angles[side] * COUNTS / 6.283185307)
            self.board.now_us = (self.board.now_us + 1000) % 2**32
            self.loop()

    def newest(self, kind: type) -> Any:
        return next(each for each in reversed(self.got) if isinstance(each, kind))

    def lease(self) -> None:
        self.send(Lease(SESSION, 1))
        self.let_pass(12)
        self.epoch = self.newest(LeaseAnswer).epoch

    def motion(self, left: float, right: float, **changes: int) -> tuple[Command, Permission]:
        status, self.seq = self.newest(Status), self.seq + 1
        nonce = status.boot_id, status.nonce
        return (
            Command(self.epoch, SESSION, self.seq, *nonce, round(512 * left), round(512 * right)),
            Permission(self.epoch, self.seq, *nonce, 0, 0, 6144)._replace(**changes),
        )

    def drive(self, left: float, right: float, ms: int, **changes: int) -> None:
        for _ in range(ms // 20):
            self.send(*self.motion(left, right, **changes))
            self.let_pass(20)


@pytest.fixture
def bench(library: Any) -> Iterator[Bench]:
    bench = Bench(library)
    bench.let_pass(20)
    bench.lease()
    yield bench


def test_it_sends_its_status_a_hundred_times_a_second_and_more_at_whiles(bench: Bench) -> None:
    bench.got.clear()
    bench.let_pass(1000)
    assert [sum(isinstance(got, kind) for got in bench.got) for kind in (Status, Health)] == [100, 10]
    assert bench.receiver.lost == bench.receiver.struck == 0
    assert bench.board.kicks > 1000


def test_both_ways_fit_into_57600_baud(bench: Bench) -> None:
    """RFP.md says these loads."""
    bench.got.clear()
    bench.let_pass(1000)
    assert sum(len(frame(got, 0)) for got in bench.got) == 3500 + 370
    command, permission = (len(frame(each, 0)) for each in bench.motion(1.0, 1.0))
    assert (command, permission) == (29, 28)


def test_a_line_that_takes_nothing_stops_no_loop(bench: Bench) -> None:
    bench.board.sent = len(bench.board.to_host)
    for _ in range(50):
        bench.board.now_us += 1000
        bench.c.robot_loop(bench.robot)
    assert bench.board.sent == len(bench.board.to_host)
    bench.board.sent = 0
    bench.got.clear()
    bench.let_pass(30)
    assert sum(isinstance(got, Status) for got in bench.got) >= 3


def test_a_burst_of_frames_is_taken_in_more_than_one_loop(bench: Bench) -> None:
    motions = [each for _ in range(9) for each in bench.motion(1.0, 1.0)]
    bench.send(*motions)
    assert (bench.robot.gate.seq, bench.robot.gate.enabled_seq, bench.robot.gate.refused) == (9, 9, 0)


def test_the_longest_loop_is_told(bench: Bench) -> None:
    for call_us in (300, 100, 70_000):
        bench.board.call_us = call_us
        bench.loop()
    bench.board.call_us = 0
    bench.let_pass(200)
    assert bench.newest(Health).loop_us == 2**16 - 1


def test_who_it_is_and_what_is_built_in_are_told_when_asked(bench: Bench) -> None:
    bench.send(Hello())
    bench.let_pass(10)
    identity, settings = bench.newest(Identity), bench.newest(Settings)
    assert (identity.version, identity.board.rstrip(b"\0"), identity.reset) == (1, b"host", POWER_ON)
    assert settings == Settings(2248 * 256, 32500, 6144, 9452, 6554, 96, 160, 683)


def test_the_speed_loop_reaches_the_speeds_without_an_error_that_stays(bench: Bench) -> None:
    bench.drive(8.0, -3.0, 1000)
    before = list(bench.angles)
    bench.drive(8.0, -3.0, 1000)
    assert [b - a for a, b in zip(before, bench.angles, strict=True)] == pytest.approx([8.0, -3.0], abs=0.01)
    status = bench.newest(Status)
    assert (status.left_speed / 512, status.right_speed / 512) == pytest.approx((8.0, -3.0), abs=0.1)
    assert (status.left_output, status.right_output, status.gate) == (4096, -1536, GateStatus.OPEN)
    assert bench.board.counts[0] - status.left_count == pytest.approx(8.0 * 0.003 * COUNTS / 6.28, abs=10)


def test_the_voltage_is_even_while_the_speed_is(bench: Bench) -> None:
    """The loop runs every millisecond, and counts come every 5 ms."""
    bench.drive(8.0, 8.0, 1000)
    duties = []
    for _ in range(10):
        bench.send(*bench.motion(8.0, 8.0))
        for _ in range(20):
            bench.let_pass(1)
            duties.append(bench.board.duty[0])
    assert max(duties) - min(duties) < 40


def test_a_motor_that_cannot_go_so_fast_does_not_catch_up_later(bench: Bench) -> None:
    bench.drive(12.0, 12.0, 200)
    bench.lag_s = 0.5
    bench.drive(12.0, 12.0, 400)
    bench.lag_s = 0.05
    bench.drive(6.0, 6.0, 400)
    assert max(bench.speeds) < 7.5


def test_motors_brake_at_once_where_the_output_is_zero(bench: Bench) -> None:
    bench.drive(8.0, 8.0, 500)
    bench.let_pass(120 + 85)
    assert list(bench.board.duty) == [0, 0]
    health = bench.robot.gate
    assert 0 < health.target_after <= 121 and health.output_after <= 205


def test_a_loop_that_was_held_up_stands_at_once(bench: Bench) -> None:
    bench.drive(8.0, 8.0, 500)
    bench.board.now_us += 121_000
    bench.loop()
    assert list(bench.board.duty) == [0, 0]


def test_a_wheel_that_does_not_turn_though_it_is_driven_is_a_fault(bench: Bench) -> None:
    bench.drive(4.0, 4.0, 200)
    bench.blocked = True
    bench.drive(0.4, 4.0, 1000)
    status = bench.newest(Status)
    assert (status.gate, status.latch, status.felt) == (GateStatus.LATCHED, Latch.ROBOT_FAULT, RobotFault.OVERCURRENT)
    bench.blocked = False
    bench.drive(4.0, 4.0, 40, clear=bench.robot.gate.latch_id)
    bench.drive(4.0, 4.0, 100)
    status = bench.newest(Status)
    assert (status.gate, status.felt) == (GateStatus.OPEN, 0)


def test_a_wheel_that_turns_by_itself_latches(bench: Bench) -> None:
    for _ in range(1100):
        bench.angles[1] += 0.001
        bench.let_pass(1)
    assert bench.newest(Status).latch == Latch.RUNAWAY
    assert list(bench.board.duty) == [0, 0]


@pytest.mark.parametrize(
    ("fault", "latch"), [(RobotFault.WIRED_STOP, Latch.WIRED_STOP), (RobotFault.CLIFF, Latch.ROBOT_FAULT)]
)
def test_what_the_robot_feels_latches_it(bench: Bench, fault: RobotFault, latch: Latch) -> None:
    bench.drive(4.0, 4.0, 100)
    bench.board.faults = fault
    bench.let_pass(20)
    status = bench.newest(Status)
    assert (status.latch, status.faults, status.felt) == (latch, fault, fault)


def test_a_latch_of_another_version_is_an_emergency_stop(bench: Bench) -> None:
    bench.drive(4.0, 4.0, 40, latch=99)
    assert bench.robot.gate.latch == Latch.EMERGENCY_STOP


def test_gains_are_taken_at_rest_alone_and_within_bounds(bench: Bench) -> None:
    for gains in (Gains(8192, 1, 1), Gains(1, 8192, 1), Gains(1, 1, 8192)):
        bench.send(gains)
    bench.drive(4.0, 4.0, 100)
    bench.send(Gains(1, 2, 3))
    bench.let_pass(5)
    assert bench.newest(Settings)[-3:] == (96, 160, 683)
    bench.let_pass(400)
    bench.send(Gains(1, 2, 3))
    bench.let_pass(5)
    assert bench.newest(Settings)[-3:] == (1, 2, 3)


def test_frames_that_are_none_of_these_are_counted(bench: Bench) -> None:
    for body in (b"\x10\x00", b"\x20", b"\x30", b"\x40", b"\x50", b"\xa0", b"\xf0" + bytes(22)):
        bench.ffi.memmove(bench.board.to_robot, rfp_frames.line(body), len(body) + 6)
        bench.board.received, bench.board.arrived = 0, len(body) + 6
        bench.loop()
    bench.let_pass(100)
    assert bench.newest(Health).struck == 7


def test_the_board_tells_its_battery_and_currents(bench: Bench) -> None:
    bench.board.battery_mv, bench.board.current_ma = 7400, [120, -130]
    bench.let_pass(100)
    health = bench.newest(Health)
    assert (health.battery_mv, health.left_ma, health.right_ma, health.session) == (7400, 120, -130, SESSION)


def test_after_49_days_its_clock_begins_anew_and_nothing_of_before_counts(bench: Bench) -> None:
    boot_id = bench.robot.gate.boot_id
    bench.robot.now = bench.robot.gate.at = bench.robot.tick = 2**32 - 40
    bench.robot.status = bench.robot.health = 2**32 - 40
    for wheel in bench.robot.wheels:
        wheel.runaway.looked = 2**32 - 40
    bench.let_pass(20)
    bench.drive(4.0, 4.0, 20)
    bench.let_pass(100)
    assert bench.robot.gate.boot_id == boot_id + 1
    assert 120 <= bench.robot.now < 300
    bench.drive(4.0, 4.0, 200)
    assert bench.newest(Status).gate == GateStatus.OPEN


# Its memory.


def latched(bench: Bench, latch: Latch = Latch.EMERGENCY_STOP) -> None:
    bench.drive(0.0, 0.0, 20, latch=latch)
    bench.let_pass(120)


def test_each_start_has_a_number_of_its_own(bench: Bench) -> None:
    numbers = []
    for _ in range(5):
        numbers.append(bench.robot.gate.boot_id)
        bench.start()
    assert numbers == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("latch", [Latch.EMERGENCY_STOP, Latch.RUNAWAY])
def test_a_latch_outlives_a_reset_in_mid_drive_and_nothing_moves(bench: Bench, latch: Latch) -> None:
    bench.drive(4.0, 4.0, 200)
    latched(bench, latch)
    bench.start(BROWN_OUT)
    bench.let_pass(120)
    assert bench.newest(Status)[8:10] == (GateStatus.LATCHED, latch)
    assert bench.newest(Health).reset == BROWN_OUT
    assert list(bench.board.duty) == [0, 0]


def test_a_drill_does_not(bench: Bench) -> None:
    latched(bench, Latch.DRILL)
    bench.start()
    assert bench.robot.gate.latch == Latch.NONE


def test_a_latch_that_was_cleared_stays_cleared(bench: Bench) -> None:
    latched(bench)
    bench.drive(4.0, 4.0, 20, clear=bench.robot.gate.latch_id)
    bench.let_pass(120)
    bench.start()
    assert bench.robot.gate.latch == Latch.NONE


@pytest.mark.parametrize("writes", [1, 2, 5, 8, 11, 13])
def test_a_power_cut_while_a_latch_is_written_loses_no_latch(bench: Bench, writes: int) -> None:
    """From the first byte on: before it, nothing was written."""
    boot_id = bench.robot.gate.boot_id
    bench.board.writes_left = writes
    latched(bench)
    bench.board.writes_left = 10**6
    bench.start(BROWN_OUT)
    assert bench.robot.gate.latch == Latch.EMERGENCY_STOP
    assert bench.robot.gate.boot_id > boot_id
    assert not bench.robot.memory.broken


@pytest.mark.parametrize("writes", [0, 1, 2, 4, 5, 11])
def test_a_power_cut_while_a_latch_is_cleared_loses_no_latch(bench: Bench, writes: int) -> None:
    latched(bench)
    bench.board.writes_left = writes
    bench.drive(0.0, 0.0, 20, clear=bench.robot.gate.latch_id)
    bench.let_pass(120)
    whole = not bench.robot.memory.broken
    bench.board.writes_left = 10**6
    bench.start(BROWN_OUT)
    assert whole or bench.robot.gate.latch == Latch.EMERGENCY_STOP


@pytest.mark.parametrize("writes", [0, 1, 2, 5, 6, 16])
def test_a_power_cut_at_a_start_gives_no_number_twice(bench: Bench, writes: int) -> None:
    given = {bench.robot.gate.boot_id}
    bench.board.writes_left = writes
    bench.c.robot_start(bench.robot)
    if not bench.robot.memory.broken:
        given.add(bench.robot.gate.boot_id)
    bench.board.writes_left = 10**6
    bench.start(BROWN_OUT)
    assert bench.robot.gate.boot_id not in given
    assert bench.robot.gate.latch == Latch.NONE


def test_a_first_byte_that_is_none_is_a_memory_lost(bench: Bench) -> None:
    bench.start()
    bench.board.eeprom[17 * bench.robot.memory.slot] = 200
    bench.start()
    assert bench.robot.gate.latch == Latch.MEMORY_LOST


def test_a_memory_of_which_nothing_is_whole_latches(bench: Bench) -> None:
    bench.board.eeprom = bytes(range(34))
    bench.start()
    first = bench.robot.gate.boot_id, bench.robot.gate.latch_id
    assert bench.robot.gate.latch == Latch.MEMORY_LOST and min(first) > 2**16
    bench.board.eeprom = b"\xff" * 17 + bytes(17)
    bench.start()
    assert bench.robot.gate.latch == Latch.MEMORY_LOST
    bench.board.eeprom = bytes(range(34))
    bench.start()
    assert bench.robot.gate.latch == Latch.MEMORY_LOST


def test_a_memory_that_is_worn_keeps_the_robot_standing(bench: Bench) -> None:
    bench.board.worn[17 * bench.robot.memory.slot + 3] = 1
    latched(bench)
    bench.let_pass(20)
    assert bench.robot.memory.broken
    bench.drive(4.0, 4.0, 100, clear=bench.robot.gate.latch_id)
    status, health = bench.newest(Status), bench.newest(Health)
    assert status.gate == GateStatus.LATCHED and health.memory_lost == 1
    assert list(bench.board.duty) == [0, 0]


def test_bytes_of_the_memory_are_where_the_header_says(bench: Bench) -> None:
    latched(bench)
    slot = 17 * (1 - bench.robot.memory.slot)
    latch, latch_id, boot_id, sequence = struct.unpack(
        "<BIII", bytes(bench.ffi.buffer(bench.board.eeprom))[slot : slot + 13]
    )
    assert (latch, latch_id, boot_id, sequence) == (Latch.EMERGENCY_STOP, 1, 1, 2)


# Where it cannot be built.


def test_a_computer_without_a_compiler_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(firmware_library.shutil, "which", lambda _: None)
    with pytest.raises(firmware_library.NoCompilerError, match=r"NO C COMPILER: .* apt install gcc"):
        firmware_library.firmware_library({})


def test_a_run_whose_twins_cannot_be_compiled_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(firmware_library.shutil, "which", lambda _: None)
    refused = ("robots.0.twin", "NO C COMPILER: the firmware's twin needs cc: apt install gcc")
    assert refused in list(of_robot(config_of(twin="rfp", vehicle="rfp"), 0))


@pytest.mark.slow
def test_what_others_may_have_written_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    firmware_library.firmware_library({})
    (folder,) = (tmp_path / "robofleet").iterdir()  # and none of kernels, which have rules of their own
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o770)
    with pytest.raises(PlaceError, match=f"chmod 700 {folder}"):
        firmware_library.firmware_library({})


@pytest.mark.slow
def test_a_robot_that_the_firmware_cannot_drive_is_not_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(firmware_library.NoCompilerError, match="RFP_MAX_WHEEL_RAD_S: at most 63"):
        firmware_library.firmware_library({"MAX_WHEEL_RAD_S": 100.0})
    assert [*tmp_path.rglob("firmware*")] == []


@pytest.mark.slow
def test_every_line_and_branch_of_gate_and_protocol_is_run() -> None:
    from tools.measure.robots.firmware_mutants import coverage

    shares = coverage()
    assert (shares["gate.c"], shares["rfp.c"]) == ((100.0, 100.0), (100.0, 100.0))
