"""Columns of a run: lines that fit a screen and lose no peak, and the table of every value."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.bus.keys import TICK, key
from robofleet.bus.messages import TICK_RECORD
from robofleet.recording.columns import write_csv
from robofleet.recording.measures import line
from robofleet.recording.run import Recording, Run

Make = Callable[..., Any]


@given(st.integers(0, 5000), st.integers(10, 900), st.integers(0, 2**32 - 1))
def test_no_peak_is_lost_however_few_columns_there_are(count: int, columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, y = np.arange(count) * 0.033, rng.normal(size=count) * 10 ** rng.uniform(-3, 3)
    span = 0.0, float(t[-1]) if count else 1.0
    x, seen = line(t, y, span, columns)
    assert len(x) == len(seen) <= max(2 * (columns + 1), min(count, 2 * columns))
    if count:
        assert (seen.min(), seen.max()) == (y.min(), y.max())
        assert (np.diff(x) >= 0).all()
        width = (span[1] - span[0]) / columns
        for peak in (int(y.argmax()), int(y.argmin())):
            drawn_at = x[seen == y[peak]]
            assert (np.abs(drawn_at - t[peak]) <= width + 1e-9).any(), "a peak stands where it was"


def test_a_line_is_broken_where_ticks_are_missing() -> None:
    t = np.concatenate([np.arange(100), np.arange(300, 400)]) * 0.033
    for columns in (50, 1000):
        x, y = line(t, np.ones(200), (0.0, 13.2), columns)
        (broken,) = np.flatnonzero(np.isnan(y))
        assert x[broken - 1] < 3.3 <= 9.9 - 13.2 / 50 <= x[broken + 1]


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open() as text:
        return list(csv.DictReader(text))


def test_the_table_has_a_row_for_every_tick_and_robot_with_units(story: Make, tmp_path: Path) -> None:
    run = story("run.settle_s=0", "run.spacing_settle_s=0", ticks=40)
    run.aside(0.003)
    run.control_error[:, 2] = 0.0015
    write_csv([Run(run.recording())], tmp_path / "m.csv")
    rows = rows_of(tmp_path / "m.csv")
    assert [row["robot"] for row in rows] == ["r1", "r2", "r3", "r4"] * 40
    assert [float(row["t_s"]) for row in rows[::4]] == pytest.approx([k * 0.033 for k in range(40)], abs=1e-9)
    assert [int(row["run_tick"]) for row in rows[::4]] == list(range(40))
    assert {float(row["control_error_mm"]) for row in rows[2::4]} == {1.5}
    assert [float(row["path_error_mm"]) for row in rows] == pytest.approx([3.0] * 160, abs=1e-3)
    assert rows[0]["spacing_mm"] == "", "a leader has nobody before it"
    at = run.centres[7, 1]
    assert [float(rows[29][name]) for name in ("true_x_m", "true_y_m")] == pytest.approx(at.tolist(), rel=1e-5)
    assert [row["saturated"] for row in rows[:6]] == ["0", "0", "0", "0", "1", "0"]
    units = ("_m", "_rad", "_s", "_mm", "_deg", "_ms")
    plain = {
        "tick", "run_tick", "robot", "group", "counts", "failed", "reference_parameter", "saturated", "measured",
        "lost", "filtered", "blocked",
    }  # fmt: skip
    assert all(name in plain or name.endswith(units) for name in rows[0])


def test_what_is_not_known_is_an_empty_cell(story: Make, tmp_path: Path) -> None:
    settled = "run.settle_s=0", "run.spacing_settle_s=0"
    write_csv([Run(story(*settled, ticks=3).recording(truth=False))], tmp_path / "m.csv")
    absent = {"reference_x_m", "reference_y_m", "estimated_path_error_mm", "estimated_spacing_mm"}  # not in this story
    unknown = absent | {
        "centre_error_mm", "true_x_m", "true_y_m", "true_psi_rad", "path_error_mm", "timed_error_mm", "pose_error_mm",
    }  # fmt: skip
    measured = {"left_measured_rad_s", "right_measured_rad_s"}  # no robot said anything
    for row in rows_of(tmp_path / "m.csv"):
        empty = {name for name, cell in row.items() if cell == ""}
        assert empty - {"spacing_mm"} == unknown | {"heading_error_deg", "exposure_to_wheel_ms", *measured}
        assert not any("nan" in cell for cell in row.values())


def test_a_robot_that_no_image_has_shown_yet_has_no_pose(story: Make, tmp_path: Path) -> None:
    recording = story(ticks=3).recording()
    full = key("platoon", TICK)
    first = TICK_RECORD.decode(recording.messages[full][5])
    unseen = first.robots[1]._replace(x_m=0.0, y_m=0.0, psi_rad=0.0, point_x_m=0.08, point_y_m=0.0, lost=1.0)
    robots = (first.robots[0], unseen, *first.robots[2:])
    recording.messages[full][5] = TICK_RECORD.encode(first._replace(robots=robots))
    write_csv([Run(recording)], tmp_path / "m.csv")
    seen, row = rows_of(tmp_path / "m.csv")[:2]
    poses = ("x_m", "y_m", "psi_rad", "point_x_m", "point_y_m", "pose_error_mm", "heading_error_deg")
    assert {name for name in poses if row[name] == ""} == set(poses)
    assert all(seen[name] != "" for name in poses)


def without(recording: Recording, full: str, left_out: slice) -> Recording:
    """Return a recording without some messages of a key."""
    rest = Recording(recording.config)
    for name, payloads in recording.messages.items():
        kept = list(payloads)
        if name == full:
            del kept[left_out]
        for payload in kept:
            rest.add(name, payload)
    return rest


def test_a_run_without_a_tick_has_no_row(story: Make, tmp_path: Path) -> None:
    recording = story(ticks=1).recording()
    write_csv([Run(without(recording, key("platoon", TICK), slice(None)))], tmp_path / "m.csv")
    assert rows_of(tmp_path / "m.csv") == []


def test_times_are_instants_and_go_on_over_a_hold(story: Make) -> None:
    run = story(ticks=60)
    held = slice(25, 45)  # in which no tick is one of the run
    t = Run(without(run.recording(), key("platoon", TICK), held)).clock_time_s
    assert (t[0], t[-1]) == (0.0, pytest.approx(59 * 0.033))
    assert math.isclose(np.diff(t).max(), 21 * 0.033)
