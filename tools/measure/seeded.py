"""Runs a script of the Robotarium so that two simulators can be compared: equal draws, exact starts, no waiting.

    PYTHONPATH=CHECKOUT python tools/measure/seeded.py SCRIPT RESULT
    PYTHONPATH=CHECKOUT robofleet robotarium tools/measure/seeded.py --api 2 -- SCRIPT RESULT

RESULT is a JSON file: the poses at first and at last, the steps, the errors, the loop's CPU time. What the simulators
draw changes nothing of what the script draws.
"""

import json
import random
import runpy
import sys
import time  # noqa: TID251 - this project is not asked where the original runs
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import rps.robotarium
from matplotlib import patches
from matplotlib.backends.backend_agg import FigureCanvasAgg

_SEED = 7
_BASE = rps.robotarium.Robotarium
_ORIGINAL = not hasattr(_BASE, "runs")


def seed(number: int) -> None:
    np.random.seed(number)
    random.seed(number)


def draws() -> tuple[Any, Any]:
    return np.random.get_state(), random.getstate()


def draw_on(states: tuple[Any, Any]) -> None:
    np.random.set_state(states[0])
    random.setstate(states[1])


class Robotarium(_BASE):  # type: ignore[valid-type, misc]
    """The simulator, watched."""

    def __init__(self, *args: Any, **how: Any) -> None:
        seed(_SEED)
        if _ORIGINAL:
            how["sim_in_real_time"] = False
            if hasattr(_BASE, "initialize"):
                how["skip_initialization"] = True
        self._harness_poses: list[np.ndarray] = []
        self._harness_steps = 0
        self._harness_cpu_s: list[float] = []
        super().__init__(*args, **how)
        watched.append(self)
        seed(_SEED + 1)

    def get_poses(self) -> Any:
        poses = super().get_poses()
        self._harness_cpu_s = [*self._harness_cpu_s[:1], time.process_time()]
        self._harness_poses = [*self._harness_poses[:1], poses.copy()]
        return poses

    def step(self) -> None:
        states = draws()
        super().step()
        draw_on(states)
        self._harness_steps += 1


def shows_nothing(_canvas: Any) -> None:
    """Draw nothing between two steps."""


def rectangle(self: Any, xy: Any, width: float, height: float, angle: float = 0.0, **how: Any) -> None:
    """Take the angle as older versions of matplotlib did."""
    _RECTANGLE(self, xy, width, height, angle=angle, **how)


watched: list[Robotarium] = []
_RECTANGLE = patches.Rectangle.__init__
if _ORIGINAL:
    FigureCanvasAgg.draw_idle = shows_nothing  # type: ignore[method-assign, assignment]
    patches.Rectangle.__init__ = rectangle  # type: ignore[method-assign]
    np.mat = np.asmatrix  # type: ignore[attr-defined]
rps.robotarium.Robotarium = Robotarium
script, result = Path(sys.argv[1]), Path(sys.argv[2])
sys.argv[:] = [str(script), *sys.argv[3:]]
sys.path.insert(0, str(script.absolute().parent))
np.random.seed(0)
try:
    runpy.run_path(str(script), run_name="__main__")
finally:
    if watched:
        scene = watched[-1]
        errors = {name: count for name, count in scene._errors.items() if not name.endswith("string")}
        summary = {
            "first": scene._harness_poses[0].tolist(),
            "last": scene._harness_poses[-1].tolist(),
            "steps": scene._harness_steps,
        }
        cpu_s = scene._harness_cpu_s[-1] - scene._harness_cpu_s[0]
        result.write_text(json.dumps(summary | {"errors": errors, "cpu_s": cpu_s}))
