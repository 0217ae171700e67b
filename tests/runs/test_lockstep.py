"""The whole platoon in one process: what the paper asks for, bounded; and the same bytes for the same seed."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.bus.keys import COMMAND, STATUS
from robofleet.recording.run import Recording
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from tests.robots import stalls

Summary = dict[str, Any]
RunOf = Callable[..., Summary]
ROBOTS = ["r1", "r2", "r3", "r4"]


@pytest.fixture(scope="module")
def with_camera(lockstep: RunOf) -> Summary:
    """Return a run with the camera image in the loop."""
    return lockstep("run.duration_s=10")


def test_a_run_with_the_camera_completes_without_a_stop(with_camera: Summary) -> None:
    s = with_camera
    assert (s["outcome"], s["cause"], s["stops"]) == ("completed", None, [])
    assert s["robots"] == ROBOTS
    assert s["rejected"] == dict.fromkeys(ROBOTS, 0)
    assert s["tick"]["overruns"] == 0
    assert s["ticks"] == round(10 / 0.033) + 1
    assert s["duration_s"] == pytest.approx(10, abs=0.033)
    assert s["saturated_fraction"] < 0.02
    assert s["min_gap_mm"] > 50


def test_the_platoon_is_controlled(with_camera: Summary) -> None:
    s = with_camera
    assert s["control_error_mm"]["mean"] <= 1.0
    assert max(s["control_error_mm"]["per_robot_mean"]) <= 1.5
    assert s["timed_error_mm"]["per_robot_mean"][0] <= 8.0
    assert s["path_error_mm"]["mean"] <= 4.0
    assert s["spacing_m"]["max_deviation_mm"] <= 12.0
    assert s["spacing_m"]["mean"] == pytest.approx([0.25] * 3, abs=0.005)


def test_the_robots_are_not_ideal(with_camera: Summary) -> None:
    """Bounds from above prove nothing of a simulation in which nothing goes wrong."""
    assert with_camera["control_error_mm"]["mean"] > 0.02
    assert with_camera["path_error_mm"]["mean"] > 0.1
    assert with_camera["pose_error"]["rms_mm"] > 0.01


def test_the_leader_is_where_it_should_be_now(with_camera: Summary) -> None:
    """At 0.1 m/s a delay that is not predicted costs a millimetre every 10 ms."""
    assert with_camera["timed_error_mm"]["per_robot_mean"][0] <= 3.0


def test_every_robot_is_seen_where_it_is(with_camera: Summary) -> None:
    s = with_camera
    assert s["pose_error"]["rms_mm"] <= 0.6
    assert s["pose_error"]["heading_rms_deg"] <= 0.4
    assert s["tracker"]["measured_fraction"] > 0.98
    assert s["tracker"]["false_ids"] == 0
    assert s["ticks"] < s["tracker"]["frames"] < s["ticks"] + 50, "also during the checks before the start"


def test_a_locked_exposure_reaches_the_wheels_soon_after_its_tick(with_camera: Summary) -> None:
    latency = with_camera["latency_ms"]
    lead_ms, bus_ms = 18, 1
    assert lead_ms < latency["exposure_to_wheel"]["p50"] <= lead_ms + 2 * bus_ms
    assert latency["exposure_to_wheel"]["p99"] <= 25
    assert latency["stages"]["exposure_to_tick"]["p50"] == pytest.approx(lead_ms)
    assert latency["stages"]["exposure_to_poses"]["p99"] < lead_ms


@pytest.mark.slow
def test_a_camera_of_its_own_rate_beats_against_the_ticks(lockstep: RunOf) -> None:
    s = lockstep("run.duration_s=5", "camera.trigger=free")
    latency = s["latency_ms"]["exposure_to_wheel"]
    assert s["outcome"] == "completed"
    assert latency["p99"] <= 50
    assert latency["p99"] - latency["p50"] > 5
    assert s["control_error_mm"]["mean"] <= 1.0


def test_the_same_seed_gives_the_same_bytes(truth: RunOf) -> None:
    first, again, other = (truth("run.duration_s=5", f"run.seed={seed}")["trace_hash"] for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.slow
def test_the_camera_too_gives_the_same_bytes(lockstep: RunOf) -> None:
    first, again = (lockstep("run.duration_s=1")["trace_hash"] for _ in range(2))
    assert first == again


@pytest.mark.slow
def test_euler_amplifies_noise_from_robot_to_robot(truth: RunOf) -> None:
    def growth(integrator: str) -> float:
        means = truth("run.duration_s=25", f"controller.integrator={integrator}")["control_error_mm"]["per_robot_mean"]
        return float(means[3] / means[0])

    assert growth("euler") >= 3
    assert growth("exact") <= 1.5


@pytest.mark.slow
def test_a_tracked_centre_stays_on_the_path(truth: RunOf) -> None:
    point, centre = (truth("run.duration_s=25", f"groups.0.settings.track={track}") for track in ("point", "centre"))
    assert centre["centre_error_mm"]["mean"] <= point["centre_error_mm"]["mean"] / 2
    assert centre["path_error_mm"]["mean"] > point["path_error_mm"]["mean"]


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["r1", *(pytest.param(robot, marks=pytest.mark.long) for robot in ("r2", "r3"))])
def test_nobody_drives_into_a_robot_that_stalls(truth: RunOf, robot: str) -> None:
    s = truth("run.duration_s=22", stalls(robot, 12, 17))
    assert s["outcome"] == "completed"
    assert 110 <= s["min_centre_distance_mm"] < 185  # they did come nearer than at the start
    assert s["timed_error_mm"]["per_robot_mean"][ROBOTS.index(robot)] > 10


@pytest.mark.slow
def test_a_fifth_of_the_poses_may_be_missing(truth: RunOf) -> None:
    s = truth("run.duration_s=20", "tracker.truth.dropout=0.2")
    assert s["outcome"] == "completed"
    assert 0.7 < s["tracker"]["measured_fraction"] < 0.9
    assert s["control_error_mm"]["mean"] <= 2.0
    assert s["path_error_mm"]["mean"] <= 6.0
    assert s["spacing_m"]["max_deviation_mm"] <= 20.0


@pytest.mark.slow
def test_robots_that_are_never_seen_are_named_and_turn_no_wheel(platoon_of: Callable[..., Any]) -> None:
    run = Lockstep(platoon_of("tracker.source=truth", "tracker.truth.dropout=1.0"))
    outcome, cause = run.run()
    assert outcome == "fault"
    assert cause is not None
    assert all(word in cause for word in (*ROBOTS, "tracker does not see"))
    s = summary(run.recording, name="platoon", mode="lockstep", outcome=outcome, cause=cause)
    assert (s["ticks"], s["control_error_mm"], s["latency_ms"]) == (0, None, None)
    for robot in ROBOTS:
        statuses = run.recording.of_robot(STATUS, robot)
        assert len(statuses) > 100
        assert not statuses["left_angle_rad"].any()
        assert not statuses["right_angle_rad"].any()
        assert not run.recording.of_robot(COMMAND, robot)["left_rad_s"].any()


@pytest.mark.slow
def test_ctrl_c_leaves_a_summary_of_what_was_recorded_until_then(platoon_of: Callable[..., Any]) -> None:
    seconds = iter(range(2))

    def watch(_recording: Recording, _phase: str) -> None:
        if next(seconds, None) is None:
            raise KeyboardInterrupt

    run = Lockstep(platoon_of("tracker.source=truth", "run.duration_s=60"))
    outcome, cause = run.run(watch)
    assert (outcome, cause) == ("stopped", "the operator interrupted")
    figures = summary(run.recording, name="platoon", mode="lockstep", outcome=outcome, cause=cause)
    assert 2.5 < figures["duration_s"] < 4.0


@pytest.mark.slow
def test_several_robots_to_a_driver_process_drive_as_well(truth: RunOf) -> None:
    each, pairs = truth("run.duration_s=10"), truth("run.duration_s=10", "drivers.robots_per_process=2")
    assert (pairs["outcome"], pairs["stops"], pairs["trace_hash"] != each["trace_hash"]) == ("completed", [], True)
    for error in ("control_error_mm", "timed_error_mm", "path_error_mm"):
        assert pairs[error]["mean"] == pytest.approx(each[error]["mean"], abs=0.05)
