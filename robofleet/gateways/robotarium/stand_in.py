"""The module ``rps.robotarium`` as scripts get it: ours, in front of the installed one. All else is as installed."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

from robofleet.gateways.robotarium import version1, version2
from robofleet.gateways.robotarium.runs import Runs
from robofleet.gateways.robotarium.simulator import Simulator

MODULE = "rps.robotarium"
_VERSIONS: dict[int, type[Simulator]] = {1: version1.Robotarium, 2: version2.Robotarium}


class _StandIn(MetaPathFinder, Loader):
    """Finds and makes the one module."""

    def __init__(self, runs: Runs, version: int) -> None:
        self._robotarium = type("Robotarium", (_VERSIONS[version],), {"runs": runs, "__module__": MODULE})

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(fullname, self) if fullname == MODULE else None

    def exec_module(self, module: ModuleType) -> None:
        module.__doc__ = __doc__
        module.__dict__["Robotarium"] = self._robotarium


@contextmanager
def installed(runs: Runs, version: int) -> Iterator[None]:
    """Let ``import rps.robotarium`` give our module, until this ends."""
    finder = _StandIn(runs, version)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        sys.modules.pop(MODULE, None)
