"""How the gate's output follows its target, what a stop took, and a clock that is set back."""

from itertools import pairwise

import pytest

from robofleet.safety.gate import (
    LAPSE_NS,
    UNKNOWN,
    VALID_NS,
    GateStatus,
    Inputs,
    Latch,
)
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.safety.gated import BOOT, DRIVE, FAST, MS, NOW, OTHER, WHEELS, Gate, Step, opened, written


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
