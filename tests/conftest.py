"""Which tests go to one worker, and what a file of tests leaves behind there: no module of a user's own.

The tests of a file go to one worker, and so do files that compile the same plant: it is compiled once then. Files with
fleets of real processes go first, to one worker after another: no worker waits for the fleet of another one.
"""

import fcntl
import gc
import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.testing
from xdist.scheduler import LoadFileScheduling

from tests.compiled_once import compiled_once

pytest_plugins = ["tests.process_fixtures", "tests.recording_fixtures"]

# What a worker collects and imports stays to its end: it is not looked through for garbage, then or later.
_WORKER = "PYTEST_XDIST_WORKER" in os.environ
if _WORKER:
    gc.disable()
# Else every process that a test starts compiles all sources anew, and every worker rewrites all assertions.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# A shell's background job ignores it, and so would every process that a test starts and interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)
# Else each command that a test runs is made anew, of all the others.
typer.testing._get_command = cache(typer.testing._get_command)

_SAME_PLANT = {
    "tests/control/test_flow_any_plant.py": "double integrator",
    "tests/experiments/test_stability.py": "double integrator",
    "tests/experiments/test_closed_curve.py": "bicycle of Zhou",
    "tests/experiments/test_paper_command.py": "bicycle of Zhou",
    "tests/control/test_flow_prediction.py": "bicycle of Falcone",
    "tests/control/test_flow_refusals.py": "bicycle of Falcone",
    "tests/experiments/test_lane_change.py": "bicycle of Falcone",
}


_FLEET = re.compile(r'\breal_run: |\balone(_for_a_module)?(: None|"\))')  # a fixture that a test takes


class _Scheduling(LoadFileScheduling):
    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return _SAME_PLANT.get(file, file)

    def _reschedule(self, node: Any) -> None:
        """Leave a worker alone that replaces a crashed one and has not collected yet."""
        if node in self.registered_collections:
            super()._reschedule(node)

    def _assign_work_unit(self, node: Any) -> None:
        """Give a worker the next file: one with a fleet, if no other worker has such a file."""
        others = (work for other, work in self.assigned_work.items() if other is not node)
        taken = any(_has_fleet(scope) and self._pending_of({scope: work[scope]}) for work in others for scope in work)
        chosen = next((scope for scope in self.workqueue if _has_fleet(scope) != taken), next(iter(self.workqueue)))
        self.workqueue.move_to_end(chosen, last=False)
        super()._assign_work_unit(node)


@cache
def _has_fleet(scope: str) -> bool:
    """Whether tests of a file take a fixture by which only one worker at a time has a fleet of real processes."""
    file = Path(__file__).parents[1] / scope
    return file.is_file() and bool(_FLEET.search(file.read_text()))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the cases of ``slow_after_first`` as slow, but the first of each test."""
    fast = set()
    for item in items:
        if item.get_closest_marker("slow_after_first") is None or item.get_closest_marker("long") is not None:
            continue
        test = item.nodeid.partition("[")[0]
        if test in fast:
            item.add_marker("slow")
        fast.add(test)


def pytest_collection_finish() -> None:
    if _WORKER:
        gc.freeze()
        gc.enable()


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
    paths, known, given = list(sys.path), set(sys.modules), os.environ.get("ROBOFLEET_MODULES")
    yield
    added = {Path(path).resolve() for path in sys.path if path not in paths}
    for name in sys.modules.keys() - known if added else ():
        file = getattr(sys.modules[name], "__file__", None)
        if file and not added.isdisjoint(Path(file).resolve().parents):
            del sys.modules[name]
    sys.path[:] = paths
    if given is None:
        os.environ.pop("ROBOFLEET_MODULES", None)
    else:
        os.environ["ROBOFLEET_MODULES"] = given


@pytest.fixture
def unplotted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the plots out of reports: they take longer than a run, and who uses this looks at something else."""
    monkeypatch.setattr("robofleet.reports.report._plots", lambda *_: None)


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
