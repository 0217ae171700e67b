"""The room where a run is recorded, whatever becomes of its folder."""

import os
import shutil
from pathlib import Path

from robofleet.processes.child import free_bytes


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
