"""Millions of durations: as a run's file says them, without an object for each; and their percentiles."""

import json
from array import array

import numpy as np
import pytest

from robofleet.config.load import load_config
from robofleet.recording import reduced
from robofleet.recording.reduced import Distribution
from robofleet.recording.run import Recording
from tests.shipped import PLATOON


def ended(durations: str) -> Recording:
    recording = Recording(load_config(PLATOON))
    fields = {"outcome": "completed", "cause": None, "elapsed_s": 1.0, "trace_hash": None, "tick_durations_ns": None}
    text = json.dumps(fields | {"tracker_durations_ns": "HERE"}).replace('"HERE"', durations)
    recording.end(text.encode())
    return recording


LONG = [*range(10_000_000, 10_400_000)]  # several megabytes of text


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    "durations",
    [[], [0], [5, 2, 7], [1 << 61, 3], LONG, [*LONG, 1 << 61]],
    ids=["none", "0", "3", "big", "long", "mixed"],
)
def test_durations_are_those_of_the_file(durations: list[int]) -> None:
    assert ended(json.dumps(durations)).tracker_durations_ns == array("q", durations)
    assert ended(json.dumps(durations, separators=(",", ":"))).tracker_durations_ns == array("q", durations)


@pytest.mark.parametrize(
    "durations",
    ["[1 2]", "[1,,2]", "[ ]x", "[-1]", "[1.5]", f"[{1 << 62}]", f"[{'9' * 40}]", "[1,]", "[1, ]", "[ , 1]"],
)
def test_what_is_no_list_of_durations_is_refused(durations: str) -> None:
    with pytest.raises(ValueError, match=r"tracker_durations_ns|JSON"):
        ended(durations)


PERCENTS = 0, 1, 50, 99, 100


@pytest.mark.parametrize("seed", range(20))
def test_percentiles_of_parts_are_those_of_all_durations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [rng.integers(-(10**6), 10 ** rng.integers(1, 9), rng.integers(1, 20)) for _ in range(3)]
    every = np.concatenate(parts)
    joined = Distribution.joined([Distribution.of(part) for part in parts])
    assert (len(joined), joined.largest) == (len(every), every.max())
    np.testing.assert_allclose(joined.percentiles(PERCENTS), np.percentile(every, PERCENTS), rtol=1e-12, atol=1e-6)


def test_parts_without_a_duration_add_nothing() -> None:
    nothing, single = Distribution.of([]), Distribution.of([7])
    assert (len(Distribution.joined([nothing, nothing])), nothing.largest) == (0, 0)
    assert Distribution.joined([nothing, single, nothing]).percentiles((50,)).tolist() == [7]


def test_of_very_many_different_durations_little_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reduced, "_MOST_VALUES", 1_000)
    durations = np.random.default_rng(1).integers(10_000_000, 40_000_000, 50_000)
    joined = Distribution.of([])
    for part in np.split(durations, 50):
        joined = Distribution.joined([joined, Distribution.of(part)])
        assert len(joined.values) <= 1_000
    assert len(joined) == len(durations)
    np.testing.assert_allclose(joined.percentiles(PERCENTS), np.percentile(durations, PERCENTS), atol=1 << 16)
