"""With each check of the supervisor's process taken out, the test that is named beside it goes red."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from robofleet.bus import statuses
from robofleet.nodes import camera_reports, fleet_view, supervisor
from robofleet.safety import arming
from tests.nodes import stand as bench_stand
from tests.nodes.supervisor import test_checks, test_run, test_said, test_sight, test_stops
from tests.sabotage import notices, sabotaged

FILES = test_checks, test_run, test_said, test_sight, test_stops
TESTS = {name: value for file in FILES for name, value in vars(file).items() if name.startswith("test_")}

CHECKS: list[tuple[ModuleType, str, str, str]] = [
    # who may move
    (supervisor, "self._permitted[row], states[\"cause\"][row] = 0.0, happening.event",
     "states[\"cause\"][row] = happening.event",
     "test_a_robot_whose_tag_is_hidden_stands_alone_and_goes_on_when_it_is_seen"),
    (supervisor, "if self._status.phase in MOVING:\n            return self._limits.copy()",
     "if self._status.phase is not Phase.IDLE:\n            return self._limits.copy()",
     "test_a_held_run_stands_and_goes_on_when_asked"),
    (supervisor, "self._probing[strokes, np.arange", "self._probing[np.maximum(strokes, 1), np.arange",
     "test_who_is_tried_alone_may_move_while_armed"),
    (supervisor, "np.minimum(self._probing[strokes, np.arange(len(strokes))], self._limits)", "self._limits",
     "test_who_is_tried_alone_may_move_while_armed"),
    (supervisor, "self._checks, self._start = None, False", "self._start = False",
     "test_a_start_begins_the_checks_anew"),
    (supervisor, "if self._status.phase is Phase.ARMED:", "if False:",
     "test_a_run_starts_when_asked_and_stops_when_asked"),
    # what stops it
    (supervisor, "for happening in self._standing:\n            self._happen(happening)", "",
     "test_whoever_goes_silent_stops_the_run_by_name"),
    (supervisor, "Latch.EMERGENCY_STOP if phase is Phase.ESTOP else Latch.NONE", "Latch.NONE",
     "test_an_emergency_stop_reaches_every_gate_at_once_and_is_acknowledged"),
    (supervisor, "Latch.EMERGENCY_STOP if phase is Phase.ESTOP else Latch.NONE", "Latch.NONE",
     "test_a_driver_that_comes_back_later_is_stopped_too"),
    (supervisor, "self._naming_ns = self._view.now_ns + _ACKNOWLEDGED_WITHIN_NS", "self._naming_ns = None",
     "test_who_has_not_acknowledged_after_200_ms_is_named"),
    (supervisor, "[acknowledged(seen) for seen in self._view.robots]", "[True for seen in self._view.robots]",
     "test_who_has_not_acknowledged_after_200_ms_is_named"),
    (supervisor, "bus.serve(SAFE_REQUEST, \"supervisor\", wake)", "bus.serve(SAFE_REQUEST, \"supervisor\")",
     "test_a_request_wakes_it"),
    (supervisor, " or after != before:", ":",
     "test_a_state_every_40_ms_and_at_once_when_it_changes"),
    (supervisor, "\"attended\":\n            self._operator_ns = self._view.now_ns", "\"attended\":\n            pass",
     "test_a_run_whose_operator_went_away_is_stopped_for_good"),
    (supervisor, "attended=attended, elsewhere", "attended=False, elsewhere",
     "test_a_run_whose_operator_went_away_is_stopped_for_good"),
    (supervisor, "self._operator_ns = self._view.now_ns\n                self._start", "self._start",
     "test_an_operator_who_asks_for_a_start_has_a_second_to_be_there"),
    # how it ends
    (supervisor, "seen.latch_id if seen.latch else 0 for", "0 for",
     "test_a_reset_clears_the_latches_and_moves_nothing"),
    (supervisor, "else clear[row]", "else seen.latch_id",
     "test_a_new_supervisor_begins_in_idle_and_leaves_latches_as_they_are"),
    (supervisor, "else clear[row]", "else seen.latch_id if clear.any() else 0",
     "test_a_reset_clears_no_latch_that_came_later"),
    (supervisor, "clearing and seen.latch == _DRILL", "clearing",
     "test_a_new_supervisor_begins_in_idle_and_leaves_latches_as_they_are"),
    (supervisor, "checks is None or checks.clear,", "True,",
     "test_a_drill_latches_every_gate_and_clears_it_again"),
    (supervisor, "checks is None or checks.clear,", "checks is not None,",
     "test_a_drill_that_was_broken_off_leaves_nothing_behind_and_clears_no_e_stop"),
    (supervisor, "if phase is Phase.IDLE and held and", "if False and",
     "test_a_reset_that_a_gate_does_not_follow_is_refused_by_name"),
    (supervisor, "answer if phase is Phase.IDLE else", "answer if True else",
     "test_an_emergency_stop_during_a_reset_wins"),
    # what is believed of what is heard
    (supervisor, "status.boot_id, status.nonce, phase", "status.boot_id, self._view.now_ns, phase",
     "test_enables_echo_the_newest_nonce_and_the_epoch_of_the_lease"),
    (statuses, "(known and known.boot_id == status.boot_id and status.nonce <= known.nonce)", "False",
     "test_a_status_that_was_overtaken_says_nothing"),
    (statuses, "known.boot_id == status.boot_id and ", "",
     "test_a_driver_whose_clock_began_anew_is_heard"),
    (fleet_view, "record.tick <= self._fleet.tick:", "False:",
     "test_a_tick_that_was_overtaken_says_nothing"),
    (fleet_view, "record.epoch == self._fleet.controller_epoch and ", "",
     "test_a_restarted_controller_ends_the_run"),
    (camera_reports, "elif image.seq <= self.seq:", "elif False:",
     "test_a_tag_that_the_tracker_predicts_is_not_seen"),
    (camera_reports, "exposure_ns - pose.coasted_ns", "exposure_ns",
     "test_a_tag_that_the_tracker_predicts_is_not_seen"),
    (camera_reports, "if pose.coasted_ns == 0:", "if True:", "test_a_tag_that_is_only_predicted_gives_no_place"),
    (camera_reports, "self.measured_ns += image.exposure_ns - self.exposure_ns", "pass",
     "test_a_tracker_that_was_restarted_on_another_clock_makes_nobody_seen_or_lost"),
    (camera_reports, "if news.event in _TAG_NEWS and row != _UNKNOWN:", "if False:",
     "test_the_trackers_news_in_the_runs_words"),
]  # fmt: skip
WHERE = {
    fleet_view: [(supervisor, "FleetListener")],
    camera_reports: [(fleet_view, "CameraReports")],
    statuses: [(fleet_view, "Statuses")],
    supervisor: [(bench_stand, "Supervisor")],
}


@pytest.mark.parametrize(("module", "check", "without", "test"), CHECKS)
@pytest.mark.long
def test_a_check_that_is_taken_out_is_missed(
    module: ModuleType,
    check: str,
    without: str,
    test: str,
    bench_of: Callable[..., Any],
    platoon_of: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(arming, "step", arming.step)
    copy = sabotaged(module, check, without)
    for target, name in WHERE[module]:
        monkeypatch.setattr(target, name, getattr(copy, name))

    def stand_of(**keys: Any) -> bench_stand.Stand:
        return bench_stand.Stand(bench_of(platoon_of()), **keys)

    assert notices(TESTS[test], {"stand": stand_of, "stand_of": lambda: stand_of})
