"""The folder of a run: its default name, and the newest one."""

import os
import re
from pathlib import Path

import pytest

from robofleet.core.refusal import RefusedError
from robofleet.runs import folder as folders


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def make(name: str, file: str = "run.mcap") -> Path:
    folder = folders.RUNS / name
    folder.mkdir(parents=True)
    (folder / file).touch()
    return folder


def test_a_run_is_named_by_the_time_of_its_start() -> None:
    assert re.fullmatch(r"runs/\d{8}T\d{6}Z-platoon", str(folders.new("platoon")))
    assert not folders.RUNS.exists()


def test_the_newest_run_is_taken_and_named_where_none_is_given(capsys: pytest.CaptureFixture[str]) -> None:
    make("20260102T030405Z-z")
    newest = make("20260102T030406Z-a")
    os.utime(newest, (0, 0))  # its name counts: a folder may be copied
    make("20260102T030407Z-paper", "platoon.json")
    make("notes")
    assert folders.chosen(None) == newest
    assert capsys.readouterr().err == f"the newest run is taken: {newest}\n"
    assert folders.chosen(Path("notes")) == Path("notes")
    assert capsys.readouterr().err == ""


def test_of_one_second_the_later_one_is_the_newest() -> None:
    later = make("20260102T030405Z-script-10")
    os.utime(make("20260102T030405Z-script-2"), (0, 0))
    assert folders.chosen(None) == later


def test_where_there_is_no_run_that_is_said(desk: Path) -> None:
    make("20260102T030407Z-paper", "platoon.json")
    with pytest.raises(RefusedError, match=f"there is no run in {desk}/runs: name a run's folder"):
        folders.chosen(None)
