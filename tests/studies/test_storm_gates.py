"""The storm's judge of a gate, and a driver's clock that goes back."""

from dataclasses import replace

import pytest

from robofleet.core.clock import S
from robofleet.safety.gate import GateState, Inputs, LeaseAction, step
from robofleet.studies.storm.gates import GateAudit
from robofleet.studies.storm.ledger import GateDecision
from tests.robots import GTERNAL

BOOT_ID, DRAWN = 7, 90_210
LEASE = Inputs(lease=True, lease_session=5, lease_action=LeaseAction.ACQUIRE)


def decided(state: GateState, inputs: Inputs, true_s: int, now_s: int) -> GateDecision:
    after = replace(state)
    step(after, GTERNAL, inputs, now_s * S)
    return GateDecision(true_s * S, now_s * S, inputs, after)


def violations(*decisions: GateDecision) -> list[str]:
    return [found.invariant for found in GateAudit("r1", GTERNAL, lambda _: True, []).violations(decisions)]


@pytest.fixture
def leased() -> GateDecision:
    """A gate whose lease somebody has, ten seconds after its start."""
    return decided(GateState(boot_id=BOOT_ID), LEASE, 10, 10)


def test_a_driver_whose_clock_is_set_back_counts_its_boot_id_up_and_keeps_its_lease(leased: GateDecision) -> None:
    back = decided(leased.state, Inputs(), 11, 3)
    assert (back.state.boot_id, back.state.session) == (BOOT_ID + 1, 5)
    assert violations(leased, back) == []


def test_a_driver_that_starts_again_with_its_clock_behind_has_no_lease(leased: GateDecision) -> None:
    restarted = decided(GateState(boot_id=DRAWN, epoch=leased.state.epoch), Inputs(), 11, 3)
    assert violations(leased, restarted) == []


def test_a_lease_that_lives_on_after_a_restart_is_found_whatever_its_clock_says(leased: GateDecision) -> None:
    for now_s in (3, 12):
        alive = decided(replace(leased.state, boot_id=DRAWN, at_ns=0), Inputs(), 11, now_s)
        assert "the lease changed without a right" in violations(leased, alive)
