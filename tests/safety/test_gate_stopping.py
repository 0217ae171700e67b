"""How the gate's output follows its target, what a stop took, and a clock that is set back."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from robofleet.safety.gate import LAPSE_NS, UNKNOWN, VALID_NS
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.safety.gated import FAST, MS, NOW, OTHER, WHEELS, Gate, Step, opened, written


@pytest.mark.parametrize("wheels", [WHEELS, FAST, WheelSpeeds(10.0, 10.0), WheelSpeeds(-7.0, 0.0)])
def test_it_stops_on_its_arc_with_limited_acceleration_and_in_time(step: Step, wheels: WheelSpeeds) -> None:
    gate = opened(step, wheels)
    issued = gate.now
    seen = written(gate, 400 * MS)
    assert seen[1][0] == issued + VALID_NS
    for (before, first), (after, second) in pairwise(seen[1:]):
        assert after - before == 5 * MS
        assert max(abs(a - b) for a, b in zip(first, second, strict=True)) <= 150.0 * 5e-3 + 1e-9
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
    gate.now += VALID_NS
    assert gate.give().output.left == pytest.approx(3.75)


def test_a_wheel_that_has_arrived_does_not_keep_the_other_one_from_catching_up(step: Step) -> None:
    gate = opened(step, WheelSpeeds(0.0, 1.0))
    gate.command(wheels=WheelSpeeds(0.0, 12.0))
    gate.now += 20 * MS
    assert gate.give().output == (0.0, pytest.approx(1.0 + 3.0))


def driving(step: Step) -> Gate:
    """Return a gate at its command, both nonces of now."""
    return opened(step, FAST)


def ramping_up(step: Step) -> Gate:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    gate.command(wheels=FAST)
    gate.now += 5 * MS
    gate.enable()
    gate.command(wheels=FAST)
    assert STOP != gate.out.output != gate.out.target
    return gate


def told_and_not_yet_turning(step: Step) -> Gate:
    gate = Gate(step)
    gate.lease()
    gate.enable()
    gate.command(wheels=FAST)
    assert gate.out.output == STOP != gate.out.target
    return gate


def ramping_down(step: Step) -> Gate:
    gate = opened(step, FAST)
    gate.now += 5 * MS
    gate.give(latch=Latch.WIRED_STOP)
    assert gate.out.output != STOP == gate.out.target
    return gate


@pytest.mark.parametrize("before", [driving, ramping_up, told_and_not_yet_turning, ramping_down])
@pytest.mark.parametrize("held_ns", [VALID_NS + 1, 130 * MS, 1_000 * MS, 3_600_000 * MS])
def test_who_was_not_stepped_for_120_ms_outputs_zero_at_once(
    step: Step, before: Callable[[Step], Gate], held_ns: int
) -> None:
    gate = before(step)
    gate.now += held_ns
    out = gate.give()
    assert (out.output, out.target) == (STOP, STOP)
    assert [output for _, output in written(gate, 500 * MS)] == [STOP]


@pytest.mark.parametrize("before", [driving, ramping_up, told_and_not_yet_turning])
def test_what_was_issued_before_a_gate_was_held_up_counts_no_more(step: Step, before: Callable[[Step], Gate]) -> None:
    """A nonce that it gave out after its last step is younger than 120 ms, and old all the same."""
    gate = before(step)
    issued = gate.now + 30 * MS
    gate.now += VALID_NS + 1
    woke = gate.now
    gate.give()
    for nonce in (issued, woke - 1):
        assert gate.refuses(permission=gate.an_enable(nonce=nonce))
        assert gate.refuses(command=gate.a_command(nonce=nonce))
    gate.enable(nonce=woke)
    assert gate.command(nonce=woke).target == WHEELS


def test_who_had_arrived_has_nothing_to_catch_up_with(step: Step) -> None:
    gate = opened(step, FAST)
    gate.now += 100 * MS
    assert gate.command(wheels=STOP).output.left == pytest.approx(12.5 - 0.75)


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
