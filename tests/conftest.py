"""Which tests go to one worker: those of a file, and of files that compile the same plant: it is compiled once then."""

from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

_SAME_PLANT = {
    "tests/control/test_flow_any_plant.py": "double integrator",
    "tests/experiments/test_stability.py": "double integrator",
    "tests/experiments/test_closed_curve.py": "bicycle of Zhou",
    "tests/experiments/test_paper_command.py": "bicycle of Zhou",
    "tests/control/test_flow_prediction.py": "bicycle of Falcone",
    "tests/control/test_flow_refusals.py": "bicycle of Falcone",
    "tests/experiments/test_lane_change.py": "bicycle of Falcone",
}


class _Scheduling(LoadFileScheduling):
    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return _SAME_PLANT.get(file, file)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> _Scheduling:
    return _Scheduling(config, log)
