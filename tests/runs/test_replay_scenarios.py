"""Runs that were recorded some time ago: today's controller decides the same of what it sees there."""

import re

import pytest

from robofleet.recording.reading import RecordingError, read
from robofleet.recording.run import Run
from robofleet.runs.replay import Verdict, replay
from tests.recordings.make import HERE, SCENARIOS

ANEW = "if the change is meant, make the recordings anew: python -m tests.recordings.make"
_LARGEST, _ALL = 150_000, 1_200_000  # [bytes]
_SAME = 1e-9  # on another machine


def replayed(name: str) -> tuple[Run, Verdict]:
    try:
        recording = read(HERE / f"{name}.mcap")
        return Run(recording), replay(recording, _SAME)
    except RecordingError as error:
        pytest.fail(f"{error}: {ANEW}", pytrace=False)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_recorded_scenario_is_decided_as_it_was(name: str) -> None:
    run, verdict = replayed(name)
    report = "\n".join(map(str, [*verdict.differences[:5], *verdict.holes[:5]]))
    assert verdict.equal, f"{len(verdict.differences)} differences:\n{report}\n{ANEW}"
    assert verdict.ticks == len(run.all_ticks)
    assert SCENARIOS[name].shows(run), f"it does not show any more what it is for; {ANEW}"


def test_every_recording_is_one_of_a_scenario_and_they_are_small() -> None:
    sizes = {file.stem: file.stat().st_size for file in HERE.glob("*.mcap")}
    assert set(sizes) == set(SCENARIOS), ANEW
    assert max(sizes.values()) <= _LARGEST
    assert sum(sizes.values()) <= _ALL


def test_a_recording_that_cannot_be_read_any_more_says_how_to_make_it_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robofleet.recording.reading.ENCODING", "robofleet-0")
    with pytest.raises(pytest.fail.Exception, match=re.escape("make the recordings anew")):
        replayed("centre")
