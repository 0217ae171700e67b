"""No process imports a module of the folder where it is started, nor one beside a configuration that has its name."""

import ast
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from tests.runs.realrun import own_folders

ROOT = Path(__file__).parents[1]
PROGRAM = str(Path(sys.executable).with_name("robofleet"))


def _files(names: Iterable[str]) -> set[str]:
    """Return which modules are files: one that is spread over folders (a namespace) gives way to any file."""
    specs = {name: find_spec(name) for name in names if name.isidentifier()}
    return {name for name, spec in specs.items() if spec is not None and spec.origin not in (None, "built-in")}


@cache
def packages() -> set[str]:
    return _files({*packages_distributions()} - {"robofleet"})


@cache
def standard() -> set[str]:
    return _files(sys.stdlib_module_names)


LEAVES_A_MARK = """\
import posix, sys
mark = posix.open({mark!r}, posix.O_WRONLY | posix.O_CREAT | posix.O_APPEND, 0o644)
posix.write(mark, f"{{__name__}}: {{sys.orig_argv}}\\n".encode())
raise SystemExit(3)
"""
CONFIG = """\
arena: {name: own, size_m: [3.2, 2.0]}
robots: [{id: r1, tag: 1, vehicle: gternal, driver: "mylab:Robot", start: {x_m: 0, y_m: 0, heading_deg: 0}}]
groups: [{behaviour: script, robots: [r1]}]
controller: {tick_s: 0.033, alpha: 45, horizon_s: 0.6, point_ahead_m: 0.08}
tracker: {source: truth, tag_side_m: 0.07, tag_height_m: 0.08}
camera: {model: overhead, width: 1280, height: 720, rate_hz: 30, trigger: tick}
run: {duration_s: 60}
"""
DRIVER = "from robofleet.drivers.simulated import SimulatedRobot\n\nclass Robot(SimulatedRobot): ...\n"
SCRIPT = """\
import sys
import robofleet
with robofleet.Fleet(sys.argv[1], out=sys.argv[2]) as fleet:
    for _ in fleet.ticks(0.5):
        pass
"""
WORK = """\
from robofleet.studies.cluster import opened
if __name__ == "__main__":
    with opened("local", 2) as engine:
        print(sorted(finished.result for finished in engine.each(abs, [1, -2])))
"""


class Trap:
    """A folder that has modules of many names, each of which leaves a mark when it is imported."""

    def __init__(self, folder: Path, names: Iterable[str]) -> None:
        self.folder, self._mark = folder, folder / "mark"
        for name in names:
            (folder / f"{name}.py").write_text(LEAVES_A_MARK.format(mark=str(self._mark)))

    def run(self, *command: str, env: dict[str, str] | None = None) -> str:
        """Run a command there; nothing of the folder was imported."""
        done = subprocess.run(
            command, cwd=self.folder, env=env, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=300,
            check=False,
        )  # fmt: skip
        assert not self._mark.exists(), self._mark.read_text()
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture
def trap(tmp_path: Path) -> Trap:
    (tmp_path / "trap").mkdir()
    return Trap(tmp_path / "trap", {*packages(), *standard(), "robofleet"})


def test_the_trap_catches_who_imports_from_there(trap: Trap) -> None:
    with pytest.raises(AssertionError, match="yaml: "):
        trap.run(sys.executable, "-c", "import yaml")


@pytest.mark.slow
def test_nothing_of_it_is_imported_by_the_workers_of_a_storm_or_a_sweep(trap: Trap, tmp_path: Path) -> None:
    (tmp_path / "work.py").write_text(WORK)
    assert trap.run(sys.executable, str(tmp_path / "work.py")) == "[1, 2]\n"


@pytest.mark.slow
def test_nothing_of_it_is_imported_by_the_doctor(trap: Trap) -> None:
    trap.run(PROGRAM, "doctor")


@pytest.mark.slow
def test_nothing_of_it_is_imported_by_a_command_that_python_starts_as_a_module(tmp_path: Path) -> None:
    """Python itself looks there for its own modules, before anybody can forbid it."""
    trap = Trap(tmp_path, packages())
    assert "can run" in trap.run(sys.executable, "-m", "robofleet", "check", str(ROOT / "configs" / "swirl.yaml"))


@pytest.mark.slow
@pytest.mark.usefixtures("alone")
def test_nothing_of_it_is_imported_by_a_run_in_real_time_whose_own_driver_is_there(trap: Trap, tmp_path: Path) -> None:
    """The script, its run and the run's processes start there, and the configuration stands there, too."""
    (trap.folder / "lab.yaml").write_text(CONFIG)
    (trap.folder / "mylab.py").write_text(DRIVER)
    (tmp_path / "drive.py").write_text(SCRIPT)
    drive = (sys.executable, str(tmp_path / "drive.py"), str(trap.folder / "lab.yaml"), str(tmp_path / "run"))
    trap.run(*drive, env=own_folders(tmp_path))
    assert yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["robots"][0]["driver"] == "mylab:Robot"


def test_a_module_beside_a_script_is_found_by_its_run(tmp_path: Path) -> None:
    """As Python finds it for the script."""
    (tmp_path / "beside.py").write_text("class Mine: ...\n")
    (tmp_path / "script.py").write_text(
        "import os, subprocess, sys\nfrom pathlib import Path\nfrom robofleet.core.plugins import reach\n"
        "assert not reach(Path('configs'), 'beside:Mine')\n"
        'load = \'from robofleet.core.plugins import load; load("robofleet.drivers", "beside:Mine")\'\n'
        "sys.exit(subprocess.run([sys.executable, '-P', '-c', load], cwd='/').returncode)\n"
    )
    subprocess.run([sys.executable, str(tmp_path / "script.py")], cwd="/", check=True)


def test_whoever_starts_a_python_forbids_it_the_current_folder() -> None:
    found = {}
    for folder in ("robofleet", "drivers"):
        for file in (ROOT / folder).rglob("*.py"):
            text = file.read_text()
            for node in ast.walk(ast.parse(text)) if "sys.executable" in text else ():
                if isinstance(node, ast.List | ast.Tuple) and "sys.executable" in map(ast.unparse, node.elts):
                    option = ast.unparse(node.elts[[*map(ast.unparse, node.elts)].index("sys.executable") + 1])
                    found[f"{file.relative_to(ROOT)}:{node.lineno}"] = option
    assert len(found) > 7
    assert {where: option for where, option in found.items() if option not in ("'-P'", "'-I'")} == {}
