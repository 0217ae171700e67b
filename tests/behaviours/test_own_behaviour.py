"""A behaviour in a file beside the configuration: it is found, runs, and has its figures; what is wrong is one line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robofleet.behaviours.interface import statistics
from robofleet.config import groups
from robofleet.config.load import ConfigError, load_config
from robofleet.core.plugins import PluginError, load, reach
from robofleet.runs import check_behaviours

CONFIGS = Path(__file__).parents[2] / "configs"
SWIRL = (CONFIGS / "swirl.yaml").read_text()


@pytest.fixture(autouse=True)
def _own_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of one test are found by no other."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delenv("ROBOFLEET_MODULES", raising=False)


def laboratory(folder: Path, module: str, code: str = (CONFIGS / "mylab.py").read_text()) -> Path:
    """Write a behaviour's file and a configuration that names it."""
    folder.mkdir(exist_ok=True)
    (folder / f"{module}.py").write_text(code)
    file = folder / "own.yaml"
    file.write_text(SWIRL.replace("mylab:", f"{module}:"))
    return file


def refused(file: Path, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(file, overrides)
    (fault,) = caught.value.faults
    return fault


def test_the_shipped_one_is_short() -> None:
    assert len((CONFIGS / "mylab.py").read_text().splitlines()) <= 25


@pytest.mark.slow
def test_it_is_found_beside_its_configuration_here_and_in_processes_started_from_here(tmp_path: Path) -> None:
    file = laboratory(tmp_path / "lab", "found_lab")
    config = load_config(file)
    assert groups.kind(config.groups[0]).__module__ == "found_lab"
    assert config.groups[0].settings == {"radius_m": 0.5, "speed_m_s": 0.1}
    found = "from robofleet.core.plugins import load; print(load('robofleet.behaviours', 'found_lab:Swirl').__module__)"
    child = [sys.executable, "-c", f"{found}; import found_lab; print(found_lab.__file__)"]
    done = subprocess.run(child, cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["found_lab", str(tmp_path / "lab" / "found_lab.py")]


def test_its_settings_are_judged_as_all_others(tmp_path: Path) -> None:
    file = laboratory(tmp_path, "judged_lab")
    file.write_text(file.read_text().replace("radius_m: 0.5", "radius_m: 0.5, sped_m_s: 1"))
    hint = "unknown key: did you mean 'speed_m_s'?"
    assert refused(file) == f"{file}:11:31: groups.0.settings.sped_m_s: {hint}"


def test_a_file_that_is_not_there_is_said_to_be_missing(tmp_path: Path) -> None:
    file = laboratory(tmp_path, "gone_lab")
    (tmp_path / "gone_lab.py").unlink()
    assert refused(file) == (
        f"{file}:8:16: groups.0.behaviour: 'gone_lab:Swirl' cannot be loaded: No module named 'gone_lab': mend its "
        "name, or install its package, or put gone_lab.py beside the configuration"
    )


@pytest.mark.parametrize(
    ("module", "code", "words"),
    [
        ("raising_lab", "import math\nx = undefined\n", "name 'undefined' is not defined: mend line 2 of "),
        ("unread_lab", "x = (\n", "mend line 1 of "),
        ("empty_lab", "", "has no attribute 'Swirl'"),
        ("other_lab", "class Swirl: ...\n", "is not a behaviour: derive it from robofleet.behaviours.Behaviour"),
        (
            "idle_lab",
            "from robofleet.behaviours import Behaviour\n\nclass Swirl(Behaviour): ...\n",
            "decides nothing: write its method `decide`",
        ),
        (
            "unset_lab",
            "from robofleet.behaviours import Behaviour\n\nclass Swirl(Behaviour):\n    class Settings: ...\n",
            "has Settings that are no pydantic model: derive them from pydantic.BaseModel",
        ),
        (
            "counted_lab",
            "from robofleet.behaviours import Behaviour\n\nclass Swirl(Behaviour):\n    Settings = 3\n",
            "has Settings that are no pydantic model: derive them from pydantic.BaseModel",
        ),
        (
            "array_lab",
            "import numpy as np\nfrom robofleet.behaviours import Behaviour\n\nclass Swirl(Behaviour):\n"
            "    class Settings(Behaviour.Settings):\n        gains: np.ndarray\n",
            "mend line 5 of ",
        ),
    ],
)
def test_a_file_that_cannot_be_used_says_where_to_mend_it(tmp_path: Path, module: str, code: str, words: str) -> None:
    fault = refused(laboratory(tmp_path, module, code))
    assert f"groups.0.behaviour: '{module}:Swirl' " in fault
    assert words in fault


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("def __init__(self, settings, team): ...", "its `__init__` must call `super().__init__(settings, team)`"),
        ("def __init__(self, settings, team): {}['gain']", "raised KeyError: 'gain': mend line 7 of "),
        ("def bounds(self): return [1]", "`bounds` gives 1: it must be a Bound"),
        ("def start(self, poses): ...", "`start` gives None: it must be a Start"),
        ("def shapes(self): return 1 / 0", "raised ZeroDivisionError: division by zero: mend line 7 of "),
        ("figures = ('off',)", "`figures` gives 'off': it must be a Figure"),
    ],
)
def test_a_class_that_no_run_could_use_is_refused_before_anything_is_started(
    tmp_path: Path, method: str, words: str
) -> None:
    head = "import numpy as np\nfrom robofleet.behaviours import Behaviour\n\nclass Swirl(Behaviour):\n"
    settings = "    class Settings(Behaviour.Settings): radius_m: float = 0.5\n"
    code = f"{head}{settings}    def decide(self, now): ...\n    {method}\n"
    ((path, complaint),) = check_behaviours.complaints(load_config(laboratory(tmp_path, f"{tmp_path.name}_lab", code)))
    assert path == "groups.0.behaviour"
    assert words in complaint


def test_a_name_that_python_has_already_is_refused(tmp_path: Path) -> None:
    fault = refused(laboratory(tmp_path, "statistics"))
    assert "Python has another module 'statistics'" in fault
    assert f"rename {tmp_path / 'statistics.py'}" in fault


def test_two_folders_with_one_name_are_not_mixed_up(tmp_path: Path) -> None:
    load_config(laboratory(tmp_path / "one", "twice_lab"))
    assert f"rename {tmp_path / 'two' / 'twice_lab.py'}" in refused(laboratory(tmp_path / "two", "twice_lab"))


def test_drivers_and_cameras_are_found_there_too(tmp_path: Path) -> None:
    (tmp_path / "driving_lab.py").write_text("class Mine: ...\n")
    with pytest.raises(PluginError):
        load("robofleet.drivers", "driving_lab:Mine")
    reach(tmp_path, "driving_lab:Mine")
    assert load("robofleet.drivers", "driving_lab:Mine").__name__ == "Mine"


def test_means_keep_the_sign_of_a_figure_and_its_largest_is_a_magnitude() -> None:
    figures = statistics(np.array([[1.0, -4.0], [2.0, np.nan]]))
    assert figures == {"mean": -0.3333, "max": 4.0, "per_robot_mean": [1.5, -4.0]}
