"""What editors read of a configuration, and the list of every key for people."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from robofleet.config.files.robot_file import RobotFile
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.schema import schema
from robofleet.core.settings import Model

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
VALIDATOR = Draft202012Validator(schema())
TOOL = "tools/config_reference.py"


def platoon(**parts: Any) -> Any:
    """Return the shipped configuration as it is written, with some parts instead of its own."""
    return yaml.safe_load((CONFIGS / "platoon.yaml").read_text()) | parts


SETTINGS = platoon()["groups"][0]["settings"]


def faults_of(tree: Any) -> list[str]:
    """Return the dotted paths at which the schema finds a fault."""
    return [".".join(map(str, error.absolute_path)) for error in VALIDATOR.iter_errors(tree)]


def models(kind: type[Model] = Model) -> list[type[Model]]:
    """Return every part that a configuration may have."""
    return [kind, *(model for child in kind.__subclasses__() for model in models(child))]


def test_every_key_has_a_description() -> None:
    mute = [
        f"{model.__name__}.{key}"
        for model in models()
        if model.__module__.startswith("robofleet.config")
        for key, field in model.model_fields.items()
        if not field.description
    ]
    assert mute == []


def test_the_schema_is_one() -> None:
    Draft202012Validator.check_schema(schema())


def test_a_named_file_and_what_it_holds_are_both_valid() -> None:
    assert faults_of(platoon()) == []
    assert faults_of(yaml.safe_load(resolved_yaml(load_config(CONFIGS / "platoon.yaml")))) == []
    kinds = [yaml.safe_load(file.read_text()) for file in (CONFIGS / "robots").glob("*.yaml")]
    assert kinds
    for vehicle in (*kinds, "mine/wide.yaml"):
        assert faults_of(platoon(robots=[robot | {"vehicle": vehicle} for robot in platoon()["robots"]])) == []


@pytest.mark.parametrize("file", sorted((CONFIGS / "faults").glob("*.yaml")), ids=lambda file: file.stem)
def test_shipped_faults_are_valid(file: Path) -> None:
    assert faults_of(platoon(**yaml.safe_load(file.read_text()))) == []


@pytest.mark.parametrize(
    ("part", "path"),
    [
        ({"run": {"duration_s": 0}}, "run.duration_s"),
        ({"run": {"duration_s": 88, "sed": 1}}, "run"),
        ({"run": {}}, "run"),
        ({"groups": []}, "groups"),
        (
            {"groups": [platoon()["groups"][0] | {"settings": {**SETTINGS, "path": "no name"}}]},
            "groups.0.settings.path",
        ),
        ({"groups": [platoon()["groups"][0] | {"settings": {**SETTINGS, "spacing": 1}}]}, "groups.0.settings"),
        ({"groups": [{"behaviour": "platoon", "robots": ["r1"]}]}, "groups.0"),
        ({"arena": {"name": "A", "size_m": [3, 2]}}, "arena.name"),
        ({"arena": {"name": "a", "size_m": [3]}}, "arena.size_m"),
        ({"camera": platoon()["camera"] | {"trigger": "tik"}}, "camera.trigger"),
        ({"faults": [{"kind": "lost", "topics": ["cmd"], "share": 2}]}, "faults.0"),
    ],
)
def test_a_mistake_is_marked_where_it_is(part: dict[str, Any], path: str) -> None:
    assert faults_of(platoon(**part)) == [path]


def test_the_list_of_every_key_is_up_to_date() -> None:
    done = subprocess.run([sys.executable, TOOL, "--check"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""  # else it says which command brings it up to date
    assert done.returncode == 0


def test_the_list_of_every_key_has_its_unit_range_default_and_meaning() -> None:
    text = "\n".join(page.read_text() for page in (CONFIGS / "keys").glob("*.md"))
    assert re.search(r"^\| `exposure_s` \| s \| 1e-07 to 1 \| `0.004` \| .+ \|$", text, re.MULTILINE)
    assert re.search(
        r"^\| `max_wheel_acceleration_rad_s2` \| rad/s² \| 0.01 to 1e\+06 \| \*\*required\*\* \| .+ \|$",
        text,
        re.MULTILINE,
    )
    assert re.search(r"^\| `integrator` \|  \| `exact`, `euler` \| `\"exact\"` \| .+ \|$", text, re.MULTILINE)
    robots_own = RobotFile.__module__  # a file of a robot's computer, no part of a configuration
    keys = {
        key
        for model in models()
        if model.__module__.startswith("robofleet.config") and model.__module__ != robots_own
        for key in model.model_fields
    }
    assert {key for key in keys if f"| `{key}` |" not in text} == set()
