"""Which tests go to one worker, and what a file of tests leaves behind there: no module of a user's own.

The tests of a file go to one worker, and so do files that compile the same plant: it is compiled once then.
"""

import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

from tests.compiled_once import compiled_once

# Else every process that a test starts compiles all sources anew, and every worker rewrites all assertions.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

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


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Two workers that both meet an empty cache of kernels do not both compile all of them."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        yield
        return
    locks = tmp_path_factory.getbasetemp().parent / "kernels"  # the workers' common folder
    locks.mkdir(exist_ok=True)
    with compiled_once(locks):
        yield


@pytest.fixture(scope="module", autouse=True)
def _own_modules() -> Iterator[None]:
    """Forget the modules beside configurations that a file of tests loaded: the next has others of that name."""
    paths, given = list(sys.path), os.environ.get("PYTHONPATH")
    yield
    added = {Path(path).resolve() for path in sys.path if path not in paths}
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if file and not added.isdisjoint(Path(file).resolve().parents):
            del sys.modules[name]
    sys.path[:] = paths
    if given is None:
        os.environ.pop("PYTHONPATH", None)
    else:
        os.environ["PYTHONPATH"] = given


@pytest.fixture
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Wait until no other worker has a fleet of real processes: two on two cores keep each other from their ticks."""
    with _nobody_else(tmp_path_factory):
        yield


@pytest.fixture(scope="module")
def alone_for_a_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Wait as ``alone``, for all tests of a module: its tests do not use that one."""
    with _nobody_else(tmp_path_factory):
        yield


@contextmanager
def _nobody_else(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    shared = tmp_path_factory.getbasetemp().parent / "fleet.lock"
    with shared.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
