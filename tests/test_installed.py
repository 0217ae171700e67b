"""The project as others install it: a wheel, away from the repository, and a laboratory's first files."""

import os
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
from typer.testing import CliRunner

import robofleet
from robofleet import cli
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.operator import config_commands

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel, built from a copy: setuptools would leave its own folder in the tree."""
    folder, copy = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("tree")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    for name in ("robofleet", "drivers", "configs"):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--disable-pip-version-check"]
    subprocess.run([*build, "--wheel-dir", str(folder), str(copy)], check=True, capture_output=True)
    (found,) = folder.glob("robofleet-*.whl")
    return found


@pytest.mark.long
def test_a_wheel_holds_one_package_with_all_that_it_reads(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as files:
        names = files.namelist()
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"robofleet"}  # no ``drivers``, no ``tests``
    for folder in ("configs", "drivers"):
        ours = {
            str(file.relative_to(ROOT))
            for kind in ("py", "yaml", "ipynb")
            for file in (ROOT / folder).rglob(f"*.{kind}")
        }
        assert ours and {f"robofleet/{name}" for name in ours} <= set(names)
    for folder in ("operator/page/static", "operator/page/templates", "reports/templates"):
        ours = {str(file.relative_to(ROOT)) for file in (ROOT / "robofleet" / folder).iterdir()}
        assert ours and ours <= set(names)
    assert {"robofleet/py.typed", f"robofleet-{version('robofleet')}.dist-info/licenses/LICENSE"} <= set(names)


@pytest.mark.long
def test_a_wheel_runs_from_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    installed, empty = tmp_path / "installed", tmp_path / "empty"
    empty.mkdir()
    with zipfile.ZipFile(wheel) as files:
        files.extractall(installed)

    def command(*arguments: str) -> str:
        code = "import sys; from robofleet.cli import main; sys.exit(main())"
        return subprocess.run(
            [sys.executable, "-c", code, *arguments],
            cwd=empty,
            env=os.environ | {"PYTHONPATH": str(installed)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout

    assert "lab/platoon.yaml --web" in command("init", "lab")
    assert "can run" in command("check", "lab/platoon.yaml")


def test_the_starting_files_can_be_read(tmp_path: Path) -> None:
    done = CliRunner().invoke(cli.app, ["init", str(tmp_path / "lab")])
    assert done.exit_code == 0
    files = sorted((tmp_path / "lab").glob("*.yaml"))
    assert {file.name for file in files} >= {"lab.yaml", "platoon.yaml"}
    for file in files:
        assert f"{file}: " in done.output
        load_config(file)  # nothing in it is wrong
    assert f"python {tmp_path}/lab/examples/hello.py" in done.output
    theirs, ours = (
        {file.name for file in (folder / "examples").glob("*.*y*")} for folder in (tmp_path / "lab", SHIPPED)
    )
    assert theirs == ours > {"hello.py"}


def test_init_leaves_what_is_there(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("arena: {}\n")
    done = CliRunner().invoke(cli.app, ["init", str(tmp_path)])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert "not empty" in done.stderr
    assert list(tmp_path.iterdir()) == [mine]


def test_init_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> dict[str, object]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(config_commands.schemas, "schema", full)
    done = CliRunner().invoke(cli.app, ["init", str(tmp_path / "lab")])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert "No space left on device" in done.stderr
    assert not [*(tmp_path / "lab").iterdir()]


def test_the_version_is_told() -> None:
    done = CliRunner().invoke(cli.app, ["--version"])
    assert (done.exit_code, done.output) == (0, f"robofleet {version('robofleet')}\n")


def test_every_public_name_is_there() -> None:
    assert {name: getattr(robofleet, name) for name in robofleet.__all__}.keys() == set(robofleet.__all__)
    with pytest.raises(AttributeError, match="nothing"):
        robofleet.nothing  # noqa: B018


@pytest.mark.slow
def test_a_script_beside_a_clone_finds_the_package_and_not_the_clone(tmp_path: Path) -> None:
    (tmp_path / "robofleet").mkdir()  # as a clone is named
    (tmp_path / "hello.py").write_text("import robofleet\nprint(robofleet.Fleet)\n")
    done = subprocess.run([sys.executable, tmp_path / "hello.py"], capture_output=True, text=True, check=False)
    why = "an environment of before pyproject.toml had a package-dir: install it again, pip install -e '.[dev]'"
    assert done.stdout == f"{robofleet.Fleet}\n", f"{why}: {done.stderr}"
