"""The driver of this project's firmware, which runs beside it: the C sources, compiled for this computer."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from robofleet.drivers import rfp_frames
from robofleet.drivers.rfp import Rfp
from robofleet.drivers.rfp_frames import Identity, Lease, frame, message
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, DriverError, RobotFault, WheelSpeeds
from tests.drivers.line_bench import COUNTS_PER_TURN, LineBench, rfp
from tests.robots import GTERNAL

WHEELS = WheelSpeeds(5.0, -3.0)


def driven(bench: LineBench) -> None:
    """Make the driver, and let the wheels turn."""
    bench.open(counts_per_turn=COUNTS_PER_TURN)
    bench.pass_time(0.3, WHEELS)
    assert bench.firmware.robot.gate.status == GateStatus.OPEN


def stops(bench: LineBench) -> float:
    """Let time pass without a driver; return after how long the firmware's target is zero [s]."""
    for k in range(100):
        gate = bench.firmware.robot.gate
        if gate.target_left == gate.target_right == 0:
            return k * 0.005
        bench.let_pass(0.005)
    return math.inf


def test_the_wheels_turn_as_commanded_and_the_angles_are_theirs() -> None:
    with rfp() as bench:
        driven(bench)
        before = bench.read()
        after = bench.pass_time(1.0, WHEELS)[-1]
        assert bench.hardware.command == pytest.approx(WHEELS, abs=1 / 512)
        turned = after.left_angle - before.left_angle, after.right_angle - before.right_angle
        assert turned == pytest.approx(WHEELS, abs=0.1)
        assert after[2:4] == pytest.approx(WHEELS, abs=0.1)
        assert math.isnan(after.battery) and after.faults == 0


def test_the_target_is_zero_120_ms_after_the_newest_nonce() -> None:
    with rfp() as bench:
        driven(bench)
        gate = bench.firmware.robot.gate
        nonce = min(gate.command_nonce, gate.enabled_nonce)
        assert stops(bench) <= 0.125
        assert 115 <= gate.target_after <= 125 and gate.target_after <= bench.firmware.robot.now - nonce


def test_reading_alone_keeps_nothing_moving() -> None:
    with rfp() as bench:
        driven(bench)
        bench.pass_time(0.2)
        assert bench.hardware.command == STOP


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"counts_per_turn": 375}, "built for 2000 counts a turn, 375 are configured"),
        ({"counts_per_turn": COUNTS_PER_TURN, "board": "uno"}, "its board is 'host', not 'uno'"),
    ],
)
def test_a_firmware_that_was_built_for_another_robot_is_refused(settings: dict[str, Any], why: str) -> None:
    with rfp() as bench, pytest.raises(DriverError, match=why) as refusal:
        bench.open(**settings)
    assert str(bench.port) in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("wheel_radius_um", 32500, "built for 0.0325 m of a wheel's radius, 0.016 are"),
        ("max_wheel", 5120, "built for 10 rad/s of a wheel at most, 12.5 are"),
        ("max_sum", 6400, "built for 0.1 m/s at most, 0.2 are"),
        ("max_ramp", 6554, "built for 100 rad/s.2 of a wheel at most, 150 are"),
    ],
)
def test_a_firmware_with_other_limits_is_refused(field: str, value: int, why: str) -> None:
    with rfp() as bench, pytest.raises(DriverError, match=why):
        bench.to_driver = changed(rfp_frames.Settings, lambda built: built._replace(**{field: value}))
        bench.open(counts_per_turn=COUNTS_PER_TURN)


def test_another_version_of_the_protocol_is_refused() -> None:
    with rfp() as bench, pytest.raises(DriverError, match="it speaks rfp/2, this driver rfp/1: flash"):
        bench.to_driver = changed(Identity, lambda identity: identity._replace(version=2))
        bench.open(counts_per_turn=COUNTS_PER_TURN)


def changed(kind: type, change: Callable[[Any], Any]) -> Callable[[bytes], bytes]:
    """Return what changes messages on their way."""
    receiver = rfp_frames.Receiver()

    def pass_on(data: bytes) -> bytes:
        frames = []
        for body in receiver.receive(data):
            got = message(body)
            assert got is not None
            frames.append(frame(change(got) if isinstance(got, kind) else got, body[0]))
        return b"".join(frames)

    return pass_on


def test_gains_that_are_configured_are_those_of_the_firmware() -> None:
    with rfp() as bench:
        bench.open(counts_per_turn=COUNTS_PER_TURN, gains=[10, 20, 700])
        gains = bench.firmware.robot.gains
        assert (gains.kp, gains.ki, gains.kff) == (10, 20, 700)


def test_a_board_that_does_not_take_its_gains_is_refused() -> None:
    with rfp() as bench, pytest.raises(DriverError, match="it does not take its gains"):
        bench.to_driver = changed(rfp_frames.Settings, lambda built: built._replace(kp=11))
        bench.open(counts_per_turn=COUNTS_PER_TURN, gains=[10, 20, 700])


def test_a_lease_of_a_program_that_died_lapses() -> None:
    with rfp() as bench:
        bench.firmware.receive(frame(Lease(99, 1), 0), bench.now_ns)
        driven(bench)
        assert bench.firmware.robot.gate.session != 99


def test_a_lease_that_another_program_takes_is_an_error() -> None:
    with rfp() as bench:
        bench.open(counts_per_turn=COUNTS_PER_TURN)
        bench.pass_time(0.1, STOP)
        bench.say(bench.firmware.receive(frame(Lease(99, 2), 0), bench.now_ns))
        with pytest.raises(DriverError, match="another program has taken its lease"):
            bench.pass_time(0.3)


def test_a_driver_that_is_closed_gives_its_lease_back() -> None:
    with rfp() as bench:
        driven(bench)
        bench.driver.close()
        bench.hear()
        assert bench.firmware.robot.gate.session == 0


@pytest.mark.parametrize(
    ("reset", "why"),
    [(4, "it had too little voltage"), (8, "it hung, and its watchdog reset it"), (0, "does not tell why")],
)
def test_a_board_that_starts_anew_stands_and_its_driver_says_why(reset: int, why: str) -> None:
    with rfp() as bench:
        driven(bench)
        boot_id = bench.firmware.robot.gate.boot_id
        bench.firmware.start(bench.now_ns, reset)
        with pytest.raises(DriverError, match=f"its board started anew: .*{why}"):
            bench.pass_time(0.3, WHEELS)
        assert bench.firmware.robot.gate.boot_id == boot_id + 1
        assert bench.hardware.command == STOP


def test_a_latch_of_the_firmware_is_told_once_and_cleared_by_a_motion() -> None:
    """The gate before the driver latches by it, and lets a motion through only after its own reset."""
    with rfp() as bench:
        driven(bench)
        bench.hardware.feels = RobotFault.BUMPED
        faults = [reading.faults for reading in bench.pass_time(0.1, WHEELS)]
        assert faults[-1] == RobotFault.BUMPED and bench.firmware.robot.gate.latch == Latch.ROBOT_FAULT
        bench.hardware.feels = RobotFault(0)
        assert [reading.faults for reading in bench.pass_time(0.2, STOP)][-10:] == [0] * 10
        assert bench.firmware.robot.gate.latch == Latch.ROBOT_FAULT
        bench.pass_time(0.2, WHEELS)
        assert bench.firmware.robot.gate.status == GateStatus.OPEN


def test_a_latch_without_a_fault_is_a_fault_of_the_drivers_own() -> None:
    with rfp() as bench:
        driven(bench)
        bench.firmware.robot.gate.latch, bench.firmware.robot.gate.latch_id = Latch.EMERGENCY_STOP, 5
        faults = [reading.faults for reading in bench.pass_time(0.1, STOP)]
        assert [fault for fault in faults if fault] == [RobotFault.OWN << Latch.EMERGENCY_STOP]


def test_a_latch_outlives_the_board_and_is_told_at_the_next_opening() -> None:
    with rfp() as bench:
        driven(bench)
        bench.hardware.feels = RobotFault.CLIFF
        bench.pass_time(0.3, WHEELS)
        bench.hardware.feels = RobotFault(0)
        bench.driver.close()
        bench.firmware.opened(bench.now_ns)  # an Arduino's port resets it
        bench.open(counts_per_turn=COUNTS_PER_TURN)
        assert bench.read().faults == RobotFault.OWN << Latch.ROBOT_FAULT


def test_a_board_that_cannot_keep_a_latch_is_a_fault() -> None:
    with rfp() as bench:
        driven(bench)
        bench.firmware.robot.memory.broken = True
        assert bench.pass_time(0.3, STOP)[-1].faults == RobotFault.OWN << Latch.MEMORY_LOST


def test_counts_that_wrap_turn_no_wheel() -> None:
    with rfp() as bench:
        bench.open(counts_per_turn=COUNTS_PER_TURN)
        driven_from = bench.read().left_angle
        bench.to_driver = changed(
            rfp_frames.Status,
            lambda status: status._replace(left_count=(status.left_count + 2**31 - 20 + 2**31) % 2**32 - 2**31),
        )
        bench.driver._counts = (2**31 - 20, 0)  # as if it had counted for days
        bench.pass_time(0.5, WHEELS)
        assert 0.5 < bench.read().left_angle - driven_from < 3.0


def test_the_charge_is_linear_in_the_voltage() -> None:
    with rfp() as bench:
        bench.open(counts_per_turn=COUNTS_PER_TURN, battery_v=[6.0, 8.4])
        assert bench.pass_time(0.3, STOP)[-1].battery == pytest.approx(1.0, abs=0.01)


def test_values_that_cannot_work_together_are_refused_before_a_port_is_opened() -> None:
    settings = Rfp.Settings.model_validate({"port": "/dev/null", "counts_per_turn": 1, "battery_v": [8.4, 6.0]})
    fast = type(GTERNAL)(**{**vars(GTERNAL), "max_wheel_speed": 64.0})
    assert [path for path, _ in Rfp.refusals(settings, fast)] == ["vehicle.max_wheel_speed_rad_s", "settings.battery_v"]
    assert Rfp.refusals(settings.model_copy(update={"battery_v": None}), GTERNAL) == []


def test_a_line_that_is_busy_gets_the_newest_command() -> None:
    """The gate before the driver sends its ramp every 5 ms: two frames take 10 ms of this line."""
    with rfp() as bench:
        driven(bench)
        bench.received.clear()
        for k in range(40):
            bench.write(5.0 - 0.1 * k, 0.0)
            bench.let_pass(0.005)
        bench.read()
        bench.hear()
        assert sum(map(len, bench.received)) <= 0.21 * 5760
        assert bench.firmware.robot.gate.left == round((5.0 - 3.9) * 512)
