"""How a run ended, as its file says it: millions of durations are read without an object for each."""

import json
from array import array

import pytest

from robofleet.config.load import load_config
from robofleet.recording.run import Recording
from tests.shipped import PLATOON


def ended(durations: str) -> Recording:
    recording = Recording(load_config(PLATOON))
    fields = {"outcome": "completed", "cause": None, "elapsed_s": 1.0, "trace_hash": None, "tick_durations_ns": None}
    text = json.dumps(fields | {"tracker_durations_ns": "HERE"}).replace('"HERE"', durations)
    recording.end(text.encode())
    return recording


LONG = [*range(10_000_000, 10_400_000)]  # several megabytes of text


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
