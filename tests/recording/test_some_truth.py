"""Runs in which the truth of some robots is known and of others is not: what is said of whom."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from robofleet.bus.keys import TRUTH, key
from robofleet.recording.columns import CSV, write_csv
from robofleet.recording.run import Recording, Run
from robofleet.reports import report
from robofleet.reports.tables import summary_table

Make = Callable[..., Any]
TRUE = ("timed_error_mm", "path_error_mm", "centre_error_mm")


def without(recording: Recording, *robots: str) -> Recording:
    for robot in robots:
        del recording.messages[key("platoon", TRUTH, robot)]
    return recording


@pytest.fixture
def drive_record(story: Make) -> Any:
    drive = story()
    drive.place([0.002, 0.004, 0.006, 0.008])
    drive.aside(0.003)
    return drive


def test_what_is_known_of_a_robot_does_not_depend_on_the_others(drive_record: Any, figures: Make) -> None:
    whole, some = figures(drive_record.recording()), figures(without(drive_record.recording(), "r2"))
    assert (whole["estimated"], some["estimated"]) == ([], ["r2"])
    for name, unknown in zip(TRUE, [{1, 2}, {1}, {1}], strict=True):  # r3 should be behind r2, wherever that truly is
        expected = [None if k in unknown else v for k, v in enumerate(whole[name]["per_robot_mean"])]
        assert some[name]["per_robot_mean"] == expected, name
        known = [value for value in expected if value is not None]
        assert some[name]["mean"] == pytest.approx(sum(known) / len(known), abs=1e-4), name


def test_an_unknown_place_is_the_filters_for_the_spacing_and_no_figure_for_the_gap(
    drive_record: Any, figures: Make
) -> None:
    drive_record.estimate_off = 0.0, 0.02, 0.0
    whole, some = (figures(without(drive_record.recording(), *gone)) for gone in ((), ("r2",)))
    changed = [abs(a - b) for a, b in zip(whole["spacing_m"]["mean"], some["spacing_m"]["mean"], strict=True)]
    assert [change > 0.001 for change in changed] == [True, True, False]
    assert whole["min_gap_mm"] is not None
    assert some["min_gap_mm"] is None, "the smallest of some distances may not be the smallest"


def test_the_filter_is_judged_by_those_whose_truth_is_known(drive_record: Any, figures: Make) -> None:
    drive_record.estimate_off = 0.003, 0.004, 0.0
    s = figures(without(drive_record.recording(), "r1", "r3"))
    assert s["pose_error"]["rms_mm"] == pytest.approx(5)


def test_a_leader_without_truth_has_not_met_a_bound_on_it(drive_record: Any, figures: Make) -> None:
    s = figures(without(drive_record.recording(), "r1", "r3"))
    assert s["timed_error_mm"] is None, "each follows somebody whose place is not known, or is not known itself"
    verdicts = {bound["figure"]: bound["value"] for bound in s["bounds"]}
    assert verdicts["timed_error_mean_mm"] is None
    assert verdicts["path_error_mean_mm"] is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gone", "kind"), [(("r2",), "mixed"), (("r1", "r3"), "mixed"), (("r1", "r2", "r3", "r4"), "real")]
)
def test_table_and_report_name_them_and_show_no_number_that_is_none(
    drive_record: Any, figures: Make, tmp_path: Path, gone: tuple[str, ...], kind: str
) -> None:
    recording = without(drive_record.recording(), *gone)
    summary = figures(recording)
    output = io.StringIO()
    Console(file=output, width=120).print(summary_table(summary, recording.config))
    run = Run(recording)
    table, page = output.getvalue(), report.write(run, summary, tmp_path).read_text()
    write_csv([run], tmp_path / CSV)
    assert f"({kind})" in table
    for text in (" ".join(table.split()), page):
        assert f"o true poses are known of {', '.join(gone)}" in text
        assert not any(word in text for word in ("None", ">nan", " nan"))
    head, *rows = (tmp_path / CSV).read_text().splitlines()
    column = head.split(",").index("true_x_m")
    assert {row.split(",")[3] for row in rows if not row.split(",")[column]} == set(gone)
