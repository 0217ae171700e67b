"""The scripts of ``tools/`` where their packages are not installed."""

import subprocess
import sys
from pathlib import Path

import packages
import pytest
from typer.testing import CliRunner

from robofleet import cli

TOOLS = Path(__file__).parents[1] / "tools"
NEEDED = {  # a package that each needs, and the extras that bring it
    "bench": ("cv2", ".[bench,lab]"),
    "calibrate": ("cv2", ".[lab]"),
    "compile_kernels": ("numba", ".[lab]"),
    "config_reference": ("typer", "."),
    "large_fleet": ("cv2", ".[bench,lab]"),
    "tag_sheet": ("matplotlib", ".[lab]"),
}


GROUPS = {"calibrate": ["intrinsics"], "tag_sheet": ["tags"]}  # without a command they show their help


def test_every_script_is_tried() -> None:
    scripts = {file.stem for file in TOOLS.glob("*.py") if "__main__" in file.read_text()}
    assert scripts == set(NEEDED)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("tool", NEEDED)
def test_a_script_without_its_packages_says_in_one_line_what_to_install(tool: str) -> None:
    package, extras = NEEDED[tool]
    script = TOOLS / f"{tool}.py"
    lines = (
        f"sys.modules[{package!r}] = None",
        f"sys.path.insert(0, {str(TOOLS)!r})",
        f"sys.argv = {[str(script), *GROUPS.get(tool, ())]}",
    )
    code = f"import runpy, sys; {'; '.join(lines)}; runpy.run_path({str(script)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"this needs {package}: ")
    assert f"'{extras}'" in line or "source " in line


@pytest.mark.slow
@pytest.mark.parametrize(("tool", "name"), [("calibrate", "calibrate"), ("tag_sheet", "sheet")])
def test_a_script_is_the_command_of_its_name(tool: str, name: str) -> None:
    script = subprocess.run(
        [sys.executable, TOOLS / f"{tool}.py", "--help"], capture_output=True, text=True, check=True
    )
    assert script.stdout == CliRunner().invoke(cli.app, [name, "--help"], prog_name="robofleet").stdout


def test_another_python_is_sent_to_the_one_of_this_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / ".venv" / "bin" / "python"
    own.parent.mkdir(parents=True)
    own.touch()
    monkeypatch.setattr(packages, "ROOT", tmp_path)
    with pytest.raises(SystemExit) as ended, packages.needing("lab"):
        raise ModuleNotFoundError("No module named 'cv2'", name="cv2")
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"this needs cv2: run it with {own}, or first: source {own.parent}/activate\n"
    with pytest.raises(ModuleNotFoundError), packages.needing("lab"):
        raise ModuleNotFoundError("No module named 'robofleet.nothing'", name="robofleet.nothing")
