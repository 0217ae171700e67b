"""No kernel is compiled once a run is under way: a process that compiles is not heard, and its fleet stops."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from robofleet.core.compiling import Progress, decoded
from robofleet.core.kernels import kernel, reached

CONFIGS = Path(__file__).parents[2] / "configs"
# In a process of its own: what another test has compiled would be there before this run needs it.
FIRST_CALLED = """
import gc, json, sys
from pathlib import Path
from robofleet.config.load import load_config
from robofleet.core.kernels import Kernel
from robofleet.runs.lockstep import Lockstep

def compiled():
    kernels = [one for one in gc.get_objects() if isinstance(one, Kernel) and "compiled" in vars(one)]
    return {f"{one.__module__}.{one.__name__}{signature}" for one in kernels for signature in one.compiled.signatures}

run = Lockstep(load_config(Path(sys.argv[1]), sys.argv[2:]))
ready = compiled()
assert run.run() == ("completed", None)
print(json.dumps([len(ready), sorted(compiled() - ready)]))
"""

TRACE = """
import sys
from pathlib import Path
from robofleet.config.load import load_config
from robofleet.core.kernels import store
from robofleet.runs.lockstep import Lockstep

store.folder = lambda: Path(sys.argv[1])
run = Lockstep(load_config(Path(sys.argv[2]), ["run.duration_s=1"]))
assert run.run() == ("completed", None)
print(run.recording.trace_hash)
"""


@pytest.mark.slow
def test_a_run_that_compiles_its_kernels_has_the_trace_of_one_that_loads_them(tmp_path: Path) -> None:
    compiled, loaded = _trace(tmp_path, "platoon"), _trace(tmp_path, "platoon")
    assert compiled == loaded
    files = {file.name for file in (tmp_path / "kernels").iterdir()}
    _trace(tmp_path, "obstacles")
    assert {file.name for file in (tmp_path / "kernels").iterdir()} == files, "another behaviour compiles nothing more"


def _trace(folder: Path, config: str) -> str:
    command = [sys.executable, "-c", TRACE, str(folder / "kernels"), str(CONFIGS / f"{config}.yaml")]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "changes"),
    [
        ("platoon", ["controller.disturbance=estimated"]),
        ("obstacles", ["controller.disturbance=none"]),
        ("platoon", ["tracker.source=truth"]),
        ("mocap", []),
    ],
)
def test_what_is_compiled_before_a_run_is_all_that_it_needs(config: str, changes: list[str]) -> None:
    command = [sys.executable, "-c", FIRST_CALLED, str(CONFIGS / f"{config}.yaml"), "run.duration_s=2", *changes]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 0, ran.stderr
    ready, late = json.loads(ran.stdout.splitlines()[-1])
    assert ready > 20
    assert not late


@kernel
def inner(x: float) -> float:
    return x + 1.0


@kernel
def outer(x: float) -> float:
    return 2.0 * inner(x)


def test_kernels_are_counted_with_those_that_they_call() -> None:
    assert reached(outer) == {inner, outer}


def test_progress_crosses_a_lifeline_and_other_words_are_none() -> None:
    progress = Progress(3, 14, 2.0, 8.25)
    assert decoded(progress.encode()) == progress
    assert decoded("ready") is None
    assert decoded("http://127.0.0.1:8080/#token") is None
