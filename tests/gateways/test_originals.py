"""The Robotarium's own scripts, where a checkout of them is: they run unmodified, and end where theirs end."""

import os
from importlib.util import find_spec
from pathlib import Path

import pytest

from tools.measure.originals import compared, scripts, version

_CHECKOUTS = "ROBOTARIUM", "ROBOTARIUM_1"  # of version 2 and 1
_QUICK = "go_to_point_uni", "go_to_pose_clf", "leader_follower", "uni_go_to_pose_clf", "si_go_to_point"
_WITHIN_MM = 30.0


def _found() -> list[Path]:
    places = [Path(os.environ[name]) for name in _CHECKOUTS if name in os.environ]
    return [script for folder in places for script in scripts(folder)]


@pytest.mark.skipif(not _found(), reason=f"no {' and no '.join(_CHECKOUTS)}: name checkouts of its simulator")
@pytest.mark.skipif(find_spec("cvxopt") is None, reason="no cvxopt, which the Robotarium's utilities need")
@pytest.mark.parametrize("script", [script for script in _found() if script.stem in _QUICK], ids=lambda s: s.stem)
def test_a_script_of_theirs_ends_where_theirs_ends(script: Path) -> None:
    checkout = next(parent for parent in script.parents if (parent / "rps").is_dir())
    row = compared(checkout, script)
    assert row.exit_code == 0, row.output
    assert row.apart_mm < _WITHIN_MM
    assert version(checkout) in (1, 2)
