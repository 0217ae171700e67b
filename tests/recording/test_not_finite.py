"""A figure that is not finite, or that nobody can have measured, is a gap: in summary, page and columns."""

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.behaviours import described
from robofleet.bus.keys import CAMERA, NEWS, STATUS, TICK, TRUTH, key
from robofleet.bus.layouts import VERSION
from robofleet.bus.messages import TICK_RECORD, TRACKER_NEWS, RobotTick
from robofleet.core.valid_json import dumps, finite
from robofleet.recording.columns import CSV, write_csv
from robofleet.recording.run import Recording, Run
from robofleet.reports import comparison, report
from robofleet.reports.canvas import RunView
from tests.bus.alone import ROBOT_STATUS
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.recording_fixtures import Story

pytestmark = pytest.mark.long

Make = Callable[..., Any]
VALUES = (math.nan, math.inf, -math.inf, 1e308, -1e308)
COLUMNS = RobotTick._fields


def with_ticks(recording: Recording, change: Callable[[np.ndarray], None]) -> Recording:
    """Return a recording whose ticks, all of them as an array (K,), a test has changed."""
    full = key(recording.config.arena.name, TICK)
    messages = recording.messages[full]
    dtype = TICK_RECORD.dtype(len(recording.config.members), described.size(recording.groups))
    ticks = np.frombuffer(b"".join(messages), dtype).copy()
    change(ticks)
    messages[:] = [tick.tobytes() for tick in ticks]
    return recording


def everything(recording: Recording, figures: dict[str, Any], folder: Path) -> tuple[str, list[dict[str, str]]]:
    """Write page and columns, alone and beside itself; returns both, read back."""
    json.loads(dumps(figures), parse_constant=pytest.fail)
    run = Run(recording)
    page = report.write(run, figures, folder).read_text()
    side = comparison.Side("one", RunView(run, figures))
    write_csv([run], folder / CSV)
    comparison.write(side, side, folder / "both.html")
    with (folder / CSV).open() as file:
        return page, list(csv.DictReader(file))


@pytest.mark.parametrize("value", VALUES)
def test_one_figure_of_one_tick_is_a_gap(story: Make, figures: Make, tmp_path: Path, value: float) -> None:
    run = story()
    column = described.names([run.group]).index("r2: control_error_m")

    def change(ticks: np.ndarray) -> None:
        ticks["figures"][100, column] = value

    whole = figures(run.recording())
    recording = with_ticks(run.recording(), change)
    gapped = figures(recording)
    assert gapped == whole, "the other ticks are as they were"
    page, rows = everything(recording, gapped, tmp_path)
    assert "nan" not in re.sub(r"<svg.*?</svg>|<style.*?</style>", "", page, flags=re.DOTALL)
    assert [row["control_error_mm"] for row in rows].count("") == 1


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("seed", range(3))
def test_figures_of_any_tick_are_gaps(story: Make, figures: Make, tmp_path: Path, value: float, seed: int) -> None:
    rng = np.random.default_rng(seed)

    def change(ticks: np.ndarray) -> None:
        for column in COLUMNS:
            ticks["items"][column][rng.random(ticks["items"].shape) < 0.05] = value
        ticks["figures"][rng.random(ticks["figures"].shape) < 0.05] = value

    recording = with_ticks(story().recording(), change)
    _, rows = everything(recording, figures(recording), tmp_path)
    cells = [cell for row in rows for name, cell in row.items() if name not in ("robot", "group") and cell]
    assert all(math.isfinite(float(cell)) for cell in cells)


@pytest.mark.parametrize("column", COLUMNS)
def test_a_column_without_a_figure_was_not_measured(story: Make, figures: Make, tmp_path: Path, column: str) -> None:
    def change(ticks: np.ndarray) -> None:
        ticks["items"][column] = math.nan

    recording = with_ticks(story(ticks=30).recording(truth=False), change)
    everything(recording, figures(recording), tmp_path)


@pytest.mark.parametrize("field", ["stamp_ns", "exposure_ns", "lateness_ns", "compute_ns", "run_tick", "overruns"])
@pytest.mark.parametrize("seed", range(2))
def test_whole_numbers_that_cannot_be_end_no_report(
    story: Make, figures: Make, tmp_path: Path, field: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)

    def change(ticks: np.ndarray) -> None:
        limits = np.iinfo(ticks.dtype[field])
        where = rng.random(len(ticks)) < 0.2
        ticks[field][where] = rng.choice(np.array([limits.min, limits.max, 0, 7], ticks.dtype[field]), where.sum())

    recording = with_ticks(story(ticks=60).recording(), change)
    everything(recording, figures(recording), tmp_path)


@pytest.mark.parametrize("ends", [("min", "max"), ("max", "min")])
def test_stamps_from_one_end_of_time_to_the_other_end_no_report(
    story: Make, figures: Make, tmp_path: Path, ends: tuple[str, str]
) -> None:
    def change(ticks: np.ndarray) -> None:
        limits = np.iinfo(ticks.dtype["stamp_ns"])
        ticks["stamp_ns"][[0, -1]] = [getattr(limits, end) for end in ends]

    recording = with_ticks(story(ticks=60).recording(), change)
    everything(recording, figures(recording), tmp_path)


@pytest.mark.parametrize(
    ("layout", "topic"), [(TRUTH_LAYOUT, (TRUTH, "r2")), (ROBOT_STATUS, (STATUS, "r2")), (TRACKER_NEWS, (NEWS, CAMERA))]
)
@pytest.mark.parametrize("seed", range(4))
def test_messages_of_any_bytes_end_no_report(
    story: Make, figures: Make, tmp_path: Path, layout: Any, topic: Any, seed: int, add_status: Make
) -> None:
    run: Story = story(ticks=60)
    recording, rng = run.recording(), np.random.default_rng(seed)
    for k in range(0, 60, 5):
        add_status(recording, "r1", run.stamp(k), applied=(run.stamp(k) - 19_000_000, run.stamp(k)))
    for _ in range(50):
        data = bytearray(rng.bytes(layout.size))
        data[0] = VERSION
        recording.add(key(run.config.arena.name, *topic), bytes(data))
    everything(recording, figures(recording), tmp_path)


@pytest.mark.parametrize("value", VALUES[:3])
def test_json_that_is_written_has_null_for_it(value: float) -> None:
    tree = {"a": [1.0, value, {"b": (value, "NaN", 7, None, True)}]}
    assert finite(tree) == {"a": [1.0, None, {"b": [None, "NaN", 7, None, True]}]}
    for text in (dumps(tree), dumps(tree, indent=1), dumps(tree, compact=True)):
        assert json.loads(text, parse_constant=pytest.fail) == finite(tree)
