"""Latches hold a gate closed; leases say whose it is."""

import pytest

from robofleet.safety.gate import GateState, LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP
from tests.safety.gated import BOOT, MS, OTHER, SESSION, WHEELS, Gate, Step, opened

LATCHES = [latch for latch in Latch if latch]


@pytest.mark.parametrize("epoch", [0, 9])
def test_an_e_stop_needs_no_lease(step: Step, epoch: int) -> None:
    gate = opened(step)
    gate.wait(MS)
    gate.enable(latch=Latch.EMERGENCY_STOP, epoch=epoch)
    assert gate.state.latch == Latch.EMERGENCY_STOP
    assert gate.out.target == STOP


def test_nothing_is_cleared_in_motion_or_while_it_is_asked_for(step: Step) -> None:
    gate = opened(step)
    gate.give(latch=Latch.WIRED_STOP)
    gate.wait(5 * MS)
    gate.enable(clear=1)
    assert gate.state.latch == Latch.WIRED_STOP  # the output is on its way
    gate.wait(100 * MS)
    gate.turning = True
    gate.enable(clear=1)
    assert gate.state.latch == Latch.WIRED_STOP  # a wheel turns
    gate.turning, gate.held = False, Latch.WIRED_STOP
    gate.enable(clear=1)
    assert (gate.state.latch, gate.state.latch_id) == (Latch.WIRED_STOP, 1)  # still pressed
    gate.held = Latch.NONE
    gate.enable(clear=1)
    assert gate.state.latch == Latch.NONE


def test_after_a_latch_from_the_bus_an_old_permission_is_gone(step: Step) -> None:
    gate = Gate(step)
    gate.lease()
    gate.enable(latch=Latch.DRILL)
    assert gate.state.limit == 0.0


def test_a_lease_raises_the_epoch_and_is_its_holder_s_alone(step: Step) -> None:
    gate = Gate(step, GateState(boot_id=BOOT, epoch=4))
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
