"""Run time and clock time of a run that was held, and which of its ticks count."""

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from robofleet.bus.keys import TICK, key
from robofleet.bus.messages import TICK_RECORD
from robofleet.core.clock import MS
from robofleet.recording.columns import write_csv
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.run import Recording, Run
from robofleet.recording.run_clock import LiveClock, time_words
from robofleet.reports.metrics import summary
from robofleet.reports.sampled import look, looks
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase
from tests.recording import recorded

HOLD_S = 1.5
FIGURES = ["control_error_mm", "timed_error_mm", "path_error_mm", "centre_error_mm"]


@pytest.fixture(scope="module")
def held() -> Recording:
    """Return a run of the platoon that was held after two seconds, and went on."""
    run = Lockstep(recorded.config("run.settle_s=0.5", "run.spacing_settle_s=1.2"))
    run.request(b"start")
    assert run.advance(30.0, lambda: run.status.phase is Phase.RUNNING)
    run.advance(2.0)
    run.request(b"hold")
    run.advance(HOLD_S)
    run.request(b"resume")
    run.advance(2.0)
    run.request(b"stop")
    run.advance(0.5)
    run.close()
    return run.recording


@pytest.fixture(scope="module")
def rows(held: Recording, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, str]]:
    file: Path = tmp_path_factory.mktemp("held") / "metrics.csv"
    write_csv([Run(held)], file)
    with file.open() as text:
        return list(csv.DictReader(text))


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


def test_the_mean_of_what_counts_is_the_summarys(held: Recording, rows: list[dict[str, str]]) -> None:
    figures = summary(held, name="held", mode="lockstep", outcome="stopped", cause=None)
    counts = column(rows, "counts") == 1
    robots = np.array([row["robot"] for row in rows])
    for name in FIGURES:
        values, own = column(rows, name), figures[name]
        assert own["mean"] == pytest.approx(np.nanmean(values[counts]), abs=6e-5), name
        assert own["max"] == pytest.approx(np.nanmax(np.abs(values[counts])), rel=1e-5), name
        each = [np.nanmean(values[counts & (robots == robot)]) for robot in figures["robots"]]
        assert own["per_robot_mean"] == pytest.approx(each, abs=6e-5), name
    spacing = [column(rows, "spacing_mm")[counts & (robots == robot)] for robot in figures["robots"][1:]]
    assert figures["spacing_m"]["mean"] == pytest.approx([np.nanmean(own) / 1e3 for own in spacing], abs=6e-6)
    running = column(rows, "run_tick") >= 0
    off = column(rows, "pose_error_mm")[running]
    assert figures["pose_error"]["rms_mm"] == pytest.approx(np.sqrt(np.nanmean(off**2)), abs=6e-5)
    for name in ("saturated", "filtered"):
        assert figures[f"{name}_fraction"] == pytest.approx(np.mean(column(rows, name)[running] > 0), abs=6e-5)


def test_every_tick_since_the_start_has_a_row_also_in_the_hold(rows: list[dict[str, str]]) -> None:
    ticks = column(rows, "tick")[::4]
    assert (np.diff(ticks) == 1).all()
    held_rows = column(rows, "run_tick")[::4] < 0
    assert held_rows.sum() * 0.033 > HOLD_S
    assert not column(rows, "counts")[::4][held_rows].any()
    assert np.isnan(column(rows, "control_error_mm")[::4][held_rows]).all()
    assert np.isfinite(column(rows, "x_m")[::4][held_rows]).all()


def test_run_time_stands_still_in_the_hold_and_clock_time_goes_on(rows: list[dict[str, str]]) -> None:
    run_s, clock_s = column(rows, "run_time_s")[::4], column(rows, "clock_time_s")[::4]
    assert (run_s[0], clock_s[0]) == (0.0, 0.0)
    assert_allclose(np.diff(clock_s), 0.033, atol=1e-9)
    running = column(rows, "run_tick")[::4] >= 0
    assert_allclose(run_s[running], 0.033 * column(rows, "run_tick")[::4][running], atol=1e-9)
    (standing,) = np.nonzero(~running & (clock_s < clock_s[running][-1]))
    assert np.ptp(run_s[standing]) == 0.0
    assert (np.diff(run_s) >= 0).all()
    assert (clock_s - run_s)[running][-1] == pytest.approx(HOLD_S, abs=0.1)
    assert (column(rows, "t_s") == column(rows, "clock_time_s")).all()


@pytest.mark.slow
def test_a_run_that_is_read_in_parts_has_the_same_table(held: Recording, tmp_path: Path) -> None:
    with RunLog(tmp_path / FILE, held.config, drawn=False) as log:
        for index, (full, payload) in enumerate(recorded.in_order(held)):
            log.add(full, payload, index * 10 * MS)
    write_csv(looks(tmp_path), tmp_path / "whole.csv")
    parts = [*looks(tmp_path, together=100_000)]
    assert len(parts) > 3
    write_csv(parts, tmp_path / "parts.csv")
    assert (tmp_path / "parts.csv").read_text() == (tmp_path / "whole.csv").read_text()
    clock, in_parts = (look(tmp_path, together=size).clock for size in (1 << 62, 100_000))
    stamps = clock.start_ns + np.arange(0, 6_000, 7) * MS
    assert_allclose(in_parts.run_time_s(stamps), clock.run_time_s(stamps))


def test_a_live_clock_agrees_and_does_not_know_the_clock_time_of_what_it_did_not_hear(held: Recording) -> None:
    clock, late = LiveClock(0.033), LiveClock(0.033)
    messages = held.messages[key(held.config.arena.name, TICK)]
    records = [record for message in messages if (record := TICK_RECORD.decode(message)) is not None]
    for record in records:
        clock.take(record)
    run = Run(held)
    assert clock.run_s == pytest.approx(run.t[-1])
    assert clock.clock_s == pytest.approx(float(run.clock.clock_time_s(run.ended_ns)))
    for record in records[next(k for k, record in enumerate(records) if record.run_tick == 10) :]:
        late.take(record)
    assert (late.run_s, late.clock_s) == (clock.run_s, None)


def test_a_time_in_words_has_both_where_they_differ() -> None:
    assert time_words(20.7, 20.71) == "20.7 s run time"
    assert time_words(20.7, 26.7) == "20.7 s run time (26.7 s clock time)"
    assert time_words(20.7, None) == "20.7 s run time"
