"""With any one of its constants changed the gate's tests go red; as it is they do not."""

import pytest

from robofleet.safety import gate
from tests.safety.gated import plain
from tests.safety.sabotage_gate import SABOTAGES, cases, noticed_by, sabotaged


def test_the_gate_as_it_is_passes_all_of_its_tests() -> None:
    assert sum(1 for _ in cases()) > 100
    assert noticed_by(plain(gate.step)) is None


@pytest.mark.parametrize("what", list(SABOTAGES))
def test_a_gate_with_another_constant_is_noticed(what: str) -> None:
    assert noticed_by(sabotaged(*SABOTAGES[what])) is not None
