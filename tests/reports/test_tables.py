"""The table that ends a run."""

import io
import re
from collections.abc import Callable
from typing import Any

import pytest
from rich.console import Console

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.recording.run import Recording
from robofleet.reports.tables import proofs_table, status_table, summary_table
from robofleet.safety.latches import GateStatus
from robofleet.safety.supervisor import Event, Phase
from tests.recording_fixtures import PLATOON

Make = Callable[..., Any]
ERRORS = ("control error", "timed error", "path error", "centre error")


@pytest.fixture(scope="module")
def config() -> Config:
    return load_config(PLATOON)


def printed(shown: Any, width: int = 200) -> str:
    """Return something as a terminal without colours shows it."""
    output = io.StringIO()
    Console(file=output, width=width, color_system=None).print(shown)
    return output.getvalue()


def row(text: str, label: str) -> str:
    """Return the one row of a label."""
    (found,) = [line for line in text.splitlines() if line.strip(" │").startswith(label)]
    return found


def test_the_table_shows_what_was_measured_beside_the_paper(
    story: Make, figures: Make, add_status: Make, add_image: Make
) -> None:
    run = story()
    run.aside(0.003)
    run.control_error[:] = [0.001, 0.002, 0.003, 0.006]
    recording = run.recording()
    add_status(recording, "r2", run.stamp(10), applied=(run.stamp(10) - 21_000_000, run.stamp(10)))
    add_status(recording, "r2", run.stamp(20), gate=GateStatus.NO_ENABLE)
    add_image(recording, run.stamp(10), (1, 2, 3))
    text = printed(summary_table(figures(recording), run.config))
    for value in ("3.00 (6.0)", "about 5", "1.00  2.00  3.00  6.00"):
        assert value in row(text, "control error")
    assert "3.00 (3.0)" in row(text, "path error")
    assert "250.5" in row(text, "spacing, mm (of 250)")
    assert "75.0" in row(text, "tags found")
    assert "21.0, 21.0" in row(text, "exposure to wheel")
    assert "1 unrequested stop:\n    r2 at 0.7 s run time: no permission of the supervisor arrived\n" in text
    assert "of 300" in row(text, "overruns")
    assert "not measured" not in text
    assert "(simulation)" in text
    assert "(hardware)" in text


def test_robots_figures_stand_below_their_names_however_large_they_are(story: Make, figures: Make) -> None:
    run = story()
    run.control_error[:] = [0.1, 0.02, 1.5, 0.003]
    text = printed(summary_table(figures(run.recording()), run.config))
    names, values = (
        re.finditer(what, row(text, label)) for label, what in (("figure ", r"r\d"), ("control", r"[\d.]+"))
    )
    assert {name.end() for name in names} <= {value.end() for value in values}


@pytest.mark.parametrize(("width", "left_out"), [(120, ""), (80, ""), (60, "the paper, each robot")])
def test_it_fits_a_terminal_and_says_what_it_leaves_out(story: Make, figures: Make, width: int, left_out: str) -> None:
    run = story()
    text = printed(summary_table(figures(run.recording()), run.config), width)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    for label in ERRORS:
        assert re.search(r"\d\.\d\d \(\d\.\d\)", row(text, label))
    assert ("r4" in text) == ("hardware" in text) == (not left_out)
    assert left_out in text
    assert ("not shown" in text) == bool(left_out)


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("change", "papers"),
    [("run.seed=2", True), ("controller.integrator=euler", True), ("groups.0.settings.spacing_m=0.3", False),
     ("groups.0.robots=[r1, r2, r3]", False), ("controller.alpha=30", False),
     ("groups.0.settings.path.knots.0.at_m=[-1.15, 0.56]", False)],
)  # fmt: skip
def test_the_paper_is_beside_its_own_platoon_alone(story: Make, figures: Make, change: str, papers: bool) -> None:
    run = story(change)
    text = printed(summary_table(figures(run.recording()), run.config))
    assert ("the paper" in text) == ("about 5" in text) == papers


def test_an_operators_hold_is_told_from_a_stop_by_itself(
    story: Make, figures: Make, add_status: Make, add_state: Make
) -> None:
    run = story()
    recording = run.recording()
    add_state(recording, Phase.RUNNING, Event.PROVED)
    for robot in ("r1", "r2"):
        add_status(recording, robot, run.stamp(10))
    add_state(recording, Phase.HOLD, Event.HOLD_REQUESTED)
    for robot in ("r1", "r2"):
        add_status(recording, robot, run.stamp(20), gate=GateStatus.NO_ENABLE)
    text = printed(summary_table(figures(recording), run.config))
    assert "unrequested" not in text
    assert "The operator stopped r1, r2 at 0.7 s run time: hold requested\n" in text


@pytest.mark.parametrize("width", [60, 80])
def test_what_was_proved_fits_a_terminal(width: int) -> None:
    rows = [("the time from mid-exposure to the tick", "0.018 s", ">= 0.006 s", "33%")]
    rows += [("the path's smallest derivative", "1.021 m a side", ">= 0.01873 m a side", "2%")]
    text = printed(proofs_table("lab.yaml can run", rows), width)
    assert all(cell in text for _, *cells in rows for cell in cells[:2])
    assert ("33%" in text) != ("used: not shown" in text)
    assert max(map(len, text.splitlines())) <= width


def test_what_was_not_measured_is_said_so(figures: Make, config: Config) -> None:
    text = printed(summary_table(figures(Recording(config)) | {"outcome": "fault", "cause": "a lamp"}, config))
    assert "story: ended by a fault after 0.0 s run time" in text
    for label in ERRORS:
        assert "not measured" in row(text, label)
    assert "None" not in text
    assert "overruns" not in text


def test_without_the_truth_the_controllers_own_figures_are_shown(story: Make, figures: Make) -> None:
    run = story()
    run.control_error[:] = 0.004
    text = printed(summary_table(figures(run.recording(truth=False)), run.config))
    assert "4.00 (4.0)" in row(text, "control error")
    assert "not measured" in row(text, "timed error")
    assert "250.0" in row(text, "spacing,")


def test_a_name_is_text_and_no_markup(figures: Make, config: Config) -> None:
    summary = figures(Recording(config)) | {"config": "[/red] mine [bold]"}
    assert "[/red] mine [bold]" in printed(summary_table(summary, config))


def test_a_running_arenas_status_says_who_may_move_and_who_is_silent() -> None:
    drives = {"gate": "open", "latch": "none", "battery": 0.934, "age_ms": 12.4, "halted": None}
    stands = {"gate": "no enable", "latch": "wired stop", "battery": None, "age_ms": 9.0, "halted": "it is not seen"}
    silent = dict.fromkeys(drives)
    robots = [{"id": f"r{k}"} | robot for k, robot in enumerate((drives, stands, silent), 1)]
    status = {"arena": "lab", "phase": "hold", "cause": "r2: it was moved by hand", "robots": robots}
    where = {"folder": "runs/one", "started": "2026-01-02T03:04:05Z", "pid": 77, "endpoint": "tcp/127.0.0.1:7447"}
    text = printed(status_table(status | where))
    assert "lab: hold (r2: it was moved by hand)" in text
    assert row(text, "r1").split() == ["r1", "open", "none", "93", "%", "12", "ms", "ago"]
    for words in ("no enable", "wired stop", "unknown", "it is not seen"):
        assert words in row(text, "r2")
    assert "silent" in row(text, "r3")
    assert "None" not in text
    assert "the supervisor is silent" in printed(status_table(status | where | {"phase": None, "cause": None}))
