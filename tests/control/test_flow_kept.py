"""A user's own model is compiled once: later processes load it, whatever happened to the file or the model meanwhile."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys
import numpy as np
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant

def plant(pull):
    return Plant(lambda x, u: pull * u, lambda x: x.copy(), 1, 1)

for pull in map(float, sys.argv[1:]):
    flow = NewtonRaphsonFlow(plant(pull), FlowSettings(20.0, 0.5, 0.01), [2.0])
    flow.update(np.zeros(1), np.ones(1))
    print(repr(float(flow.prediction[0])), sum(flow.compiled_step.stats.cache_hits.values()))
"""
KERNELS = "from robofleet.kernels.store import folder; print(folder())"


def start(*pulls: float, source: str = SCRIPT) -> "subprocess.Popen[str]":
    """Start a process whose functions stand in no file."""
    command = [sys.executable, "-c", source, *map(str, pulls)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def said(process: "subprocess.Popen[str]") -> list[tuple[float, bool]]:
    """Return what it predicted for each model, and whether it was loaded."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [(float(predicted), hits == "1") for predicted, hits in map(str.split, out.splitlines())]


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of compiled functions of the test's own, with the kernels that are compiled already."""
    common = Path(
        subprocess.run([sys.executable, "-c", KERNELS], capture_output=True, text=True, check=True).stdout[:-1]
    )
    mine = tmp_path / "robofleet" / "kernels"
    mine.mkdir(parents=True)
    for file in common.iterdir() if common.exists() else ():
        if not file.name.startswith((".part", "step-")):
            os.link(file, mine / file.name)
    monkeypatch.setenv("ROBOFLEET_TEST", "")
    return mine
