"""The module ``rps.robotarium`` as scripts get it: ours, in front of the installed one. All else is as installed."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

import numpy as np

from robofleet.gateways.robotarium import version1, version2
from robofleet.gateways.robotarium.runs import Runs
from robofleet.gateways.robotarium.simulator import Simulator

_NUMPY = {
    "mat": np.asmatrix, "float": float, "int": int, "bool": bool, "object": object, "complex": complex,
    "float_": np.float64, "Inf": np.inf, "infty": np.inf, "NaN": np.nan, "product": np.prod, "cumproduct": np.cumprod,
    "row_stack": np.vstack, "alltrue": np.all, "sometrue": np.any,
}  # fmt: skip


def restore() -> None:
    """Add the names that are missing."""
    for name, value in _NUMPY.items():
        if name not in vars(np):
            setattr(np, name, value)
    import matplotlib as mpl  # noqa: PLC0415 - slow to load
    from matplotlib import cm  # noqa: PLC0415

    def get_cmap(name: str | None = None, lut: int | None = None) -> Any:
        found = mpl.colormaps[name or mpl.rcParams["image.cmap"]]
        return found if lut is None else found.resampled(lut)

    if not hasattr(cm, "get_cmap"):
        cm.get_cmap = get_cmap  # type: ignore[attr-defined]


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
