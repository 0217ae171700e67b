"""What a user names is no markup: brackets in a file's or a folder's name are shown as they are."""

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from robofleet.reports.tables import status_table
from tests.command import robofleet

CONFIGS = Path(__file__).parent.parent / "configs"
NAMES = ["a[/b]", "[bold]a", "a[/]", "[link=x]y", "a\\[b]"]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_check_shows_a_configurations_name(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name.replace('/', '')}.yaml"
    for given in (file, tmp_path / f"{name}.yaml"):
        given.parent.mkdir(exist_ok=True, parents=True)
        given.write_text((CONFIGS / "platoon.yaml").read_text())
        result = robofleet("check", given, env={"COLUMNS": "300"})
        assert (result.exit_code, result.exception) == (0, None)
        assert f"{given.name} can run" in result.stdout


@pytest.mark.parametrize("name", NAMES)
def test_status_shows_a_folders_name(name: str) -> None:
    robot = {"id": "r1", "gate": "open", "latch": "none", "battery": 0.5, "age_ms": 1.0, "halted": name}
    status = {"arena": name, "phase": name, "cause": name, "folder": name, "started": "", "pid": 1, "robots": [robot]}
    console = Console(width=200, record=True, file=StringIO())
    console.print(status_table(status))
    assert console.export_text().count(name) == 5
