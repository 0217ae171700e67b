"""The table that ends a run."""

import io
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table

from robofleet.recording.run import Recording
from robofleet.recording.tables import status_table, summary_table
from robofleet.safety.gate import GateStatus

Make = Callable[..., Any]
ERRORS = ("control error", "timed error", "point off the path", "centre off the path")


def rendered(summary: dict[str, Any], table: Callable[[dict[str, Any]], Table] = summary_table) -> str:
    """Return the table as a terminal without colours shows it."""
    output = io.StringIO()
    Console(file=output, width=200, color_system=None).print(table(summary))
    return output.getvalue()


def row(text: str, label: str) -> str:
    """Return the one row of a label."""
    (found,) = [line for line in text.splitlines() if line.strip(" │").startswith(label)]
    return found


def test_the_table_shows_what_was_measured_beside_the_paper(
    story: Make, figures: Make, add_status: Make, add_image: Make
) -> None:
    told = story()
    told.aside(0.003)
    told.control_error[:] = [0.001, 0.002, 0.003, 0.006]
    recording = told.recording()
    add_status(recording, "r2", told.stamp(10), applied=(told.stamp(10) - 21_000_000, told.stamp(10)))
    add_status(recording, "r2", told.stamp(20), gate=GateStatus.NO_ENABLE)
    add_image(recording, told.stamp(10), (1, 2, 3))
    text = rendered(figures(recording))
    for value in ("3.00 (6.0)", "about 5", "1.00  2.00  3.00  6.00"):
        assert value in row(text, "control error")
    assert "3.00 (3.0)" in row(text, "point off the path")
    assert "target 250" in row(text, "spacing,")
    assert "75.0" in row(text, "tags found")
    assert "21.0, 21.0" in row(text, "exposure to wheel")
    assert "r2 at 0.7 s: no enable" in row(text, "robots stopped on the way")
    assert "of 300" in row(text, "overruns")
    assert "not measured" not in text
    assert "(simulation)" in text
    assert "(hardware)" in text


def test_it_fits_a_terminal_of_80_columns(story: Make, figures: Make) -> None:
    output = io.StringIO()
    Console(file=output, width=80, color_system=None).print(summary_table(figures(story().recording())))
    assert "…" not in output.getvalue()
    for label in ERRORS:
        assert row(output.getvalue(), label)


def test_what_was_not_measured_is_said_so(story: Make, figures: Make) -> None:
    text = rendered(figures(Recording(story().config)) | {"outcome": "fault", "cause": "the lamp went out"})
    assert "fault" in text
    assert "the lamp went out" in text
    for label in ERRORS:
        assert "not measured" in row(text, label)
    assert "None" not in text
    assert "overruns" not in text


def test_without_the_truth_the_controllers_own_figures_are_shown(story: Make, figures: Make) -> None:
    told = story()
    told.control_error[:] = 0.004
    text = rendered(figures(told.recording(truth=False)))
    assert "4.00 (4.0)" in row(text, "control error")
    assert "not measured" in row(text, "timed error")
    assert "250.0" in row(text, "spacing,")


def test_a_cause_is_text_and_no_markup(story: Make, figures: Make) -> None:
    summary = figures(Recording(story().config)) | {"outcome": "fault", "cause": "[/red] killed [bold]"}
    assert "[/red] killed [bold]" in rendered(summary)


def test_a_running_arenas_status_says_who_may_move_and_who_is_silent() -> None:
    drives = {"gate": "open", "latch": "none", "battery": 0.934, "age_ms": 12.4, "halted": None}
    stands = {
        "gate": "no enable",
        "latch": "wired stop",
        "battery": None,
        "age_ms": 9.0,
        "halted": "its tag is not seen",
    }
    silent = dict.fromkeys(drives)
    robots = [{"id": f"r{k}"} | robot for k, robot in enumerate((drives, stands, silent), 1)]
    status = {"arena": "lab", "phase": "hold", "cause": "r2: it was moved by hand", "robots": robots}
    where = {"folder": "runs/one", "started": "2026-01-02T03:04:05Z", "pid": 77, "endpoint": "tcp/127.0.0.1:7447"}
    text = rendered(status | where, status_table)
    assert "lab: hold (r2: it was moved by hand)" in text
    assert row(text, "r1").split() == ["r1", "open", "none", "93", "%", "12", "ms", "ago"]
    for said in ("no enable", "wired stop", "unknown", "its tag is not seen"):
        assert said in row(text, "r2")
    assert "silent" in row(text, "r3")
    assert "None" not in text
    assert "the supervisor is silent" in rendered(status | where | {"phase": None, "cause": None}, status_table)
