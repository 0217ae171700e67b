"""A platoon under a motion capture: where its poses come from, and what happens when they do not come."""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from robofleet.bus.keys import CAMERA, NEWS, POSES, STATE, key
from robofleet.bus.messages import FLEET_POSES, RUN_STATE, TRACKER_NEWS
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S
from robofleet.recording.reading import read
from robofleet.recording.run import Recording
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Event, Phase
from robofleet.tracking.events import TrackerEvent, describe
from tests.runs.realrun import RealRun

MOCAP = SHIPPED / "mocap.yaml"
E = TrackerEvent
SILENT = "faults=[{kind: camera_stalled, at_s: 1, duration_s: 0.3}]"
SHORT = "run.duration_s=3", "run.bounds={}"


class Poses(NamedTuple):
    """What a run said of its poses."""

    news: list[Any]
    poses: list[Any]
    holds: list[Any]  # words of the supervisor: those with which it held the run


def told(recording: Recording) -> Poses:
    def said(topic: Any, layout: Any, name: str = "") -> list[Any]:
        return [layout.decode(p) for p in recording.messages.get(key("mocap", topic, name), ())]

    states = said(STATE, RUN_STATE)
    holds = [after for before, after in itertools.pairwise(states) if after.phase != before.phase]
    return Poses(
        [news for news in said(NEWS, TRACKER_NEWS, CAMERA) if news.event >= E.POSES_SILENT],
        said(POSES, FLEET_POSES, CAMERA),
        [state for state in holds if state.phase == Phase.HOLD],
    )


def in_lockstep(*keys: str) -> tuple[dict[str, Any], Poses]:
    run = Lockstep(load_config(MOCAP, [*SHORT, *keys]))
    outcome, cause = run.run()
    return summary(run.recording, name="mocap", mode="lockstep", outcome=outcome, cause=cause), told(run.recording)


def test_a_platoon_drives_by_bodies_without_tags() -> None:
    s, notices = in_lockstep()
    assert s["outcome"] == "completed"
    assert s["control_error_mm"]["mean"] <= 0.5
    assert s["pose_error"]["rms_mm"] <= 0.5
    stamps = [message.exposure_ns for message in notices.poses]
    assert {later - before for before, later in itertools.pairwise(stamps)} == {10 * MS}
    assert (notices.news, notices.holds) == ([], [])


@pytest.mark.slow
@pytest.mark.parametrize("keys", [(), ("tracker.mocap.up=y", "tracker.mocap.origin.heading_deg=90")])
def test_equal_seeds_give_equal_bytes(keys: tuple[str, ...]) -> None:
    first, other = (in_lockstep("run.duration_s=1", *keys)[0]["trace_hash"] for _ in range(2))
    assert first == other


def judged(figures: Poses) -> None:
    """A silence of 0.3 s was named within 0.25 s, and held the run by its name."""
    silent, back = (
        next(news for news in figures.news if news.event == event) for event in (E.POSES_SILENT, E.POSES_BACK)
    )
    assert silent.value <= 0.25 < back.value
    assert "no poses for 0.1" in describe(silent.event, silent.tag, silent.value)
    before_ns = max(message.exposure_ns for message in figures.poses if message.exposure_ns < silent.stamp_ns)
    assert silent.stamp_ns - before_ns <= 0.25 * S
    assert figures.holds[0].cause == Event.POSES_SILENT


@pytest.mark.slow
def test_a_capture_that_is_silent_for_a_moment_is_named_and_the_run_is_held() -> None:
    judged(in_lockstep(SILENT)[1])


@pytest.mark.long
def test_a_capture_that_is_silent_for_a_moment_is_named_in_a_real_run(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*(word for keys in (*SHORT, SILENT) for word in ("--set", keys)), config=MOCAP)
    run.wait_for(lambda: "the source of the poses went silent" in run.said)
    run.robofleet("stop", "mocap")
    run.ended()
    judged(told(read(run.folder)))


def test_a_body_that_is_lost_stops_its_robot_alone() -> None:
    fault = "faults=[{kind: pose_dropout, robot: r4, at_s: 1, duration_s: 0.5}]"
    s, notices = in_lockstep(fault)
    assert s["outcome"] == "completed"
    assert {stop["robot"] for stop in s["stops"]} == {"r4"}
    assert notices.holds == []
