"""The gate before the wheels: what it lets through, what it refuses, and when it closes."""

import math

import pytest

from robofleet.safety.gate import (
    VALID_NS,
    Command,
    GateState,
    GateStatus,
    Permission,
    step,
)
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, WheelSpeeds

BOOT, NOW = 7, 1_000_000_000_000
DRIVE = DifferentialDrive(
    wheel_radius=0.016,
    wheel_base=0.105,
    max_wheel_speed=12.5,
    max_speed=0.16,
    motor_lag=0.08,
    max_wheel_acceleration=150.0,
)
WHEELS = WheelSpeeds(3.0, -4.0)


def command(nonce: int = NOW, wheels: WheelSpeeds = WHEELS, boot_id: int = BOOT) -> Command:
    return Command(boot_id, nonce, wheels)


def enable(nonce: int = NOW, running: bool = True, boot_id: int = BOOT) -> Permission:
    return Permission(boot_id, nonce, running)


def opened(nonce: int = NOW) -> GateState:
    state, output = step(GateState(BOOT), DRIVE, command(nonce), enable(nonce), nonce)
    assert output.target == WHEELS
    return state


def test_it_is_120_ms() -> None:
    assert VALID_NS == 120_000_000


def test_both_are_needed() -> None:
    assert step(GateState(BOOT), DRIVE, None, None, NOW)[1] == (STOP, GateStatus.NO_ENABLE, None)
    assert step(GateState(BOOT), DRIVE, command(), None, NOW)[1] == (STOP, GateStatus.NO_ENABLE, None)
    assert step(GateState(BOOT), DRIVE, None, enable(), NOW)[1] == (STOP, GateStatus.NO_COMMAND, None)
    state, output = step(GateState(BOOT), DRIVE, command(), enable(), NOW)
    assert output == (WHEELS, GateStatus.OPEN, NOW + VALID_NS)
    assert state.refused == 0


def test_neither_order_matters() -> None:
    state, _ = step(GateState(BOOT), DRIVE, None, enable(), NOW)
    assert step(state, DRIVE, command(), None, NOW + 1)[1].target == WHEELS


@pytest.mark.parametrize(("age", "accepted"), [(0, True), (VALID_NS - 1, True), (VALID_NS, False), (-1, False)])
def test_a_message_counts_by_its_nonce_not_its_arrival(age: int, accepted: bool) -> None:
    state, output = step(GateState(BOOT), DRIVE, command(NOW - age), enable(), NOW)
    assert output.target == (WHEELS if accepted else STOP)
    assert state.refused == (not accepted)
    state, output = step(GateState(BOOT), DRIVE, command(), enable(NOW - age), NOW)
    assert output.target == (WHEELS if accepted else STOP)
    assert state.refused == (not accepted)


def test_validity_ends_with_the_older_of_the_two_nonces() -> None:
    for older, newer in ((command(NOW - 50), enable()), (command(), enable(NOW - 50))):
        _, output = step(GateState(BOOT), DRIVE, *sorted_by_kind(older, newer), NOW)
        assert output.deadline_ns == NOW - 50 + VALID_NS


def sorted_by_kind(a: Command | Permission, b: Command | Permission) -> tuple[Command, Permission]:
    return (a, b) if isinstance(a, Command) and isinstance(b, Permission) else (b, a)  # type: ignore[return-value]


def test_the_deadline_is_when_the_output_changes() -> None:
    state = opened()
    deadline = step(state, DRIVE, None, None, NOW)[1].deadline_ns
    assert deadline == NOW + 120_000_000
    assert step(state, DRIVE, None, None, deadline - 1)[1] == (WHEELS, GateStatus.OPEN, deadline)
    assert step(state, DRIVE, None, None, deadline)[1].target == STOP


def test_the_status_says_which_one_ran_out() -> None:
    late = NOW + 60_000_000
    state, _ = step(opened(), DRIVE, None, enable(late), late)
    assert step(state, DRIVE, None, None, NOW + VALID_NS)[1].status is GateStatus.NO_COMMAND
    state, _ = step(opened(), DRIVE, command(late), None, late)
    assert step(state, DRIVE, None, None, NOW + VALID_NS)[1].status is GateStatus.NO_ENABLE


@pytest.mark.parametrize(
    "wheels",
    [
        (12.5 * 1.009999, -12.5 * 1.009999),
        (-12.5 * 1.009999, 12.5 * 1.009999),
        (10.0 * 1.009999, 10.0 * 1.009999),  # 0.16 m/s is 10 rad/s of both wheels
        (-10.0 * 1.009999, -10.0 * 1.009999),
        (12.5, 7.6),
    ],
)
def test_just_inside_a_limit_passes_unchanged(wheels: tuple[float, float]) -> None:
    _, output = step(GateState(BOOT), DRIVE, command(wheels=WheelSpeeds(*wheels)), enable(), NOW)
    assert output.target == wheels


@pytest.mark.parametrize(
    "wheels",
    [
        (12.5 * 1.010001, -12.5 * 1.010001),
        (0.0, -12.5 * 1.010001),
        (12.5 * 1.010001, 0.0),
        (10.0 * 1.010001, 10.0 * 1.010001),
        (-12.5, -7.8),
        (math.nan, 0.0),
        (0.0, math.nan),
        (math.inf, -math.inf),
        (-math.inf, 0.0),
        (1e300, -1e300),
    ],
)
def test_outside_is_refused_not_clamped(wheels: tuple[float, float]) -> None:
    state, output = step(GateState(BOOT), DRIVE, command(wheels=WheelSpeeds(*wheels)), enable(), NOW)
    assert output == (STOP, GateStatus.NO_COMMAND, None)
    assert state.refused == 1
    assert state.wheels == STOP


def test_another_boots_messages_are_refused() -> None:
    state, output = step(GateState(BOOT), DRIVE, command(boot_id=BOOT + 1), enable(boot_id=BOOT - 1), NOW)
    assert output.target == STOP
    assert state == GateState(BOOT, refused=2)


@pytest.mark.parametrize(
    "refused",
    [
        command(NOW + 50_000_001),  # from the future
        command(NOW + 50_000_000, boot_id=8),
        command(NOW + 50_000_000, WheelSpeeds(20.0, 0.0)),
        command(NOW + 50_000_000, WheelSpeeds(math.nan, 0.0)),
        command(NOW - 70_000_000),  # too old
    ],
)
def test_a_refused_command_feeds_no_watchdog(refused: Command) -> None:
    state, later = opened(), NOW + 50_000_000
    after, output = step(state, DRIVE, refused, None, later)
    assert after == state._replace(refused=1)
    assert output == (WHEELS, GateStatus.OPEN, NOW + VALID_NS)


@pytest.mark.parametrize(
    "refused",
    [
        enable(NOW + 50_000_001),
        enable(NOW + 50_000_000, boot_id=8),
        enable(NOW - 70_000_000),
        enable(NOW - 70_000_000, running=False),  # a stop so old cannot be told from a replay
    ],
)
def test_a_refused_enable_feeds_no_watchdog(refused: Permission) -> None:
    state, later = opened(), NOW + 50_000_000
    after, output = step(state, DRIVE, None, refused, later)
    assert after == state._replace(refused=1)
    assert output.deadline_ns == NOW + VALID_NS


def test_an_enable_that_is_not_running_closes_at_once() -> None:
    state, output = step(opened(), DRIVE, command(NOW + 1), enable(NOW + 1, running=False), NOW + 1)
    assert output == (STOP, GateStatus.NO_ENABLE, None)
    assert state.refused == 0
    assert step(state, DRIVE, command(NOW + 2), None, NOW + 2)[1].target == STOP
    assert step(state, DRIVE, None, enable(NOW + 2), NOW + 2)[1].target == WHEELS


def test_a_new_command_replaces_the_old_one() -> None:
    state, output = step(opened(), DRIVE, command(NOW + 9, WheelSpeeds(1.0, 2.0)), None, NOW + 10)
    assert output.target == (1.0, 2.0)
    assert state.command_until_ns == NOW + 9 + VALID_NS
