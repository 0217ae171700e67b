"""A run that is looked at part by part has the figures, columns and entries of one that is looked at as a whole."""

import tracemalloc
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.config.load import load_config
from robofleet.core.clock import S
from robofleet.operator.run import in_lockstep
from robofleet.recording import reading
from robofleet.recording.columns import write_csv
from robofleet.recording.log import RunLog
from robofleet.recording.run import SHOWN, Run
from robofleet.reports import after, metrics, report, sampled
from robofleet.reports.sampled import look, looks
from robofleet.reports.timeline import Timeline
from robofleet.runs import lockstep
from robofleet.runs.lockstep import Lockstep
from tests.recording.recorded import in_order
from tests.shipped import PLATOON

RECORDINGS = sorted((Path(__file__).parents[1] / "recordings").glob("*.mcap"))
PART = 60_000  # bytes: a second or two of four robots
BYTES_OF_A_PART = 60_000  # that are kept of it at most, of 400,000 while it is looked at


def summary(run: Run) -> dict[str, Any]:
    return metrics.summary(run.recording, name="n", mode="lockstep", outcome="completed", cause=None, run=run)


def flat(value: Any, name: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        return {k: v for key, own in value.items() for k, v in flat(own, f"{name}.{key}").items()}
    if isinstance(value, list):
        return {k: v for key, own in enumerate(value) for k, v in flat(own, f"{name}.{key}").items()}
    return {name: value}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("file", RECORDINGS, ids=lambda file: file.stem)
def test_the_figures_of_a_run_in_parts_are_those_of_the_whole(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)  # these runs last some seconds
    parts, whole = look(file, together=PART), look(file)
    assert parts.reduced is not None, "it is looked at in parts"
    assert whole.reduced is None
    figures, expected = flat(summary(parts)), flat(summary(whole))
    assert figures.keys() == expected.keys()
    for name, value in expected.items():
        assert figures[name] == (pytest.approx(value, abs=2e-4) if isinstance(value, float) else value), name

    entries = [[(e.who, e.what) for e in Timeline(run, []).entries] for run in (parts, whole)]
    write_csv(looks(file, together=PART), tmp_path / "parts.csv")
    write_csv([whole], tmp_path / "whole.csv")
    columns = [np.genfromtxt(tmp_path / f"{name}.csv", delimiter=",", names=True) for name in ("parts", "whole")]
    for name in columns[1].dtype.names or ():
        np.testing.assert_allclose(columns[0][name], columns[1][name], atol=2e-6, err_msg=name)
    assert entries[0] == entries[1]


def test_of_a_sampled_run_what_is_largest_and_what_is_counted_is_of_every_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)
    monkeypatch.setattr(sampled, "_MOST_TICK_BYTES", 20_000)
    file = RECORDINGS[[file.stem for file in RECORDINGS].index("platoon")]
    parts, whole = look(file, together=PART), look(file)
    assert len(parts.ticks) < len(whole.ticks) / 3
    assert parts.ticks[[0, -1]].tobytes() == whole.ticks[[0, -1]].tobytes()
    figures, expected = flat(summary(parts)), flat(summary(whole))
    for name, value in expected.items():
        sampled_mean = name.startswith((".bounds", ".groups", ".control", ".timed", ".path", ".centre", ".spacing"))
        if not sampled_mean or ".max" in name:
            assert figures[name] == (pytest.approx(value, abs=2e-4) if isinstance(value, float) else value), name
        elif isinstance(value, float):
            assert figures[name] == pytest.approx(value, rel=0.25), name


def test_a_part_of_a_run_is_let_go_of_before_the_next_one_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)
    seen: list[weakref.ref[Run]] = []

    class Seen(Run):
        def __init__(self, *args: Any, **keys: Any) -> None:
            assert not any(part() for part in seen)
            super().__init__(*args, **keys)
            seen.append(weakref.ref(self))

    monkeypatch.setattr(sampled, "Run", Seen)
    look(RECORDINGS[0], together=PART)
    write_csv(looks(RECORDINGS[0], together=PART), tmp_path / "parts.csv")
    assert len(seen) > 3


@pytest.mark.slow
def test_a_run_of_four_times_the_length_needs_no_more_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)
    monkeypatch.setattr(sampled, "_MOST_TICK_BYTES", 50_000)
    recording = reading.read(RECORDINGS[[file.stem for file in RECORDINGS].index("platoon")])
    messages = in_order(recording)[-300:]  # the fleet is driving: nothing else happens
    size = sum(len(payload) for _, payload in messages)

    def peak(times: int) -> int:
        file = tmp_path / f"{times}.mcap"
        with RunLog(file, recording.config, drawn=False, batched=True) as log:
            for k in range(times):
                log.add_all(messages, 2 * k * S)
        tracemalloc.start()
        try:
            assert look(file, together=size).reduced is not None, "it is looked at in parts"
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    look(RECORDINGS[0])  # it loads kernels
    assert peak(40) - peak(10) < 30 * BYTES_OF_A_PART


@pytest.mark.parametrize("part", [PART, 1 << 30], ids=["long", "short"])
def test_a_report_reads_its_file_once(part: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)
    opened: list[Path] = []

    def parts(run: Path, *_: Any, **__: Any) -> Iterator[Any]:
        opened.append(run)
        return reading.parts(run, together=part)

    monkeypatch.setattr(sampled, "parts", parts)
    monkeypatch.setattr(report, "sections", lambda view: {})
    file = tmp_path / "run.mcap"
    file.write_bytes(RECORDINGS[0].read_bytes())
    after.report(file)
    assert opened == [file]


@pytest.mark.slow
def test_a_run_in_lockstep_keeps_no_more_in_memory_than_a_live_view_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = []

    class Seen(Lockstep):
        def __init__(self, *args: Any, **keys: Any) -> None:
            super().__init__(*args, **keys)
            runs.append(self)

    monkeypatch.setattr(lockstep, "Lockstep", Seen)
    config = load_config(PLATOON, ["tracker.source=truth", "run.duration_s=30"])
    result = in_lockstep(config, "n", tmp_path, quiet=True)
    assert result.summary["outcome"] == "completed"
    in_memory, in_file = (
        max(map(len, source.messages.values())) for source in (runs[0].recording, result.columns.recording)
    )
    assert in_file > 3 * SHOWN
    assert in_memory < 2.5 * SHOWN
