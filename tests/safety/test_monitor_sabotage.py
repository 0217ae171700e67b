"""With each constant of the monitor changed, which mutmut leaves alone, its tests go red."""

import pytest

from robofleet.safety import monitor
from tests.sabotage import notices, sabotaged, uncompiled
from tests.safety import test_monitor

pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered")  # where kernels run as Python
TESTS = [test for name, test in vars(test_monitor).items() if name.startswith("test_")]

CHECKS = [
    ("_NAMED = sum(_FAULTS) + _PRESSED", "_NAMED = sum(_FAULTS)"),
    ("\nSILENT_NS = 500 * _MS", "\nSILENT_NS = 510 * _MS"),
    ("TRACKER_SILENT_NS = 250 * _MS", "TRACKER_SILENT_NS = 260 * _MS"),
    ("STALE_TICKS = 15", "STALE_TICKS = 16"),
    ("\nOVERRUNS = 3", "\nOVERRUNS = 4"),
    ("\nUNSEEN_NS = 100 * _MS", "\nUNSEEN_NS = 101 * _MS"),
    ("\nLOST_NS = 2 * _S", "\nLOST_NS = 3 * _S"),
    ("\nOPERATOR_NS = _S", "\nOPERATOR_NS = 2 * _S"),
    ("\nINFEASIBLE_NS = 500 * _MS", "\nINFEASIBLE_NS = 520 * _MS"),
    ("HELD_NS = 120 * _S", "HELD_NS = 121 * _S"),
]


@pytest.mark.parametrize(("check", "without"), CHECKS)
def test_a_constant_that_is_changed_is_noticed(check: str, without: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(test_monitor, "monitor", uncompiled(sabotaged(monitor, check, without)))
    assert any(notices(test, {}) for test in TESTS)
