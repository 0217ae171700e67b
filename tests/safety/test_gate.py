"""The gate before the wheels: what it lets through, what it refuses, and when it closes."""

import math
from itertools import product
from typing import Any

import pytest

from robofleet.safety.gate import VALID_NS, GateState, LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.safety.gated import BOOT, MS, NOW, OTHER, SESSION, WHEELS, Gate, Step, opened


def test_it_is_120_ms() -> None:
    assert VALID_NS == 120_000_000


@pytest.mark.parametrize(("lease", "enable", "command", "latch"), list(product((False, True), repeat=4)))
def test_the_target_needs_lease_and_command_and_enable_and_no_latch(
    step: Step, lease: bool, enable: bool, command: bool, latch: bool
) -> None:
    gate = Gate(step)
    if lease:
        assert gate.lease() is True
    if enable:
        gate.enable()
    if command:
        gate.command()
    if latch:
        gate.give(latch=Latch.WIRED_STOP)
    why = [
        (latch, GateStatus.LATCHED),
        (not lease, GateStatus.NO_LEASE),
        (not enable, GateStatus.NO_ENABLE),
        (not command, GateStatus.NO_COMMAND),
        (True, GateStatus.OPEN),
    ]
    assert gate.out.status is next(status for so, status in why if so)
    assert gate.out.target == (WHEELS if gate.out.status is GateStatus.OPEN else STOP)


@pytest.mark.parametrize(("age", "accepted"), [(0, True), (VALID_NS - 1, True), (VALID_NS, False), (-1, False)])
@pytest.mark.parametrize("which", ["command", "permission"])
def test_a_message_counts_by_its_nonce_not_its_arrival(step: Step, which: str, age: int, accepted: bool) -> None:
    gate = Gate(step)
    gate.lease()
    made: Any = gate.a_command() if which == "command" else gate.an_enable()
    assert gate.refuses(**{which: made._replace(nonce=NOW - age)}) is not accepted


@pytest.mark.parametrize("session", [0, OTHER])
def test_only_the_holder_of_the_lease_drives(step: Step, session: int) -> None:
    gate = opened(step)
    gate.wait(10 * MS)
    assert gate.refuses(command=gate.a_command(session=session))
    gate.lease(SESSION, LeaseAction.RELEASE)
    assert gate.refuses(command=gate.a_command(session=session))


@pytest.mark.parametrize(("seq", "accepted"), [(41, False), (42, False), (43, True), (2**32 - 1, True)])
def test_a_command_must_be_newer_than_the_last(step: Step, seq: int, accepted: bool) -> None:
    gate = Gate(step)
    gate.lease()
    gate.command(seq=42)
    assert gate.refuses(command=gate.a_command(seq=seq)) is not accepted


@pytest.mark.parametrize(
    ("nonce", "seq", "accepted"), [(0, 42, False), (0, 41, False), (0, 43, True), (-1, 99, False), (1, 1, True)]
)
def test_a_permission_must_be_newer_than_the_last(step: Step, nonce: int, seq: int, accepted: bool) -> None:
    gate = Gate(step)
    gate.enable(seq=42)
    gate.now += 1
    assert gate.refuses(permission=gate.an_enable(nonce=NOW + nonce, seq=seq)) is not accepted


@pytest.mark.parametrize(
    "wheels",
    [
        (12.5 * 1.009999, -12.5 * 1.009999),
        (-12.5 * 1.009999, 12.5 * 1.009999),
        (10.0 * 1.009999, 10.0 * 1.009999),  # 0.16 m/s is 10 rad/s of both wheels
        (-10.0 * 1.009999, -10.0 * 1.009999),
        (12.5 * 1.01, -12.5 * 1.01),
        (-12.5 * 1.01, 12.5 * 1.01),
        (10.1, 10.1),
        (12.5, 7.6),
        (0.0, 0.0),
    ],
)
def test_just_inside_a_limit_passes_unchanged(step: Step, wheels: tuple[float, float]) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    assert gate.command(wheels=WheelSpeeds(*wheels)).target == wheels
    assert gate.out.status is GateStatus.OPEN
    assert gate.state.refused == 0


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
def test_outside_is_refused_not_clamped(step: Step, wheels: tuple[float, float]) -> None:
    gate = opened(step)
    gate.wait(10 * MS)
    assert gate.refuses(command=gate.a_command(wheels=WheelSpeeds(*wheels)))
    assert gate.out.target == WHEELS


@pytest.mark.parametrize(
    ("limit", "passes"),
    [
        (4.0, True),
        (4.0 / 1.01, True),
        (4.0 / 1.0099, True),
        (4.0 / 1.0101, False),
        (0.0, False),
        (-1.0, False),
        (math.nan, False),
    ],
)
@pytest.mark.parametrize("wheels", [WheelSpeeds(3.0, -4.0), WheelSpeeds(-4.0, 3.0)])
def test_what_is_permitted_may_be_less_than_what_the_robot_can_do(
    step: Step, limit: float, passes: bool, wheels: WheelSpeeds
) -> None:
    gate = opened(step, wheels)
    gate.wait(10 * MS)
    assert gate.enable(limit=limit).target == (wheels if passes else STOP)
    assert gate.out.status is (GateStatus.OPEN if passes else GateStatus.NO_ENABLE)
    assert gate.state.refused == 0


def test_a_permission_to_creep_permits_creeping(step: Step) -> None:
    gate = opened(step, WheelSpeeds(0.4, -0.4))
    gate.wait(10 * MS)
    assert gate.enable(limit=0.5).target == (0.4, -0.4)


@pytest.mark.parametrize("renewed", ["command", "enable"])
def test_validity_ends_with_the_older_of_the_two(step: Step, renewed: str) -> None:
    gate = opened(step)
    closes = gate.now + VALID_NS
    gate.wait(50 * MS)
    getattr(gate, renewed)()
    assert gate.out.deadline_ns == closes
    gate.now = closes - 1
    assert gate.give().target == WHEELS
    gate.now = closes
    assert gate.give().target == STOP
    assert gate.out.status is (GateStatus.NO_ENABLE if renewed == "command" else GateStatus.NO_COMMAND)
    assert gate.state.target_after_ns == VALID_NS


def test_after_a_latch_from_the_bus_an_old_permission_is_gone(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    assert gate.enable(latch=Latch.DRILL).granted is None, "no lease was asked for"
    assert gate.state.limit == 0.0


def test_ids_that_no_float_tells_apart_are_not_taken_for_each_other(step: Step) -> None:
    """For numba a signed and an unsigned number are equal if their floats are."""
    count = 2**62 + 7
    gate = Gate(step, GateState(boot_id=BOOT, epoch=count, latch=Latch.EMERGENCY_STOP, latch_id=count))
    gate.enable(clear=count + 1)
    assert gate.state.latch == Latch.EMERGENCY_STOP
    gate.enable(clear=count)
    assert gate.state.latch == Latch.NONE
    assert gate.lease() is True
    for change in ({"epoch": count}, {"boot_id": BOOT - 1}, {"session": OTHER}):
        assert gate.refuses(command=gate.a_command(**change))
    for change in ({"epoch": count}, {"boot_id": BOOT - 1}):
        assert gate.refuses(permission=gate.an_enable(**change))
    gate.command(seq=2**63 + 8)
    assert gate.refuses(command=gate.a_command(seq=2**63 + 8))
    assert not gate.refuses(command=gate.a_command(seq=2**63 + 9))
    assert gate.state.epoch == count + 1
