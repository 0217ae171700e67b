"""Tags on photographs are found as often as by the AprilTag library, and none that is not there.

ROBOFLEET_PHOTOGRAPHS names a folder with clones of the repositories in ``photographs.txt``: see ``photographs.py``.
"""

import os
from pathlib import Path

import pytest

from tests.tracking.peers import OURS
from tools.measure.tracking.photographs import APRILTAG, found

FOLDER = os.environ.get("ROBOFLEET_PHOTOGRAPHS")


@pytest.mark.skipif(FOLDER is None, reason="ROBOFLEET_PHOTOGRAPHS names no folder of photographs")
def test_listed_tags_are_found_and_no_others() -> None:
    for size, table in found(Path(str(FOLDER))).items():
        print(size, table)
        assert table[OURS]["wrong"] == 0
        assert table[OURS]["found"] >= table[APRILTAG]["found"] > 0
