"""The room where a run is recorded, whatever becomes of its folder."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.recording.reading import read
from robofleet.runs.table import free_bytes
from tests.runs.realrun import ALONE, RealRun


def test_a_folder_that_is_renamed_or_removed_keeps_its_room(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    held = os.open(folder, os.O_RDONLY)
    try:
        assert free_bytes(held) > 0
        folder.rename(tmp_path / "elsewhere")
        assert free_bytes(held) > 0
        shutil.rmtree(tmp_path / "elsewhere")
        assert free_bytes(held) > 0
    finally:
        os.close(held)
    assert free_bytes(held) == 0, "unknown room is none: the fleet holds"


@pytest.mark.long
def test_a_run_whose_folder_is_renamed_goes_on_and_says_where_it_is_not(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*ALONE, "--duration", "2")
    run.wait_until_running()
    moved = run.folder.rename(run.folder.with_name("moved"))
    assert run.ended() == 1, "a completed run whose figures are lost met none of its bounds"
    assert "results are lost" in run.said
    assert f"{run.folder}" in run.said
    assert not run.folder.exists()
    assert (read(moved).outcome, read(moved).trouble) == ("completed", None)
    assert "Traceback" not in (moved / "log" / "supervisor.log").read_text()
