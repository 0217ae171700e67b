"""Example scripts as a user starts them, but watched: what their robots did is written down."""

import importlib.util
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import robofleet
from robofleet import Fleet

EXAMPLES = Path(__file__).parents[2] / "configs" / "examples"


class Watched(Fleet):
    """A fleet whose poses are written down; a run of its own is without images, and leaves nothing."""

    longest_s: float | None = None  # of a loop

    def __init__(self, where: str | Path, **how: Any) -> None:
        if Path(where).suffix == ".yaml":
            how |= {"out": False, "settings": ["tracker.source=truth"]}
        super().__init__(where, **how)
        self.seen: list[tuple[float, np.ndarray, np.ndarray]] = []  # time in the loop, poses, points
        self.arrived: list[np.ndarray] = []  # poses after each journey

    def ticks(self, seconds: float | None = None) -> Iterator[float]:
        for t in super().ticks(seconds):
            if self.longest_s is not None and t >= self.longest_s:
                return
            self.seen.append((t, self.poses, self.points))
            yield t

    def go_to(self, *goals: Any, **how: Any) -> None:
        super().go_to(*goals, **how)
        self.arrived.append(self.poses)


def started(name: str, *arguments: str) -> dict[str, Any]:
    """Run an example as its docstring says, and return its variables."""
    file = str(EXAMPLES / f"{name}.py")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(robofleet, "Fleet", Watched)
        patched.setattr(sys, "argv", [file, *arguments])
        return runpy.run_path(file, run_name="__main__")


def loaded(name: str) -> Any:
    """Return an example as a module, without starting it."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def seen(ran: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (M,), poses (M, N, 3) and points (M, N, 2)."""
    return tuple(np.array(what) for what in zip(*ran["fleet"].seen, strict=True))  # type: ignore[return-value]
