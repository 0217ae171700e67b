"""With each check before a start taken out, what it is there for is no longer refused, or a healthy fleet is."""

from collections.abc import Callable
from types import ModuleType

import pytest

from robofleet.safety import arming, rolled, wiggle
from tests.sabotage import notices, sabotaged
from tests.safety import test_arming, test_arming_faults, test_rolled
from tests.safety.arming_lab import Lab
from tests.safety.arming_scenarios import HEALTHY, REFUSED

By = str | Callable[..., None]  # the scenario, or the test, that notices

ARMING: list[tuple[str, str, By]] = [
    ("heard_ns != NEVER and build != settings.build", "False", "controller of another build"),
    ("(view.tracker_ns, view.tracker_build)", "", "tracker of another build"),
    ("heard_ns != NEVER and build", "build", "no controller"),
    ("robot.heard_ns != NEVER and (unfit", "(unfit", "no driver"),
    ("robot.build != build", "False", "driver of another build"),
    ("robot.faults & WIRED_STOP", "False", "wired stop pressed"),
    ("elif robot.driven and (told := faults_told(robot.faults)):", "elif False:", "robot's own fault"),
    ("fault = told[0]", "fault = told[-1]", "robot's bumper and more"),
    ("robot.latch > Latch.DRILL", "False", "latched by an e-stop"),
    ("robot.latch > Latch.DRILL", "robot.latch >= Latch.DRILL", "a start was broken off in its drill"),
    ("0.0 <= robot.battery < _CHARGE", "False", "battery low"),
    ("0.0 <= robot.battery", "True and robot.battery", "the battery is unknown"),
    ("0.0 <= robot.battery", "0.0 < robot.battery", "battery empty"),
    ("robot.battery < _CHARGE", "robot.battery <= _CHARGE", "the battery has a fifth"),
    ("view.free_bytes < _FREE_BYTES", "False", "disk full"),
    ("view.free_bytes < _FREE_BYTES", "view.free_bytes <= _FREE_BYTES", "the disk has 200 MB"),
    ("view.now_ns - state.since_ns >= _PATIENCE_NS", "True", "a lease comes after 4 s"),
    ("view.now_ns - state.since_ns >= _PATIENCE_NS", "False", "no lease"),
    ("clear=drilled", "clear=False", "a start was broken off in its drill"),
    ("if misplaced is not None:", "if False:", "two too close"),
    ("if _silent(now_ns, view.controller_ns)", "if False", "controller silent"),
    ("if _silent(now_ns, view.tracker_ns)", "if False", "tracker silent"),
    ("r.driven and now_ns - r.heard_ns >= _SILENT_NS", "False", "driver silent"),
    ("r.heard_ns >= _SILENT_NS", "r.heard_ns > _SILENT_NS", "driver silent"),
    ("max(now_ns - r.seen_ns, r.unseen_ns)", "r.unseen_ns", "tag late"),
    ("max(now_ns - r.seen_ns, r.unseen_ns)", "now_ns - r.seen_ns", "tag not in the newest images"),
    (">= _FRESH_NS", "> _FRESH_NS", "tag late"),
    (">= _FRESH_NS", ">= _FRESH_NS - 1_000_000", "a tag was seen 149 ms ago"),
    ("not r.session or ", "", "nobody's lease"),
    ("r.session != view.robots[0].session", "False", "another controller's lease"),
    ("lambda r: r.latch != Latch.NONE", "lambda r: False", "drill never cleared"),
    ("not r.at_rest", "False", "wheel turns"),
    ("if edges[row] < 0.0 else", "if False else", "outside, ahead"),
    ("if beside.any():", "if False:", "too close to the wall ahead"),
    ("np.abs(at)).min(axis=1)", "np.abs(at))[:, 0]", "too close to the wall beside"),
    ("np.abs(at)).min(axis=1)", "np.abs(at))[:, 1]", "too close to the wall ahead"),
    ("- bodies[pairs].sum(axis=1)", "- 2 * bodies[pairs[:, 0]]", "two too close"),
    ("free[pairs].max(axis=1)", "free[pairs[:, 0]]", "too close for the wider wheel of the other"),
    ("gaps < free[pairs].sum(axis=1)", "gaps < 0.0",
     test_arming_faults.test_two_without_room_for_both_are_never_away_at_once),
    ("_MARGIN_M + wiggle", "wiggle", "too close to the wall ahead"),
    ("view.now_ns, Latch.DRILL)", "view.now_ns)", "e-stop not answered"),
    ("if all(latched):", "if any(latched):", "e-stop not answered"),
    ("waited_ns >= _ANSWER_NS", "False", "e-stop not answered"),
    ("waited_ns >= _ANSWER_NS", "True", "nothing is wrong"),
    ("clear=True)", "clear=False)", "nothing is wrong"),
    ("if not any(latched):", "if True:", "drill not cleared"),
    ("waited_ns >= _CLEAR_NS", "False", "drill not cleared"),
    ("waited_ns >= _CLEAR_NS", "True", "nothing is wrong"),
]  # fmt: skip

WIGGLE: list[tuple[str, str, By]] = [
    ("view.image != state.image", "True",
     test_arming.test_three_images_of_a_robot_at_rest_are_looked_at_before_the_next_stroke),
    ("if bad is not None:", "if False:", "wheels go on"),
    ("_look(_watch(state, view, poses), view, poses)", "_look(state, view, poses)", "another one turns"),
    ("if travelled > room_m(wheel_radius[row]):", "if False:", "wheels go on"),
    ("(self.images > 0) & away", "away", "nothing is wrong"),
    ("if state.round < 0 and", "if False and", "moved by hand before"),
    ("step[:, 1]) > _MOVED_M", "step[:, 1]) > 9.0", "moved by hand before"),
    ("> _MOVED_RAD", "> 9.0", "turned by hand before"),
    ("view.image_tick <= state.rest_tick", "False", "images from before"),
    ("robot.image == view.image", "True", "tried, and in no image"),
    ("robot.left_told - start.told[0]", "robot.left_told", "no robot has encoders"),
    (">= 0.5 * PROBE_RAD_S", ">= -PROBE_RAD_S", "no command comes"),
    ("driven_ns >= _NO_START_NS", "False", "no command comes"),
    ("robot.at_rest and", "", "no rest"),
    ("_SETTLE_NS if any(_counted(start, robot)) else _COAST_NS", "_SETTLE_NS",
     test_arming.test_robots_that_cannot_tell_whether_they_rest_are_given_time),
    ("if waited_ns < _NO_REST_NS:", "if True:", "no rest"),
    (", means=state.means.forget(list(stale))", "", "nothing is wrong"),
    ("view.now_ns - state.since_ns >= _NO_IMAGE_NS", "False", "never in an image"),
    ("view.now_ns - state.since_ns >= _NO_IMAGE_NS", "True", "nothing is wrong"),
    ("fault = wiring_fault(leg)", "fault = None", "motors stand on the way back"),
    ("fault = fault or gain_fault(mean_of(forth.pop(row), leg))", "forth.pop(row)",
     test_arming.test_a_wheel_radius_that_is_a_fifth_off_is_found),
    ("_before(state, row) == before", "True", test_arming_faults.test_two_exchanges_are_told_apart_by_earlier_rounds),
    ("if len(who) == 1:", "if who:", "another one turns"),
]  # fmt: skip

ROLLED: list[tuple[str, str, By]] = [
    *((f"        (Event.{event}),\n", "", test_rolled.test_every_wiring_is_named) for event in (
        "DID_NOT_MOVE, (l, 0.0)", "LEFT_REVERSED, (-l, r)",
        "RIGHT_REVERSED, (l, -r)", "BOTH_REVERSED, (-l, -r)", "WHEELS_SWAPPED, (r, l)", "WHEELS_SWAPPED, (-r, l)",
        "WHEELS_SWAPPED, (r, -l)", "WHEELS_SWAPPED, (-r, -l)",
    )),
    ("DID_NOT_MOVE, (0.0, r)", "NOTHING, (l, r)", test_rolled.test_every_wiring_is_named),
    ("    if event:\n", "    if False:\n", test_rolled.test_every_wiring_is_named),
    ("any(leg.counted) and abs", "abs", "no robot has encoders"),
    ("any(leg.counted) and abs(ratio - 1.0) > _ENCODER_GAIN", "False", "encoder reversed"),
    ("expected = leg.counted if counts else leg.asked", "expected = leg.asked",
     test_rolled.test_a_gain_is_measured_against_what_the_wheels_turned),
    ("abs(mean - 1.0) > (_MEAN_GAIN", "False and (_MEAN_GAIN", test_rolled.test_a_gain_is_refused_beyond_its_tolerance),
    ("abs(one - 1.0) >", "False and", test_rolled.test_a_gain_is_refused_beyond_its_tolerance),
    ("_MEAN_GAIN if counts else _UNCOUNTED_GAIN", "_MEAN_GAIN",
     test_rolled.test_a_gain_is_refused_beyond_its_tolerance),
    ("_WHEEL_GAIN if counts else _UNCOUNTED_GAIN", "_WHEEL_GAIN",
     test_rolled.test_a_gain_is_refused_beyond_its_tolerance),
]  # fmt: skip


def _noticed(by: By) -> bool:
    if not isinstance(by, str):
        return notices(by, {})
    try:
        if by in HEALTHY:
            test_arming.test_a_healthy_fleet_is_proved(HEALTHY[by])
        else:
            test_arming.test_what_is_wrong_is_named(REFUSED[by])
    except (AssertionError, ZeroDivisionError):
        return True
    return False


def _into_the_lab(monkeypatch: pytest.MonkeyPatch, program: ModuleType) -> None:
    monkeypatch.setattr(Lab, "program", program)


@pytest.mark.parametrize("by", [*HEALTHY, *REFUSED])
def test_nothing_is_noticed_while_every_check_is_there(by: str) -> None:
    assert not _noticed(by)


@pytest.mark.parametrize(("old", "new", "by"), ARMING)
def test_a_check_that_is_taken_out_of_arming_is_missed(
    monkeypatch: pytest.MonkeyPatch, old: str, new: str, by: By
) -> None:
    _into_the_lab(monkeypatch, sabotaged(arming, old, new))
    assert _noticed(by)


@pytest.mark.parametrize(("old", "new", "by"), WIGGLE)
def test_a_check_that_is_taken_out_of_the_wiggle_is_missed(
    monkeypatch: pytest.MonkeyPatch, old: str, new: str, by: By
) -> None:
    monkeypatch.setattr(arming, "wiggle", sabotaged(wiggle, old, new))
    assert _noticed(by)


@pytest.mark.parametrize(("old", "new", "by"), ROLLED)
def test_a_check_that_is_taken_out_of_the_judgement_is_missed(
    monkeypatch: pytest.MonkeyPatch, old: str, new: str, by: By
) -> None:
    program = sabotaged(rolled, old, new)
    for name in ("wiring_fault", "gain_fault"):
        monkeypatch.setattr(wiggle, name, getattr(program, name))
        monkeypatch.setattr(test_rolled, name, getattr(program, name))
    assert _noticed(by)
