"""What a run's messages say of a busy machine: in its summary, its verdict, its causes and its log."""

from collections.abc import Callable
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from robofleet.bus.keys import BUSY, key
from robofleet.bus.messages import BUSY_MACHINE, BusyMachine, Late, RobotState, RunState
from robofleet.core.clock import MS
from robofleet.recording.lines import Level, busy_line
from robofleet.recording.run import Recording, Run
from robofleet.recording.state_words import state_words
from robofleet.reports.report import write
from robofleet.reports.tables import summary_table
from robofleet.safety.busy import DRIVERS, SUPERVISOR, TRACKER
from robofleet.safety.supervisor import NOBODY, Event, Phase

Make = Callable[..., Any]
ROBOTS = ("r1", "r2", "r3", "r4")
LATE = (Late(TRACKER, 310 * MS, 250 * MS), Late(DRIVERS + 1, 120 * MS, 0), Late(SUPERVISOR, 70 * MS, 0))
BUSY_NOW = BusyMachine(1, 9, Event.TRACKER_SILENT, 1, 3, 1, 2, 6.1, LATE)
HELD = RunState(1, 1, Phase.HOLD, Event.TRACKER_SILENT, NOBODY, 0.0, 0, (RobotState(0, 0, 0),) * 4)
VERDICT = (
    "This machine was busy: load 8.2 on 2 cores, the tracker was late by 310 ms, the driver of r2 was late by 120 ms, "
    "the supervisor was late by 70 ms. The checks before the start began anew once. "
    "The run was held and went on by itself 3 times."
)


@pytest.fixture
def busy(story: Make) -> Recording:
    """Return the recording of a run on a busy machine, with bytes among its messages that nobody can read."""
    recording: Recording = story().recording()
    earlier = BUSY_NOW._replace(seq=8, resumed=0, attempts=0, load=8.2, late=LATE[:1])
    for payload in (BUSY_MACHINE.encode(earlier), b"something else", BUSY_MACHINE.encode(BUSY_NOW), b""):
        recording.add(key(recording.config.arena.name, BUSY), payload)
    return recording


def test_the_summary_says_who_was_late_by_how_much(busy: Recording, figures: Make) -> None:
    assert figures(busy)["busy_machine"] == {
        "resumed": 3, "armed_again": 1, "load": 8.2, "cores": 2,
        "late_s": {"tracker": 0.31, "driver-r2": 0.12, "supervisor": 0.07}, "words": VERDICT,
    }  # fmt: skip


def test_a_machine_that_was_not_busy_is_null(story: Make, figures: Make) -> None:
    assert figures(story().recording())["busy_machine"] is None


@pytest.mark.slow
def test_the_report_and_the_table_say_it(busy: Recording, figures: Make, tmp_path: Any) -> None:
    summary = figures(busy)
    assert VERDICT in write(Run(busy), summary, tmp_path).read_text()
    shown = StringIO()
    Console(file=shown, width=200).print(summary_table(summary, busy.config))
    assert VERDICT in " ".join(shown.getvalue().split())


def test_a_stop_that_load_explains_says_so_instead_of_pointing_to_a_log() -> None:
    assert state_words(HELD, BUSY_NOW, ROBOTS).advice == (
        "the tracker went silent, or its poses are late "
        "(this machine was busy: load 6.1 on 2 cores, the tracker was late by 250 ms): "
        "end other programs that keep this machine busy"
    )
    assert state_words(HELD, BUSY_NOW, ROBOTS).goes_on


@pytest.mark.parametrize("message", [None, BUSY_NOW._replace(cause=Event.NOTHING, goes_on=0)])
def test_a_stop_that_load_does_not_explain_is_told_as_ever(message: BusyMachine | None) -> None:
    why = "the tracker went silent, or its poses are late"
    assert state_words(HELD, message, ROBOTS).advice == f"{why}: its log is in the run's folder"
    assert not state_words(HELD, message, ROBOTS).goes_on
    by_hand = HELD._replace(cause=Event.POSE_JUMPED, robot=1)
    assert state_words(by_hand, BUSY_NOW, ROBOTS).advice == "r2: it was moved by hand: put it back at its start"
    assert not state_words(HELD._replace(phase=Phase.RUNNING), BUSY_NOW, ROBOTS).goes_on


def test_the_log_says_it_once_as_a_warning() -> None:
    level, who, words = busy_line(BUSY_NOW, ROBOTS)
    assert (level, who) == (Level.WARNING, "supervisor")
    assert words.startswith("this machine is busy: load 6.1 on 2 cores, the tracker was late by 310 ms, ")
