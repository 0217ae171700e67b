"""With each check of the monitor taken out, its tests go red."""

import pytest

from robofleet.safety import monitor
from tests.sabotage import notices, sabotaged
from tests.safety import test_monitor

TESTS = [test for name, test in vars(test_monitor).items() if name.startswith("test_")]

CHECKS = [
    ("abs(view.now_ns - before.now_ns) > SILENT_NS", "False"),
    ("abs(view.now_ns - before.now_ns)", "(view.now_ns - before.now_ns)"),
    ("settings.attended and view.now_ns - view.operator_ns > OPERATOR_NS", "False"),
    ("settings.attended and ", ""),
    ("view.free_bytes < LEAST_FREE_BYTES", "False"),
    ("memory.phase is Phase.ARMED and lasted_ns >", "False and lasted_ns >"),
    ("memory.phase is Phase.ARMED and ", ""),
    (" + ARMED_ROBOT_NS * len(view.robots)", ""),
    ("memory.phase is Phase.HOLD and lasted_ns >", "False and lasted_ns >"),
    ("memory.phase is Phase.HOLD and ", ""),
    ("memory.since_ns if phase is memory.phase else now_ns", "memory.since_ns"),
    ("memory.since_ns if phase is memory.phase else now_ns", "now_ns"),
    ("if view.controller_ns == NEVER:", "if False:"),
    ("view.now_ns - view.controller_ns > SILENT_NS", "False"),
    ("before.controller_epoch not in (0, view.controller_epoch)", "False"),
    ("not in (0, view.controller_epoch)", "not in (view.controller_epoch,)"),
    ("view.controller_build != settings.build", "False"),
    ("phase is Phase.RUNNING and view.overruns - before.overruns >= OVERRUNS", "False"),
    ("phase is Phase.RUNNING and view.overruns", "view.overruns"),
    ("view.overruns - before.overruns >= OVERRUNS", "view.overruns >= OVERRUNS"),
    ("if view.tracker_ns == NEVER:", "if False:"),
    ("view.now_ns - view.tracker_ns > TRACKER_SILENT_NS or stale", "stale"),
    ("view.now_ns - view.tracker_ns > TRACKER_SILENT_NS or stale", "view.now_ns - view.tracker_ns > TRACKER_SILENT_NS"),
    ("view.image_tick != 0 and ", ""),
    ("before.tracker_epoch not in (0, view.tracker_epoch)", "False"),
    ("not in (0, view.tracker_epoch)", "not in (view.tracker_epoch,)"),
    ("view.tracker_build != settings.build", "False"),
    ("if robot.heard_ns == NEVER:", "if False:"),
    ("now_ns - robot.heard_ns > SILENT_NS", "False"),
    ("before.boot_id not in (0, robot.boot_id)", "False"),
    ("not in (0, robot.boot_id)", "not in (robot.boot_id,)"),
    ("robot.build != build", "False"),
    ("robot.session != session", "False"),
    ("memory.sessions if started and memory.sessions else", "memory.sessions or"),
    ("memory.sessions if started and memory.sessions else", ""),
    ("robot.faults & WIRED_STOP or (", "False or ("),
    ("robot.latch == Latch.WIRED_STOP and phase is not Phase.IDLE", "False"),
    ("robot.latch == Latch.WIRED_STOP and phase is not Phase.IDLE", "robot.latch == Latch.WIRED_STOP"),
    ("elif robot.latch and not (robot.latch == Latch.DRILL and phase is Phase.ARMED):", "elif False:"),
    ("not (robot.latch == Latch.DRILL and phase is Phase.ARMED)", "robot.latch != Latch.DRILL"),
    (" and not (robot.latch == Latch.DRILL and phase is Phase.ARMED)", ""),
    ("faults := robot.faults & ~WIRED_STOP", "faults := 0"),
    ("faults := robot.faults & ~WIRED_STOP", "faults := robot.faults"),
    ("0.0 <= robot.battery < LOWEST_BATTERY", "False"),
    ("0.0 <= robot.battery", "True and robot.battery"),
    ("    if robot.seen_ns == NEVER:\n", "    if False:\n"),
    ("robot.unseen_ns >= LOST_NS", "False"),
    ("robot.unseen_ns >= LATE_NS or robot.lost", "robot.lost"),
    ("robot.unseen_ns >= LATE_NS or robot.lost", "robot.unseen_ns >= LATE_NS"),
    ("abs(x) + radius > length / 2", "False"),
    ("abs(y) + radius > width / 2", "False"),
    ("abs(x) + radius", "x + radius"),
    ("abs(x) + radius", "abs(x)"),
    ("abs(y) + radius", "abs(y)"),
    ("if robot.seen_ns != NEVER]", "]"),
    ("- bodies < CLOSEST_M", "< CLOSEST_M"),
    ("hypot(x - other_x, y - other_y) - bodies < CLOSEST_M", "False"),
    ("(at_ns or now_ns) if running and robot.filtered == 2 else NEVER", "NEVER"),
    ("(at_ns or now_ns) if running", "now_ns if running"),
    ("if running and robot.filtered == 2", "if robot.filtered == 2"),
    ("robot.filtered == 2", "robot.filtered"),
    ("now_ns - infeasible_ns[row] >= INFEASIBLE_NS", "True"),
    ("if running and robot.blocked:", "if False:"),
    ("if running and robot.blocked:", "if robot.blocked:"),
    ("*view.news,", ""),
    ("\nSILENT_NS = 500 * _MS", "\nSILENT_NS = 510 * _MS"),
    ("TRACKER_SILENT_NS = 250 * _MS", "TRACKER_SILENT_NS = 260 * _MS"),
    ("STALE_TICKS = 15", "STALE_TICKS = 16"),
    ("\nOVERRUNS = 3", "\nOVERRUNS = 4"),
    ("\nLATE_NS = 100 * _MS", "\nLATE_NS = 101 * _MS"),
    ("\nLOST_NS = 2 * _S", "\nLOST_NS = 3 * _S"),
    ("\nOPERATOR_NS = _S", "\nOPERATOR_NS = 2 * _S"),
    ("\nINFEASIBLE_NS = 500 * _MS", "\nINFEASIBLE_NS = 520 * _MS"),
    ("HELD_NS = 60 * _S", "HELD_NS = 61 * _S"),
]


@pytest.mark.parametrize(("check", "without"), CHECKS)
def test_a_check_that_is_taken_out_is_missed(check: str, without: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(test_monitor, "monitor", sabotaged(monitor, check, without))
    assert any(notices(test, {}) for test in TESTS)
