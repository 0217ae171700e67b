"""A behaviour from outside the project: its own figures are in everything that a run leaves, and nothing knows it."""

import csv
import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from struct import pack
from typing import Any
from zlib import crc32

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader

from robofleet.config.groups import descriptions
from robofleet.recording.log import FILE
from robofleet.recording.reading import about, read
from robofleet.reports import after
from robofleet.reports.layouts.layouts import VIEWERS
from tests.command import robofleet
from tests.recording_fixtures import PLATOON

SWIRL = """
import numpy as np

from robofleet.behaviours.interface import Behaviour, Decision, Dots, Figure, Measure
from robofleet.core.settings import Model


class Swirl(Behaviour):
    class Settings(Model):
        speed_m_s: float = 0.03

    figures = (Figure("radius", "m", "mm", "distance of the centre from the arena's"),)

    def decide(self, now):
        bodies = np.tile([self.settings.speed_m_s, 0.3], (len(now.poses), 1))
        radius = np.hypot(now.poses[:, 0], now.poses[:, 1])
        return Decision(bodies, of="body", figures={"radius": radius})

    def shapes(self):
        return (Dots("posts", np.array([[0.1, 0.2], [0.3, 0.4]])),)

    def measures(self, past):
        gap = np.linalg.norm(past.poses[:, 0, :2] - past.poses[:, 1, :2], axis=-1)
        return (Measure("gap", "m", gap[:, None], ("both",), "mm", asked=0.6),)
"""
SHORT = "tracker.source=truth", "run.duration_s=3", "run.bounds={}"
GROUPS = """groups:
  - {name: snake, behaviour: platoon, robots: [r1, r2], settings: {path: platoon, spacing_m: 0.25, path_rate: 0.0455}}
  - {name: swirl, behaviour: "mylab:Swirl", robots: [r3, r4]}
"""

pytestmark = pytest.mark.slow  # of a fixture: a run of their own behaviour, and its report


@pytest.fixture(scope="module")
def mylab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write the behaviour into an empty folder from which modules are loaded."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "mylab.py").write_text(SWIRL)
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))
    sys.modules.pop("mylab", None)


@pytest.fixture(scope="module")
def file(mylab: Path) -> Path:
    (file := mylab / "two.yaml").write_text(re.sub(r"^groups:\n(  .*\n)+", GROUPS, PLATOON.read_text(), flags=re.M))
    return file


@pytest.fixture(scope="module")
def folder(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what a run in lockstep left."""
    folder = tmp_path_factory.mktemp("runs") / "one"
    keys = [part for key in SHORT for part in ("--set", key)]
    ran = robofleet("run", file, "--lockstep", "--quiet", *keys, "--out", folder)
    assert ran.exit_code == 0, ran.output
    return folder


def test_its_figures_are_in_the_summary_beside_the_platoons(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    swirl, snake = summary["groups"]["swirl"], summary["groups"]["snake"]
    assert (swirl["behaviour"], swirl["robots"]) == ("mylab:Swirl", ["r3", "r4"])
    assert [round(mean) for mean in swirl["radius_mm"]["per_robot_mean"]] == pytest.approx([1480, 1420], abs=40)
    assert swirl["asked"] == {"gap_mm": 600}
    assert "radius_mm" not in snake
    assert summary["control_error_mm"] == snake["control_error_mm"], "one group alone has it"
    assert len(snake["control_error_mm"]["per_robot_mean"]) == 2


def test_its_columns_are_in_the_table_and_empty_for_others(folder: Path) -> None:
    with (folder / "metrics.csv").open() as text:
        rows = list(csv.DictReader(text))
    assert {(row["robot"], row["group"]) for row in rows} == {
        ("r1", "snake"), ("r2", "snake"), ("r3", "swirl"), ("r4", "swirl")
    }  # fmt: skip
    for row in [row for row in rows if int(row["run_tick"]) >= 0]:
        swirls = row["group"] == "swirl"
        assert (row["radius_mm"] != "", row["gap_mm"] != "", row["control_error_mm"] == "") == (swirls,) * 3
        if swirls:
            assert float(row["radius_mm"]) == pytest.approx(1e3 * np.hypot(float(row["x_m"]), float(row["y_m"])), abs=2)


def test_the_page_plots_them(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    for title in ("Radius of swirl", "Gap of swirl", "Control error of snake"):
        assert f"<h3>{title}</h3>" in page
    assert "Control error of swirl" not in page


def test_viewers_have_them_as_fields_of_the_groups_own_message(folder: Path) -> None:
    fields: dict[str, set[str]] = {}
    with (folder / FILE).open("rb") as stream:
        reader = make_reader(stream)
        for schema, channel, message in reader.iter_messages():
            if channel.topic == "/arena":
                shapes = {entity.id: entity for entity in SceneUpdate.FromString(message.data).entities}
            if channel.topic.endswith("/tick") and channel.topic not in fields and schema is not None:
                (file,) = FileDescriptorSet.FromString(schema.data).file if schema.encoding == "protobuf" else (None,)
                fields[channel.topic] = {f.name for f in file.message_type[0].field} if file else set()
    assert {"radius_mm", "gap_mm"} <= fields["/robots/r3/tick"]
    assert {"radius_mm", "gap_mm"}.isdisjoint(fields["/robots/r1/tick"])
    assert {"control_error_mm", "spacing_mm"} <= fields["/robots/r1/tick"]
    assert set(shapes) == {"arena", "snake/path", "swirl/posts"}
    assert [(dot.pose.position.x, dot.pose.position.y) for dot in shapes["swirl/posts"].spheres] == [
        (0.1, 0.2),
        (0.3, 0.4),
    ]
    recording = about(folder)
    for viewer in VIEWERS.values():
        assert b"radius_mm" in viewer.make(recording, folder / FILE) or viewer.file == "rerun.rbl"


def test_where_it_is_missing_the_file_says_what_it_told(folder: Path, mylab: Path, tmp_path: Path) -> None:
    (run_folder := tmp_path / "run").mkdir()
    (run_folder / FILE).write_bytes((folder / FILE).read_bytes())
    (mylab / "mylab.py").rename(mylab / "gone.py")
    sys.modules.pop("mylab")
    try:
        made = after.report(run_folder, imports=lambda _: True)
        groups = read(run_folder).groups
    finally:
        (mylab / "gone.py").rename(mylab / "mylab.py")
    assert made.summary["groups"]["swirl"]["radius_mm"]["mean"] == pytest.approx(1450, abs=60)
    assert "gap_mm" not in made.summary["groups"]["swirl"], "a measure needs the behaviour"
    assert "<h3>Radius of swirl</h3>" in made.page.read_text()
    assert [group.plain() for group in groups] == [group.plain() for group in read(folder).groups]
    assert [group.plain() for group in groups] == [group.plain() for group in descriptions(read(folder).config)]


STRANGE = """
from pathlib import Path

Path(__file__).with_suffix(".ran").touch()
"""


@pytest.fixture
def elsewhere(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the run in a folder that came from a stranger, where Python would find a module of theirs."""
    (run_folder := tmp_path / "run").mkdir()
    (run_folder / FILE).write_bytes((folder / FILE).read_bytes())
    for runs_folder in (tmp_path, run_folder):
        (runs_folder / "mylab.py").write_text(STRANGE)
        monkeypatch.syspath_prepend(runs_folder)
    monkeypatch.chdir(run_folder)
    monkeypatch.delitem(sys.modules, "mylab")
    return run_folder


def looked_at(run: Path) -> list[list[str]]:
    return [["report", str(run)], ["report", str(run), str(run)], *(["layout", viewer, str(run)] for viewer in VIEWERS)]


def test_what_only_a_recording_names_is_not_imported(elsewhere: Path) -> None:
    for arguments in looked_at(elsewhere):
        ran = robofleet(*arguments)
        assert ran.exit_code == 0, ran.output
        (line,) = ran.stderr.splitlines()
        assert line == "Swirl's own measures are left out: add `--behaviours DIR`, the folder of mylab"
    for command in ("replay", "gap"):
        ran = robofleet(command, elsewhere)
        assert (ran.exit_code, ran.stderr) == (
            2,
            f"{elsewhere}: Swirl cannot be replayed: add `--behaviours DIR`, the folder of mylab\n",
        )
    assert not list(elsewhere.parent.rglob("*.ran"))


def test_where_the_file_does_not_describe_its_groups_it_is_refused(elsewhere: Path) -> None:
    data = (elsewhere / FILE).read_bytes()
    first = data.index(b"groups.json") - 20  # behind two instants and a length
    last = first - 8 + int.from_bytes(data[first - 8 : first], "little") + 8 - 4
    renamed = data[first:last].replace(b"groups.json", b"others.json")
    (elsewhere / FILE).write_bytes(data[:first] + renamed + pack("<I", crc32(renamed)) + data[last + 4 :])
    for arguments in looked_at(elsewhere):
        ran = robofleet(*arguments)
        assert ran.exit_code == 2, ran.output
        (line,) = ran.stderr.splitlines()
        assert "which figures its groups have: mylab:Swirl is needed: add `--behaviours DIR`, the folder of its" in line
    assert not list(elsewhere.parent.rglob("*.ran"))


def test_a_later_report_imports_it_from_the_folder_that_the_user_names(
    folder: Path, mylab: Path, tmp_path: Path
) -> None:
    report = ["report", str(folder), "--behaviours"]
    ran = robofleet(*report, mylab)
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert "<h3>Gap of swirl</h3>" in (folder / "report.html").read_text()
    ran = robofleet("replay", folder, "--behaviours", mylab)
    assert ran.exit_code == 0, ran.output
    ran = robofleet(*report, tmp_path)
    assert ran.exit_code == 0
    assert f"mylab is not in {tmp_path}" in ran.stderr
    assert robofleet("replay", folder, "--behaviours", tmp_path).exit_code == 2
    (tmp_path / "mylab.py").write_text("")
    ran = robofleet(*report, tmp_path)
    assert ran.exit_code == 2
    assert "Python has another module 'mylab'" in ran.stderr


@pytest.mark.parametrize(
    "broken", ["return 1 / 0", "return (Measure('gap', 'm', np.zeros(3), ('both',)),)", "return [object()]"]
)
def test_what_it_cannot_measure_is_missing_and_nothing_else(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    space: dict[str, Any] = {}
    exec(SWIRL.replace("gap = np", f"{broken}\n        gap = np"), space)
    monkeypatch.setattr(import_module("mylab"), "Swirl", space["Swirl"])
    recording = read(folder, lambda _: True)
    from robofleet.reports.metrics import summary

    figures = summary(recording, name="two", mode="lockstep", outcome="completed", cause=None)
    assert figures["control_error_mm"] is not None
    stderr = capsys.readouterr().err
    assert stderr.count("group swirl: mylab:Swirl cannot measure: its figures are missing") == 1
    assert "Traceback" in stderr
