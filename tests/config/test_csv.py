"""CSV files that a configuration names: their rows become the configuration's, and each fault has its line."""

from pathlib import Path

import pytest
import yaml

from robofleet.config.load import ConfigError, load_config, resolved_yaml
from robofleet.runs.check import load_checked

CONFIGS = Path(__file__).parents[2] / "configs"


def laboratory(folder: Path, table: str | bytes, name: str = "way.csv") -> Path:
    """Write a configuration of one robot that follows a CSV file, and return it."""
    tree = yaml.safe_load((CONFIGS / "track.yaml").read_text())
    tree["robots"] = tree["robots"][:1]
    tree["groups"] = [{"behaviour": "track", "robots": ["r1"], "settings": {"references": {"r1": {"csv": name}}}}]
    file = folder / "lab.yaml"
    file.write_text(yaml.safe_dump(tree))
    (folder / "way.csv").write_bytes(table if isinstance(table, bytes) else table.encode())
    return file


def faults(file: Path) -> list[str]:
    with pytest.raises(ConfigError) as error:
        load_checked(file, lockstep=True)
    return [line.removeprefix(f"{file.parent}/") for line in error.value.faults]


def test_rows_take_the_names_place_and_a_recording_needs_no_file(tmp_path: Path) -> None:
    file = laboratory(tmp_path, "\ufefft_s, x_m, y_m\r\n0,-0.6,0\r\n\r\n5, -0.5, 0.1\r\n1e1,-0.3,0.1\r\n")
    config = load_checked(file, lockstep=True)
    rows = config.groups[0].settings["references"]["r1"]["csv"]
    assert [list(row) for row in rows] == [[0.0, -0.6, 0.0], [5.0, -0.5, 0.1], [10.0, -0.3, 0.1]]
    (tmp_path / "way.csv").unlink()
    file.write_text(resolved_yaml(config))
    assert load_config(file) == config


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ("x,y,t\n0,0,0\n", "way.csv:1:1: the first line must be t_s,x_m,y_m, not 'x,y,t'"),
        ("", "way.csv:1:1: the first line must be t_s,x_m,y_m, not ''"),
        (b"t_s,x_m,y_m\n\xff\n", "way.csv:1:1: is not UTF-8 text"),
        ("t_s,x_m,y_m\n0,0,0\n1,left,0\n", "way.csv:3:3: groups.0.settings.references.r1.csv.1.1: x_m must be"),
        ("t_s,x_m,y_m\n0,0,0\n1,0,nan\n", "way.csv:3:5: groups.0.settings.references.r1.csv.1.2: y_m must be"),
        ("t_s,x_m,y_m\n0,0,0\n1,0\n", "way.csv:3:1: groups.0.settings.references.r1.csv.1: must have 3 numbers"),
        ("t_s,x_m,y_m\n0,0,0\n", "way.csv:1:1: groups.0.settings.references.r1.csv: needs 2 or more, has 1"),
        ("t_s,x_m,y_m\n0,0,0\n9,0,5000\n", "way.csv:3:5: groups.0.settings.references.r1.csv.1.2: must be at most"),
        ("t_s,x_m,y_m\n5,0,0\n\n3,0.1,0\n", "way.csv:4:1: groups.0.settings.references.r1.csv.1.0: 3 s does not come"),
        ("t_s,x_m,y_m\n0,0,0\n1,1,0\n", "way.csv:1:1: groups.0.settings.references.r1.csv: the fastest wheel"),
    ],
)  # fmt: skip
def test_each_fault_has_its_line(tmp_path: Path, table: str | bytes, complaint: str) -> None:
    found = faults(laboratory(tmp_path, table))
    assert found[0].startswith(complaint), found


def test_a_name_that_is_no_csv_file(tmp_path: Path) -> None:
    assert "is no path that ends in .csv: write way.csv" in faults(laboratory(tmp_path, "", "way"))[0]
    assert "there is no file" in faults(laboratory(tmp_path, "", "other.csv"))[0]
    (tmp_path / "folder.csv").mkdir()
    assert "cannot be read: Is a directory" in faults(laboratory(tmp_path, "", "folder.csv"))[0]


@pytest.mark.parametrize("name", ["track", "formation", "consensus", "cyclic-pursuit", "coverage"])
def test_shipped_configurations_can_work(name: str) -> None:
    config = load_checked(CONFIGS / f"{name}.yaml", lockstep=True)
    assert config.groups[0].behaviour == name.replace("-", "_")
