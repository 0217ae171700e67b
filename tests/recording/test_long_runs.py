"""A run that is looked at part by part has the figures, the columns and the entries of one that is looked at as a whole."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.clock import S
from robofleet.recording import metrics, reading
from robofleet.recording.columns import write_csv
from robofleet.recording.run import Run
from robofleet.recording.sampled import look, looks
from robofleet.recording.series import series
from robofleet.recording.timeline import Timeline

RECORDINGS = sorted((Path(__file__).parents[1] / "recordings").glob("*.mcap"))
PART = 60_000  # bytes: a second or two of four robots


def summary(run: Run) -> dict[str, Any]:
    return metrics.summary(run.recording, name="n", mode="lockstep", outcome="completed", cause=None, run=run)


def flat(value: Any, name: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        return {k: v for key, own in value.items() for k, v in flat(own, f"{name}.{key}").items()}
    if isinstance(value, list):
        return {k: v for key, own in enumerate(value) for k, v in flat(own, f"{name}.{key}").items()}
    return {name: value}


@pytest.mark.parametrize("file", RECORDINGS, ids=lambda file: file.stem)
def test_the_figures_of_a_run_in_parts_are_those_of_the_whole(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)  # these runs last some seconds
    parts, whole = look(file, together=PART), look(file)
    assert parts.reduced is not None, "it is looked at in parts"
    assert whole.reduced is None
    told, expected = flat(summary(parts)), flat(summary(whole))
    assert told.keys() == expected.keys()
    for name, value in expected.items():
        assert told[name] == (pytest.approx(value, abs=2e-4) if isinstance(value, float) else value), name

    entries = [[(e.who, e.what) for e in Timeline(run, []).entries] for run in (parts, whole)]
    write_csv(map(series, looks(file, together=PART)), tmp_path / "parts.csv")
    write_csv([series(whole)], tmp_path / "whole.csv")
    columns = [np.genfromtxt(tmp_path / f"{name}.csv", delimiter=",", names=True) for name in ("parts", "whole")]
    for name in columns[1].dtype.names or ():
        np.testing.assert_allclose(columns[0][name], columns[1][name], atol=2e-6, err_msg=name)
    assert entries[0] == entries[1]
