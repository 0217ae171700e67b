"""Two runs side by side: which is better, by how much, and which key made the difference."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robofleet.recording.run import Recording, Run
from robofleet.reports import comparison
from robofleet.reports.canvas import RunView
from robofleet.reports.comparison import Side
from tests.reports.test_report import kept, plots, robofleet, words

Make = Callable[..., Any]
OVERLAYS = ["Control error", "Timed error", "Path error", "Centre error", "Spacing", "Pose error"]
__all__ = ["kept"]


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the plots out: they take their time."""
    monkeypatch.setattr(comparison, "overlays", lambda sides: ())


@pytest.fixture
def compared(figures: Make, tmp_path: Path) -> Callable[[Recording, Recording], str]:
    def write(first: Recording, second: Recording) -> str:
        sides = []
        for name, recording in (("one", first), ("other", second)):
            sides.append(Side(name, RunView(Run(recording), figures(recording))))
        comparison.write(*sides, tmp_path / "page.html")
        return (tmp_path / "page.html").read_text()

    return write


def row(page: str, label: str) -> list[str]:
    (found,) = [cells for cells in re.findall(r"<tr>(.*?)</tr>", page) if f"<td>{label}</td>" in cells]
    return re.findall(r"<td[^>]*>(.*?)</td>", found)


@pytest.mark.usefixtures("plain")
def test_the_second_run_is_better_or_worse_where_that_has_a_meaning(story: Make, compared: Make) -> None:
    first, second = story(), story()
    first.aside(0.002)
    second.aside(0.003)
    first.control_error[:], second.control_error[:] = 0.004, 0.001
    page = compared(first.recording(), second.recording())
    assert row(page, "path error, mean, mm")[1:] == ["2", "3", "+1", "worse by 50 %"]
    assert row(page, "control error, mean, mm")[1:] == ["4", "1", "-3", "better by 75 %"]
    assert row(page, "ticks overrun")[-1] == "the same"
    assert row(page, "tick late by, p99, us")[-1] == "", "the machine's load is neither"
    assert row(page, "exposure to wheel, p99, ms")[1:] == ["-", "-", "", "not measured in both"]
    assert 'class="bad">worse by 50 %' in page
    assert 'class="good">better by 75 %' in page


@pytest.mark.usefixtures("plain")
def test_more_is_better_for_the_gap_of_bodies(story: Make, compared: Make) -> None:
    near, far = story("groups.0.settings.spacing_m=0.25"), story("groups.0.settings.spacing_m=0.3")
    page = compared(near.recording(), far.recording())
    assert row(page, "smallest gap of bodies, mm")[-1].startswith("better")


@pytest.mark.usefixtures("plain")
def test_keys_that_differ_are_listed_and_no_others(story: Make, compared: Make) -> None:
    page = compared(story().recording(), story("controller.alpha=30", "robots.2.tag=9").recording())
    keys = re.findall(r"<td>([a-z_]+\.[a-z0-9_.]+)</td>", page)
    assert keys == ["robots.2.tag", "controller.alpha"]
    assert row(page, "controller.alpha")[1:] == ["45", "30"]
    assert "the same configuration, key by key" in words(compared(story().recording(), story().recording()))


@pytest.mark.slow
def test_plots_lie_over_each_other_even_of_different_fleets(story: Make, compared: Make) -> None:
    page = compared(story().recording(), story("groups.0.robots=[r1, r2]", ticks=40).recording())
    assert plots(page) == ["Paths", *OVERLAYS]


@pytest.mark.slow
def test_a_run_that_measured_nothing_is_set_beside_another(story: Make, compared: Make) -> None:
    page = compared(story().recording(), Recording(story().config))
    assert row(page, "path error, mean, mm")[-1] == "not measured in both"
    assert "Control error" in plots(page)


@pytest.mark.slow
def test_the_command_writes_into_the_first_runs_folder_or_where_it_is_told(
    story: Make, kept: Make, tmp_path: Path
) -> None:
    first, other = (kept(story(ticks=20), name) for name in ("one", "other"))
    result = robofleet("report", first, other)
    assert (result.exit_code, result.stdout.strip()) == (0, str(first / "compare-other.html"))
    result = robofleet("report", first, other / "run.mcap", "--out", tmp_path / "new" / "both.html")
    assert (result.exit_code, result.stdout.strip()) == (0, str(tmp_path / "new" / "both.html"))
    assert (tmp_path / "new" / "both.html").stat().st_size > 10_000
