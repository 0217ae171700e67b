"""The gate before the wheels: what it lets through, what it refuses, when it closes, and how it stops."""

import math
from itertools import pairwise, product
from typing import Any

import pytest

from robofleet.safety import gate as the_gate
from robofleet.safety.gate import (
    LAPSE_NS,
    UNKNOWN,
    VALID_NS,
    GateState,
    GateStatus,
    Inputs,
    Latch,
    LeaseAction,
)
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.safety.gated import BOOT, DRIVE, MS, NOW, OTHER, SESSION, WHEELS, Gate, Step, opened


@pytest.fixture(scope="session")
def step() -> Step:
    return the_gate.step


def test_it_is_120_ms() -> None:
    assert VALID_NS == 120_000_000


def test_it_starts_disarmed(step: Step) -> None:
    gate = Gate(step)
    assert gate.out == (STOP, STOP, GateStatus.NO_LEASE, None, None)
    assert gate.state == GateState(BOOT, at_ns=NOW)


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


@pytest.mark.parametrize("which", ["command", "permission"])
@pytest.mark.parametrize("change", [{"boot_id": BOOT + 1}, {"boot_id": BOOT - 1}, {"epoch": 0}, {"epoch": 2}])
def test_another_boot_s_and_another_lease_s_messages_are_refused(
    step: Step, which: str, change: dict[str, int]
) -> None:
    gate = opened(step)
    gate.wait(10 * MS)
    made: Any = gate.a_command() if which == "command" else gate.an_enable()
    assert gate.refuses(**{which: made._replace(**change)})
    assert gate.out.target == WHEELS


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


def test_after_the_last_sequence_number_there_is_none(step: Step) -> None:
    gate = opened(step)
    gate.command(seq=2**32 - 1)
    assert gate.refuses(command=gate.a_command(seq=0))
    assert gate.refuses(command=gate.a_command(seq=2**32 - 1))
    assert gate.wait(VALID_NS).target == STOP


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
    [(4.0, True), (4.0 / 1.0099, True), (4.0 / 1.0101, False), (0.0, False), (-1.0, False), (math.nan, False)],
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


def test_a_refused_message_feeds_no_watchdog(step: Step) -> None:
    gate = opened(step)
    closes = gate.out.deadline_ns
    for _ in range(11):
        gate.wait(10 * MS)
        assert gate.refuses(command=gate.a_command(wheels=WheelSpeeds(99.0, 0.0)))
        assert gate.refuses(permission=gate.an_enable(boot_id=BOOT + 1))
        assert gate.out.deadline_ns == closes == NOW + 150 * MS + VALID_NS
    assert gate.wait(10 * MS).target == STOP


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


def test_on_the_way_up_too_it_wakes_when_validity_ends(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.wait(VALID_NS)
    gate.enable(nonce=gate.now - VALID_NS + 3 * MS)
    assert gate.command(wheels=WheelSpeeds(9.0, 9.0)).deadline_ns == gate.now + 3 * MS


def test_the_status_is_renewed_when_its_reason_runs_out(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    assert gate.command(wheels=STOP).deadline_ns == NOW + VALID_NS  # nothing moves, and yet
    gate.now += 50 * MS
    gate.enable()
    gate.now = NOW + VALID_NS
    assert gate.give()[2:] == (GateStatus.NO_COMMAND, None, NOW + 50 * MS + VALID_NS)
    gate.now = NOW + 50 * MS + VALID_NS
    assert gate.give()[2:] == (GateStatus.NO_ENABLE, None, None)


def test_a_new_command_replaces_the_old_one(step: Step) -> None:
    gate = opened(step)
    gate.wait(10 * MS)
    assert gate.command(wheels=WheelSpeeds(1.0, 2.0)).target == (1.0, 2.0)


# How the output follows.


def written(gate: Gate, ns: int) -> list[tuple[int, WheelSpeeds]]:
    """Return (instant, output) of every step while a gate is left alone, the present one first."""
    seen, end = [(gate.now, gate.out.output)], gate.now + ns
    while gate.out.deadline_ns is not None and gate.out.deadline_ns <= end:
        gate.now = gate.out.deadline_ns
        seen.append((gate.now, gate.give().output))
    return seen


FAST = WheelSpeeds(12.5, -12.5)


@pytest.mark.parametrize("wheels", [WHEELS, FAST, WheelSpeeds(10.0, 10.0), WheelSpeeds(-7.0, 0.0)])
def test_it_stops_on_its_arc_with_limited_acceleration_and_in_time(step: Step, wheels: WheelSpeeds) -> None:
    gate = opened(step, wheels)
    issued = gate.now
    seen = written(gate, 400 * MS)
    assert seen[1][0] == issued + VALID_NS
    for (before, one), (after, other) in pairwise(seen[1:]):
        assert after - before == 5 * MS
        assert max(abs(a - b) for a, b in zip(one, other, strict=True)) <= 150.0 * 5e-3 + 1e-9
    for _, (left, right) in seen:
        assert left * wheels[1] == pytest.approx(right * wheels[0])
        assert left * wheels[0] >= 0
        assert right * wheels[1] >= 0
    sizes = [max(map(abs, output)) for _, output in seen[1:]]
    assert all(b < a for a, b in pairwise(sizes))
    assert seen[-1][1] == STOP
    assert seen[-1][0] - issued <= 230 * MS
    assert gate.state.target_after_ns == VALID_NS
    assert gate.state.output_after_ns == seen[-1][0] - issued


def test_it_starts_and_turns_round_with_limited_acceleration(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    gate.command(wheels=FAST)
    up = written(gate, 100 * MS)
    gate.enable()
    gate.command(wheels=WheelSpeeds(-12.5, 12.5))
    round_ = written(gate, 119 * MS)
    for (before, one), (after, other) in pairwise(up + round_[1:]):
        assert abs(one.left - other.left) <= 150.0 * (after - before) * 1e-9 + 1e-9
    assert up[-1][1] == FAST
    assert round_[-1][1].left < -4.0


def test_who_was_held_up_on_its_way_catches_up_by_20_ms_at_most(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    gate.command(wheels=FAST)
    gate.now += 5 * MS
    assert gate.give().output.left == pytest.approx(0.75)
    gate.now += 20 * MS
    assert gate.give().output.left == pytest.approx(3.75)
    gate.now += 60 * MS
    assert gate.give().output.left == pytest.approx(6.75)
    gate.now += 3_000 * MS
    assert gate.give().output.left == pytest.approx(3.75)


def test_who_had_arrived_has_nothing_to_catch_up_with(step: Step) -> None:
    gate = opened(step, FAST)
    gate.now += 100 * MS
    assert gate.command(wheels=STOP).output.left == pytest.approx(12.5 - 0.75)


def test_at_the_same_instant_nothing_moves(step: Step) -> None:
    gate = opened(step, FAST)
    gate.now += 10 * MS
    gate.give()
    assert gate.command(wheels=STOP).output == FAST


# What a stop took.


def test_before_the_first_stop_nothing_is_known(step: Step) -> None:
    gate = opened(step)
    assert (gate.state.target_after_ns, gate.state.output_after_ns) == (UNKNOWN, UNKNOWN) == (-1, -1)


def test_a_stop_is_timed_from_one_nonce_and_known_when_it_is_over(step: Step) -> None:
    gate = opened(step, FAST)
    gate.wait(30 * MS)
    gate.give(latch=Latch.WIRED_STOP)
    assert (gate.state.target_after_ns, gate.state.output_after_ns) == (30 * MS, UNKNOWN)
    for _ in range(3):  # who keeps talking does not change what it took
        gate.wait(40 * MS)
        gate.enable()
        gate.command()
    assert gate.state.target_after_ns == 30 * MS
    assert 30 * MS + 80 * MS <= gate.state.output_after_ns <= 30 * MS + 90 * MS
    gate.enable(clear=1)
    gate.enable()
    gate.command()
    assert gate.state.output_after_ns >= 110 * MS  # until another one begins
    gate.wait(40 * MS)
    gate.give(latch=Latch.WIRED_STOP)
    assert (gate.state.target_after_ns, gate.state.output_after_ns) == (40 * MS, UNKNOWN)


def test_a_stop_before_the_wheels_turned_is_over_at_once(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    gate.command()
    gate.give(latch=Latch.WIRED_STOP)
    assert (gate.state.target_after_ns, gate.state.output_after_ns) == (0, 0)


# Latches.

LATCHES = [latch for latch in Latch if latch]


@pytest.mark.parametrize("latch", LATCHES)
@pytest.mark.parametrize("own", [True, False])
def test_a_latch_closes_at_once_and_holds(step: Step, latch: Latch, own: bool) -> None:
    gate = opened(step)
    gate.wait(10 * MS)
    out = gate.give(latch=latch) if own else gate.enable(latch=latch)
    assert (out.target, out.status) == (STOP, GateStatus.LATCHED)
    assert (gate.state.latch, gate.state.latch_id) == (latch, 1)
    gate.wait(100 * MS)
    gate.enable()
    assert gate.command().status is GateStatus.LATCHED


@pytest.mark.parametrize(("held", "latch"), list(product(LATCHES, LATCHES)))
def test_the_gravest_latch_holds_and_each_has_its_number(step: Step, held: Latch, latch: Latch) -> None:
    gate = Gate(step, GateState(BOOT, latch=held, latch_id=5))
    gate.give(latch=latch)
    assert (gate.state.latch, gate.state.latch_id) == ((latch, 6) if latch > held else (held, 5))


@pytest.mark.parametrize("epoch", [0, 9])
def test_an_e_stop_needs_no_lease(step: Step, epoch: int) -> None:
    gate = opened(step)
    gate.wait(MS)
    gate.enable(latch=Latch.EMERGENCY_STOP, epoch=epoch)
    assert gate.state.latch is Latch.EMERGENCY_STOP
    assert gate.out.target == STOP


def test_a_reset_clears_a_latch_and_moves_nothing(step: Step) -> None:
    gate = opened(step)
    gate.give(latch=Latch.DRILL)
    gate.wait(100 * MS)
    gate.command()
    assert gate.enable(clear=1).target == STOP
    assert (gate.state.latch, gate.state.latch_id, gate.out.status) == (Latch.NONE, 1, GateStatus.NO_ENABLE)
    assert gate.enable().target == WHEELS


@pytest.mark.parametrize(
    "hindered",
    [
        {"clear": 4},
        {"clear": 6},
        {"clear": 0},
        {"clear": 5, "boot_id": BOOT + 1},
        {"clear": 5, "epoch": 3},
        {"clear": 5, "nonce": NOW - VALID_NS},
    ],
)
def test_who_may_not_clears_nothing(step: Step, hindered: dict[str, int]) -> None:
    gate = Gate(step, GateState(BOOT, latch=Latch.EMERGENCY_STOP, latch_id=5))
    gate.enable(**hindered)
    assert gate.state.latch is Latch.EMERGENCY_STOP


def test_nothing_is_cleared_in_motion_or_while_it_is_asked_for(step: Step) -> None:
    gate = opened(step)
    gate.give(latch=Latch.WIRED_STOP)
    gate.wait(5 * MS)
    gate.enable(clear=1)
    assert gate.state.latch is Latch.WIRED_STOP  # the output is on its way
    gate.wait(100 * MS)
    gate.turning = True
    gate.enable(clear=1)
    assert gate.state.latch is Latch.WIRED_STOP  # a wheel turns
    gate.turning, gate.held = False, Latch.WIRED_STOP
    gate.enable(clear=1)
    assert (gate.state.latch, gate.state.latch_id) == (Latch.WIRED_STOP, 1)  # still pressed
    gate.held = Latch.NONE
    gate.enable(clear=1)
    assert gate.state.latch is Latch.NONE


def test_a_latch_without_a_number_is_not_cleared_by_those_who_clear_nothing(step: Step) -> None:
    gate = Gate(step, GateState(BOOT, latch=Latch.EMERGENCY_STOP))
    gate.enable(clear=0)
    assert gate.state.latch is Latch.EMERGENCY_STOP


def test_an_e_stop_that_clears_is_an_e_stop(step: Step) -> None:
    gate = Gate(step, GateState(BOOT, latch=Latch.DRILL, latch_id=1))
    gate.enable(clear=1, latch=Latch.EMERGENCY_STOP)
    assert gate.state.latch is Latch.EMERGENCY_STOP


def test_after_a_latch_from_the_bus_an_old_permission_is_gone(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable(latch=Latch.DRILL)
    assert gate.state.limit == 0.0


# Leases.


def test_a_lease_raises_the_epoch_and_is_its_holder_s_alone(step: Step) -> None:
    gate = Gate(step, GateState(BOOT, epoch=4))
    assert gate.lease() is True
    assert (gate.state.epoch, gate.state.session) == (5, SESSION)
    assert gate.lease(OTHER) is False
    assert gate.lease() is True  # asked again: an answer was lost
    assert (gate.state.epoch, gate.state.session) == (5, SESSION)
    assert gate.give().granted is None


@pytest.mark.parametrize("action", list(LeaseAction))
def test_nobody_has_no_lease(step: Step, action: LeaseAction) -> None:
    gate = Gate(step)
    assert gate.lease(0, action) is False
    assert gate.state.epoch == 0


@pytest.mark.parametrize(("silent", "granted"), [(LAPSE_NS - 1, False), (LAPSE_NS, True)])
def test_a_lease_lapses_a_second_after_the_last_command(step: Step, silent: int, granted: bool) -> None:
    gate = Gate(step)
    gate.lease()
    gate.wait(900 * MS)
    gate.command()
    gate.refuses(command=gate.a_command(seq=0))
    gate.wait(silent)
    gate.refuses(command=gate.a_command(seq=0))  # does not count
    assert gate.lease(OTHER) is granted


def test_a_lease_lapses_also_if_there_never_was_a_command(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.wait(LAPSE_NS - 1)
    assert gate.lease(OTHER) is False
    gate.wait(1)
    assert gate.lease(OTHER) is True


@pytest.mark.parametrize("action", [LeaseAction.ACQUIRE, LeaseAction.TAKE_OVER])
@pytest.mark.parametrize("moving", ["output", "wheel"])
def test_no_lease_is_given_in_motion(step: Step, action: LeaseAction, moving: str) -> None:
    gate = opened(step)
    gate.lease(SESSION, LeaseAction.RELEASE)
    gate.wait(10 * MS if moving == "output" else 200 * MS)
    gate.turning = moving == "wheel"
    assert gate.lease(OTHER, action) is False
    gate.wait(200 * MS)
    gate.turning = False
    assert gate.lease(OTHER, action) is True


def test_at_rest_a_lease_is_taken_over_from_a_controller_that_is_alive(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.command()
    assert gate.lease(OTHER, LeaseAction.TAKE_OVER) is True
    assert (gate.state.epoch, gate.state.session, gate.state.seq) == (2, OTHER, 0)


def test_neither_permission_nor_command_outlives_the_lease(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    gate.command(wheels=STOP)
    gate.command(seq=9, wheels=STOP)
    gate.lease(OTHER, LeaseAction.TAKE_OVER)
    assert gate.out.status is GateStatus.NO_ENABLE
    assert gate.enable().status is GateStatus.NO_COMMAND
    assert not gate.refuses(command=gate.a_command(session=OTHER, seq=1))
    assert gate.out.target == WHEELS


def test_a_release_stops_and_is_the_holder_s_alone(step: Step) -> None:
    gate = opened(step)
    gate.wait(10 * MS)
    assert gate.lease(OTHER, LeaseAction.RELEASE) is False
    assert gate.out.target == WHEELS
    assert gate.lease(SESSION, LeaseAction.RELEASE) is True
    assert (gate.out.target, gate.out.status) == (STOP, GateStatus.NO_LEASE)
    assert gate.state.target_after_ns == 10 * MS
    assert gate.lease() is False
    gate.wait(100 * MS)
    assert (gate.out.output, gate.lease(), gate.state.epoch) == (STOP, True, 2)


# A clock that is set back.


def test_a_clock_that_is_set_back_closes_and_starts_another_boot(step: Step) -> None:
    gate = opened(step, FAST)
    before = gate.state
    old_command, old_enable = gate.a_command(), gate.an_enable()
    gate.now = NOW - 500 * MS
    out = gate.give()
    assert (out.target, out.output, out.status) == (STOP, FAST, GateStatus.NO_ENABLE)
    assert gate.state.boot_id == before.boot_id + 1
    assert (gate.state.target_after_ns, gate.state.output_after_ns) == (UNKNOWN, UNKNOWN)
    sizes = [output.left for _, output in written(gate, 200 * MS)]
    assert sizes[-1] == 0.0
    assert all(0.0 < a - b <= 0.75 + 1e-9 for a, b in pairwise(sizes))
    assert gate.state.output_after_ns == UNKNOWN
    gate.now = before.at_ns + 10 * MS  # and forward again: what was said before counts no more
    assert gate.refuses(command=old_command)
    assert gate.refuses(permission=old_enable)
    gate.enable()
    assert gate.command().target == WHEELS


def test_a_clock_that_is_set_back_ends_a_lease_no_later(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.now = NOW - 500_000 * MS
    gate.give()
    gate.wait(LAPSE_NS)
    assert gate.lease(OTHER) is True


def test_after_a_clock_was_set_back_an_old_command_is_not_valid_again(step: Step) -> None:
    gate = opened(step)
    gate.now -= 50 * MS
    gate.give()
    assert gate.enable().status is GateStatus.NO_COMMAND


def test_an_instant_twice_is_no_clock_that_was_set_back(step: Step) -> None:
    gate = opened(step)
    gate.give()
    assert gate.state.boot_id == BOOT
    assert step(gate.state, DRIVE, Inputs(), gate.now)[1].target == WHEELS
