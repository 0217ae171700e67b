"""Tags on photographs are found as often as by the AprilTag library, and none that is not there.

ROBOFLEET_PHOTOGRAPHS names a folder with clones of the repositories in ``photographs.txt``: see ``photographs.py``.
"""

import os
from collections import Counter
from pathlib import Path

import pytest

from tests.tracking.peers import OURS
from tools.measure.tracking.photographs import APRILTAG, found

FOLDER = os.environ.get("ROBOFLEET_PHOTOGRAPHS")


@pytest.mark.skipif(FOLDER is None, reason="ROBOFLEET_PHOTOGRAPHS names no folder of photographs")
def test_listed_tags_are_found_and_no_others() -> None:
    total: dict[str, Counter[str]] = {}
    for table in found(Path(str(FOLDER))).values():
        for name, row in table.items():
            total.setdefault(name, Counter()).update(row)
    print(total)
    assert total[OURS]["wrong"] == 0
    assert total[OURS]["found"] >= total[APRILTAG]["found"] > 0
