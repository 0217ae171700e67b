"""What happened stands on one time axis, whoever said it."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.bus.keys import CAMERA, NEWS, key
from robofleet.bus.messages import TRACKER_NEWS, TrackerNews
from robofleet.recording.run import Recording, Run
from robofleet.reports.timeline import CONTROLLER, FAULTS, RUN, TRACKER, Entry, Timeline
from robofleet.safety.supervisor import Event, Phase
from robofleet.tracking.events import NO_TAG, TrackerEvent

Make = Callable[..., Any]
SOON = 0.04  # [s] between two statuses


@pytest.fixture
def recording(story: Make, add_status: Make, add_state: Make) -> Recording:
    """Return a run of 10 s that was armed 3 s before, held from 4 s on and resumed at 6 s."""
    story_ = story()
    states = {-3.0: (Phase.ARMED, Event.START_REQUESTED), 0.0: (Phase.RUNNING, Event.PROVED)}
    states |= {4.0: (Phase.HOLD, Event.HOLD_REQUESTED), 6.0: (Phase.RUNNING, Event.RESUME_REQUESTED)}
    made = Recording(story_.config)
    for k in range(-160, 500):
        t = k * 0.02
        add_status(made, "r1", story_.stamp(0) + round(t * 1e9))
        if round(t, 2) in states:
            add_state(made, *states[round(t, 2)])
    for full, payloads in story_.recording().messages.items():
        for payload in payloads:
            made.add(full, payload)
    return made


def by(timeline: Timeline, who: str) -> list[Entry]:
    return [entry for entry in timeline.entries if entry.who == who]


def test_phases_follow_each_other_at_the_instants_of_what_was_said_around_them(recording: Recording) -> None:
    timeline = Timeline(Run(recording), [])
    phases = [(span.name, pytest.approx(span.t_s, abs=SOON)) for span in timeline.phases]
    assert phases == [("armed", -3.0), ("running", 0.0), ("hold", 4.0), ("running", 6.0)]
    ends = [span.until_s for span in timeline.phases]
    assert ends == [*(span.t_s for span in timeline.phases[1:]), timeline.end_s]
    assert [entry.what for entry in by(timeline, RUN)][2] == "hold: hold requested"
    assert timeline.begin_s == pytest.approx(-3.2)


def test_stops_and_news_are_of_those_whom_they_concern(recording: Recording, story: Make) -> None:
    start = story().stamp(0)
    for at_s, event, tag in ((-2.0, TrackerEvent.TAG_FOUND, 3), (5.0, TrackerEvent.CAMERA_STALLED, NO_TAG)):
        message = TrackerNews(1, 1, start + round(at_s * 1e9), event, tag, 0.25)
        recording.add(key("platoon", NEWS, CAMERA), TRACKER_NEWS.encode(message))
    stop = {"t_s": 7.5, "robot": "r2", "cause": "no enable", "target_ms": None, "output_ms": None}
    timeline = Timeline(Run(recording), [stop])
    assert by(timeline, "r2") == [Entry(7.5, 7.5, "r2", "no enable", stop=True)]
    assert by(timeline, "r3") == [Entry(-2.0, -2.0, "r3", "tag 3 found")]
    assert by(timeline, TRACKER) == [Entry(5.0, 5.0, TRACKER, "camera stalled: no image for 0.25 s")]
    times = [entry.t_s for entry in timeline.entries]
    assert times == sorted(times)


def test_ticks_that_overrun_soon_after_each_other_are_one_entry(recording: Recording) -> None:
    (overruns,) = by(Timeline(Run(recording), []), CONTROLLER)  # one every ten ticks
    assert overruns.what == "29 ticks overrun"
    assert (overruns.t_s, overruns.until_s) == (pytest.approx(10 * 0.033), pytest.approx(290 * 0.033))


def test_faults_that_were_injected_stand_where_they_struck(story: Make) -> None:
    faults = (
        "faults=[{kind: motor_stuck, robot: r2, at_s: 3, duration_s: 2}, {kind: camera_frozen, at_s: 7},"
        " {kind: wired_stop, robot: r1, at_s: 60}]"
    )
    timeline = Timeline(Run(story(faults).recording()), [])
    assert by(timeline, FAULTS) == [
        Entry(3.0, 5.0, FAULTS, "motor stuck (robot r2)"),
        Entry(7.0, timeline.end_s, FAULTS, "camera frozen"),
    ]  # the run ended before the third one


def test_a_run_of_which_nothing_is_known_has_no_entry(story: Make) -> None:
    timeline = Timeline(Run(Recording(story().config)), [])
    assert (timeline.entries, timeline.phases, timeline.begin_s, timeline.end_s) == ([], [], 0.0, 0.0)
