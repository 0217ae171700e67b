"""What is compiled once is loaded by later processes, whatever happened to files and models meanwhile."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from robofleet.kernels import store

MODELS = """
import sys
from pathlib import Path
from robofleet.kernels import model, store

store.folder = lambda: Path(sys.argv[1])

def made(pull):
    def inner(x):
        return pull * x
    def outer(x):
        return inner(x) + 1.0
    return model(outer)

for pull in map(float, sys.argv[2:]):
    compiled = made(pull)
    print(compiled(1.0), sum(compiled.stats.cache_hits.values()))
"""
FLOW = """
import numpy as np
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant

PULL = 3.0
plant = Plant(lambda x, u: PULL * u, lambda x: x.copy(), 1, 1)
flow = NewtonRaphsonFlow(plant, FlowSettings(20.0, 0.5, 0.01), [2.0])
flow.update(np.zeros(1), np.ones(1))
print(round(float(flow.prediction[0]), 9), sum(flow.compiled_step.stats.cache_hits.values()))
"""
Said = list[tuple[float, bool]]


def started(source: str, *arguments: object) -> "subprocess.Popen[str]":
    """Start a process; its functions stand in no file."""
    command = [sys.executable, "-c", source, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def said(process: "subprocess.Popen[str]") -> Said:
    """Return what each model gave, and whether it was loaded."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [(float(line.split()[0]), line.split()[1] == "1") for line in out.splitlines()]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that two processes have filled at the same time, with a common model and one of each one's own."""
    folder = tmp_path_factory.mktemp("kernels")
    both = [started(MODELS, folder, 2.0, 3.0), started(MODELS, folder, 2.0, 4.0)]
    assert [[value for value, _ in said(one)] for one in both] == [[3.0, 4.0], [3.0, 5.0]]
    return folder


@pytest.fixture
def folder(kept: Path, tmp_path: Path) -> Path:
    return shutil.copytree(kept, tmp_path / "kernels")


def test_another_process_loads_what_was_compiled_and_never_another_model(folder: Path) -> None:
    """Models of one factory, compiled as the second in their processes: numba gives them one name."""
    assert said(started(MODELS, folder, 4.0, 3.0, 2.0)) == [(5.0, True), (4.0, True), (3.0, True)]


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-100])


def emptied(file: Path) -> None:
    file.write_bytes(b"")


def changed(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def test_a_damaged_file_is_compiled_anew(folder: Path) -> None:
    for file, damage in zip(sorted(folder.iterdir()), (cut, emptied, changed), strict=True):
        damage(file)
    assert said(started(MODELS, folder, 2.0, 3.0, 4.0)) == [(3.0, False), (4.0, False), (5.0, False)]
    assert said(started(MODELS, folder, 2.0, 3.0, 4.0)) == [(3.0, True), (4.0, True), (5.0, True)]


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    assert said(started(MODELS, tmp_path / "file" / "kernels", 3.0)) == [(4.0, False)]


def test_what_nobody_has_read_for_longest_makes_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_LARGEST", 250)
    for age, name in enumerate("abc"):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    store._make_room(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["b", "c"]


@pytest.mark.slow
def test_a_second_process_loads_a_users_flow() -> None:
    ((predicted, _),) = said(started(FLOW))
    assert predicted == 3.0
    assert said(started(FLOW)) == [(3.0, True)]


def test_importing_changes_nothing() -> None:
    source = "import numba; before = numba.config.CACHE_DIR; import robofleet.control.flow, sys; "
    subprocess.run([sys.executable, "-c", f"{source}sys.exit(numba.config.CACHE_DIR != before)"], check=True)
