"""Known runs give known figures; what was not measured is None, never 0."""

import itertools
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, NEWS, TICK, key
from robofleet.bus.messages import TRACKER_NEWS, TrackerNews
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S
from robofleet.recording.run import Recording
from robofleet.reports.metrics import remarks
from robofleet.safety.latches import GateStatus
from robofleet.tracking.events import NO_TAG, TrackerEvent
from tests.shipped import PLATOON

Make = Callable[..., Any]
EXACT = pytest.approx(0, abs=1e-3)  # [mm]; figures are rounded to 1e-4


def test_who_follows_exactly_has_no_error(story: Make, figures: Make) -> None:
    s = figures(story().recording())
    for name in ("timed_error_mm", "path_error_mm", "control_error_mm"):
        assert s[name]["per_robot_mean"] == [EXACT] * 4, name
        assert s[name]["max"] == EXACT
    assert s["spacing_m"] == {"mean": [0.25] * 3, "max_deviation_mm": EXACT}
    assert (s["pose_error"]["rms_mm"], s["pose_error"]["heading_rms_deg"]) == (EXACT, EXACT)
    assert s["centre_error_mm"]["mean"] > 0.5, "the centre cuts the corners"


@pytest.mark.parametrize("side", [0.003, -0.003])
def test_3_mm_to_the_side_of_the_path(story: Make, figures: Make, side: float) -> None:
    run = story()
    run.aside(side)
    s = figures(run.recording())
    assert s["path_error_mm"]["per_robot_mean"] == pytest.approx([3.0] * 4, abs=1e-3)
    assert s["path_error_mm"]["max"] == pytest.approx(3.0, abs=1e-3)
    assert s["timed_error_mm"]["per_robot_mean"] == pytest.approx([3.0] * 4, abs=1e-3)


@pytest.mark.parametrize("late", range(4))
def test_2_mm_behind_is_the_error_of_that_robot_alone(story: Make, figures: Make, late: int) -> None:
    run = story()
    run.place([0.002 if row == late else 0.0 for row in range(4)])
    s = figures(run.recording())
    timed = s["timed_error_mm"]["per_robot_mean"]
    assert timed == pytest.approx([2.0 if row == late else 0.0 for row in range(4)], abs=2e-2)
    assert s["path_error_mm"]["max"] == EXACT
    deviation = s["spacing_m"]["max_deviation_mm"]
    assert deviation == pytest.approx(2.0 if late else 0.0, abs=1e-3)


@pytest.mark.parametrize("track", ["point", "centre"])
@pytest.mark.parametrize("origin", [0.0, 1.3, 3.99])
def test_a_run_that_starts_elsewhere_on_the_lap_is_timed_from_there(
    story: Make, figures: Make, origin: float, track: str
) -> None:
    run = story(f"groups.0.settings.track={track}")
    run.origin = origin
    run.place([0.003, 0, 0, 0])
    if track == "centre":  # the centres are where the points of the other run are
        heading = np.stack([np.cos(run.psi), np.sin(run.psi)], axis=-1)
        run.points = run.points + run.config.controller.point_ahead_m * heading
    assert figures(run.recording())["timed_error_mm"]["per_robot_mean"] == pytest.approx([3.0, 0, 0, 0], abs=0.06)


def test_a_tracked_centre_is_measured_at_the_centre(story: Make, figures: Make) -> None:
    run = story("groups.0.settings.track=centre")
    run.points = run.points + run.config.controller.point_ahead_m * np.stack(
        [np.cos(run.psi), np.sin(run.psi)], axis=-1
    )
    s = figures(run.recording())
    assert s["centre_error_mm"]["per_robot_mean"] == [EXACT] * 4
    assert s["timed_error_mm"]["per_robot_mean"] == [EXACT] * 4
    assert s["path_error_mm"]["mean"] > 1


def test_control_error_counts_after_the_settling_time(story: Make, figures: Make) -> None:
    run = story("run.settle_s=2")
    run.control_error[:] = [0.001, 0.002, 0.003, 0.006]
    run.control_error[run.t < 2] = 5.0
    run.control_error[-1, 3] = 0.010
    s = figures(run.recording())
    last = (run.t >= 2).sum()
    means = [1, 2, 3, 6 + 4 / last]
    assert s["control_error_mm"]["per_robot_mean"] == pytest.approx(means, abs=1e-3)
    assert s["control_error_mm"]["mean"] == pytest.approx(np.mean(means), abs=1e-3)
    assert s["control_error_mm"]["max"] == pytest.approx(10)


def test_true_errors_and_spacing_count_after_theirs(story: Make, figures: Make) -> None:
    run = story("run.spacing_settle_s=6")
    exact = figures(run.recording())
    run.points[run.t < 6] += 0.1
    s = figures(run.recording())
    for name in ("timed_error_mm", "path_error_mm", "centre_error_mm", "spacing_m"):
        assert s[name] == exact[name], name


def test_the_smallest_gap_is_between_bodies_and_over_the_whole_run(story: Make, figures: Make) -> None:
    run = story()
    run.points[7, 2] = run.points[7, 0] + 0.08 * np.array([math.cos(run.psi[7, 2]), math.sin(run.psi[7, 2])])
    centres = run.centres
    s = figures(run.recording())
    nearest = min(np.hypot(*(centres[:, i] - centres[:, j]).T).min() for i, j in itertools.combinations(range(4), 2))
    radius = run.config.robots[0].vehicle.body_radius_m
    assert s["min_centre_distance_mm"] == pytest.approx(nearest * 1e3, abs=1e-3)
    assert s["min_gap_mm"] == pytest.approx((nearest - 2 * radius) * 1e3, abs=1e-3)
    assert nearest < 0.15


def test_pose_error_is_the_filters_at_the_tick(story: Make, figures: Make) -> None:
    run = story()
    run.estimate_off = 0.003, -0.004, math.radians(2)
    run.psi[:] = math.pi - math.radians(1)  # the estimate is on the other side of the cut
    s = figures(run.recording())["pose_error"]
    assert (s["rms_mm"], s["max_mm"]) == (pytest.approx(5), pytest.approx(5))
    assert s["heading_rms_deg"] == pytest.approx(2)


def test_the_truth_is_taken_at_the_ticks_instant(story: Make, figures: Make) -> None:
    """Drivers' stamps fall between the ticks: a robot at 0.1 m/s is 1.5 mm further 15 ms later."""
    run = story()
    run.psi[:] = 0.0
    run.points[:] = 0.1 * run.t[:, None, None]
    shifted, exact = run.recording(), run.recording()
    stamp = run.stamp
    run.stamp = lambda k: stamp(k) + 15 * MS
    late = run.recording()
    for full in shifted.messages:
        if "/truth" in full:
            shifted.messages[full] = late.messages[full]
    assert figures(exact)["pose_error"]["rms_mm"] == EXACT
    assert figures(shifted)["pose_error"]["max_mm"] == pytest.approx(1.5 * math.sqrt(2), abs=0.01)


def test_exposure_to_wheel_is_of_every_command_that_reached_one(story: Make, figures: Make, add_status: Make) -> None:
    run = story()
    recording = run.recording()
    taken_ms = {"r1": (19, 21, 29), "r2": (25,)}
    for robot, each in taken_ms.items():
        add_status(recording, robot, run.stamp(-3), applied=(run.stamp(-4) - 900 * MS, run.stamp(-4)))
        for k, ms in enumerate(each):
            at = run.stamp(10 + k) + MS
            for _ in range(1 + 3 * k):  # every status says it again
                add_status(recording, robot, at + 5 * MS, applied=(at - ms * MS, at))
    add_status(recording, "r3", run.stamp(20), applied=(0, run.stamp(20)))  # moved by no image
    latency = figures(recording)["latency_ms"]
    everything = [ms for each in taken_ms.values() for ms in each]
    assert latency["exposure_to_wheel"]["p50"] == pytest.approx(np.percentile(everything, 50))
    assert latency["exposure_to_wheel"]["max"] == pytest.approx(max(everything))
    assert latency["stages"]["exposure_to_tick"] == {"p50": 18.0, "p99": 18.0}


def test_stops_are_gates_that_closed_during_the_run(story: Make, figures: Make, add_status: Make) -> None:
    run = story()
    recording = run.recording()
    closed = GateStatus.NO_COMMAND
    for k, gate in (
        (-4, GateStatus.OPEN), (-3, GateStatus.NO_ENABLE), (1, GateStatus.OPEN), (100, closed), (101, closed),
    ):  # fmt: skip
        add_status(recording, "r2", run.stamp(k), gate=gate)
    for k, gate in ((1, GateStatus.OPEN), (50, GateStatus.NO_ENABLE), (52, GateStatus.OPEN)):
        add_status(recording, "r1", run.stamp(k), gate=gate)
    unseen = {"by_operator": False, "target_ms": None, "output_ms": None}

    def at(tick: int) -> dict[str, Any]:
        return dict.fromkeys(("t_s", "run_time_s", "clock_time_s"), pytest.approx(tick * 0.033))

    assert figures(recording)["stops"] == [
        at(50) | {"robot": "r1", "cause": "no enable"} | unseen,
        at(100) | {"robot": "r2", "cause": "no command"} | unseen,
    ]


def test_what_the_tracker_saw(story: Make, figures: Make, add_image: Make) -> None:
    recording = story().recording()
    for k, tags in enumerate(((1, 2, 3, 4), (1, 2, 4), (1, 2, 3, 4, 77), (3,))):
        add_image(recording, S + k, tags, work_ns=(k + 1) * MS)
    tracker = figures(recording)["tracker"]
    assert (tracker["frames"], tracker["false_ids"], tracker["refused"]) == (4, 1, 3)
    assert tracker["measured_fraction"] == pytest.approx(12 / 16)
    assert tracker["frame_ms"]["p50"] == pytest.approx(2.5)


def test_ticks_overruns_and_what_was_refused(story: Make, figures: Make, add_status: Make) -> None:
    run = story(ticks=301)
    recording = run.recording()
    recording.elapsed_s = 4.95
    add_status(recording, "r2", run.stamp(-1), rejected=1)
    add_status(recording, "r2", run.stamp(5), rejected=6)
    s = figures(recording)
    assert (s["ticks"], s["duration_s"]) == (301, pytest.approx(9.9))
    assert s["real_time_factor"] == pytest.approx(2)
    assert s["tick"]["overruns"] == 30, "those before the run are not its own"
    assert s["tick"]["period_ms"] == pytest.approx(33)
    assert s["tick"]["compute_us"]["p50"] == pytest.approx(50)
    assert s["tick"]["lateness_us"]["max"] == pytest.approx(310)
    assert s["saturated_fraction"] == pytest.approx(1 / (301 * 4), abs=1e-4)
    assert s["rejected"] == {"r1": None, "r2": 5, "r3": None, "r4": None}, "since the run began"


def test_a_prediction_is_no_measurement_and_the_trackers_news_are_kept(
    story: Make, figures: Make, add_image: Make
) -> None:
    run = story()
    recording = run.recording()
    tags = [robot.tag for robot in recording.config.members]
    add_image(recording, run.stamp(3), tags)
    add_image(recording, run.stamp(4), tags, coasted_ns=33 * MS)
    arena = recording.config.arena.name
    for stamp, event, tag in (
        (run.stamp(4), TrackerEvent.TAG_LOST, 2),
        (run.stamp(0), TrackerEvent.CAMERA_BACK, NO_TAG),
    ):
        news = TrackerNews(1, 1, stamp, event, tag, 0.5)
        recording.add(key(arena, NEWS, CAMERA), TRACKER_NEWS.encode(news))
    tracker = figures(recording)["tracker"]
    assert tracker["measured_fraction"] == 0.5
    assert [(e["t_s"], e["event"], e["tag"], e["value"]) for e in tracker["events"]] == [
        (pytest.approx((run.stamp(4) - run.stamp(0)) / 1e9, abs=1e-3), "tag_lost", 2, 0.5),
        (0.0, "camera_back", None, 0.5),
    ]


TRUE_FIGURES = ("timed_error_mm", "path_error_mm", "centre_error_mm", "min_gap_mm", "pose_error")


def test_without_the_truth_true_figures_are_none_and_spacing_is_estimated(story: Make, figures: Make) -> None:
    run = story()
    run.estimate_off = 0.5, 0.5, 0.0
    s = figures(run.recording(truth=False))
    assert {s[name] for name in TRUE_FIGURES} == {None}
    assert s["spacing_m"]["mean"] == pytest.approx([0.25] * 3, abs=1e-4)
    assert s["control_error_mm"]["mean"] == EXACT
    assert s["tracker"] == {
        "frames": 0, "measured_fraction": None, "false_ids": None, "refused": None, "events": None, "frame_ms": None,
    }  # fmt: skip
    assert s["latency_ms"] is None


@pytest.mark.parametrize("ticks", [0, 1, 40])
def test_a_run_too_short_to_settle_measures_nothing(story: Make, figures: Make, ticks: int) -> None:
    s = figures(story(ticks=max(ticks, 1)).recording()) if ticks else figures(Recording(story().config))
    assert s["control_error_mm"] is None
    assert {s[name] for name in TRUE_FIGURES[:3]} == {None}
    assert s["spacing_m"] is None
    assert (s["ticks"], s["stops"]) == (ticks, [])
    json.dumps(s, allow_nan=False)


def test_an_empty_recording_says_that_nothing_was_measured(story: Make, figures: Make) -> None:
    s = figures(Recording(story().config))
    keys = {"version", "config", "seed", "mode", "outcome", "robots", "bounds", "groups", "behaviour", "asked"}
    for name, value in (*s.items(), *s["groups"]["platoon"].items()):
        if name not in keys:
            leaves = value.values() if isinstance(value, dict) else [value]
            assert all(leaf in (None, 0, 0.0, [], 33.0) for leaf in leaves), (name, value)
    never_zero = ("overruns", s["tick"]), ("measured_fraction", s["tracker"]), ("false_ids", s["tracker"])
    for name, figure in (*never_zero, ("saturated_fraction", s), ("filtered_fraction", s), ("real_time_factor", s)):
        assert figure[name] is None, name


def test_messages_of_another_size_are_left_out(story: Make, figures: Make) -> None:
    recording = story().recording()
    before = figures(recording)
    recording.add(key("platoon", TICK), b"\x01rubbish")
    kept = {"messages": before["recording"]["messages"] + 1, "dropped": 0}
    assert figures(recording) == before | {"recording": kept}


def test_one_robot_alone_has_no_spacing(story: Make, figures: Make) -> None:
    run = story("groups.0.robots=[r1]")
    s = figures(run.recording())
    assert (s["spacing_m"], s["min_gap_mm"]) == (None, None)
    assert s["path_error_mm"]["per_robot_mean"] == [EXACT]
    assert s["robots"] == ["r1"]


def errors(timed_mm: float, control_mm: float) -> dict[str, Any]:
    return {"platoon": {"timed_error_mm": {"mean": timed_mm}, "control_error_mm": {"mean": control_mm}}}


def test_robots_that_are_not_at_their_goals_are_named() -> None:
    off = {"r3": {"distance_to_goal_mm": 2.31, "heading_error_deg": 1.44}}
    (line,) = remarks(load_config(PLATOON), {"go_to": {"not_at_goal": off}})
    assert line == "go_to: not within the accuracy of their goals: r3 2.3 mm and 1.4 degrees"
    assert remarks(load_config(PLATOON), {"go_to": {"not_at_goal": {}}, "other": {"not_at_goal": None}}) == []


def test_where_a_robot_is_not_where_its_law_takes_it_the_estimate_is_named() -> None:
    (line,) = remarks(load_config(PLATOON), errors(7.8, 0.2))
    assert line.startswith("the timed error is 7.8 mm, the control error 0.2 mm:")
    assert "`controller.disturbance: estimated`" in line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("figures", "changes"),
    [
        (errors(1.5, 0.2), []),
        (errors(7.8, 5.0), []),
        (errors(7.8, 0.2), ["controller.disturbance=estimated"]),
        ({"platoon": {"timed_error_mm": None, "control_error_mm": None}}, []),
    ],
    ids=["as at home", "the law lags", "it is estimated", "not measured"],
)
def test_where_it_would_not_help_it_is_not_named(figures: dict[str, Any], changes: list[str]) -> None:
    assert remarks(load_config(PLATOON, changes), figures) == []
