"""What an operator is told to do about a cause."""

import pytest

from robofleet.safety.advice import advised
from robofleet.safety.supervisor import CAUSES, TRANSITIONS, Event, Phase

ASKED = (Event.HOLD_REQUESTED, Event.ESTOP_REQUESTED)  # whoever asked knows what to do
NAMED_ELSEWHERE = (Event.OPERATOR_LOST, Event.ARMED_TOO_LONG)  # with who is missing, or who has not acknowledged
STANDING = {
    event for (_, event), to in TRANSITIONS.items() if to in (Phase.HOLD, Phase.FAULT, Phase.ESTOP)
} - {*ASKED, *NAMED_ELSEWHERE}  # fmt: skip


@pytest.mark.parametrize("event", sorted(STANDING))
def test_every_cause_that_makes_a_fleet_stand_says_what_to_do(event: Event) -> None:
    what, colon, advice = advised(CAUSES[event], event).partition(": ")
    assert what
    assert colon
    assert advice


def test_what_needs_no_advice_and_what_is_not_known_stay_as_they_are() -> None:
    assert advised("hold requested", Event.HOLD_REQUESTED) == "hold requested"
    assert advised("a cause of another version", 999) == "a cause of another version"


def test_what_the_machines_load_made_is_mended_on_the_machine() -> None:
    assert "keep this machine busy" in advised("its tag is late", Event.TAG_LOST, busy=True)
    assert "keep this machine busy" not in advised("its tag is late", Event.TAG_LOST)
