"""A recorded run in Python: its tables are the report's figures, in each library, also of half a file."""

import csv
import re
import shutil
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import robofleet
from robofleet import RecordedRun, RobofleetError
from robofleet.bus.keys import PICTURE, POSES, TICK, key
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.bus.messages import Picture
from robofleet.core.clock import S
from robofleet.recording import reading
from robofleet.recording.columns import COLUMNS, write_csv
from robofleet.recording.log import FILE, LIBRARY, RunLog
from robofleet.reports import run_tables
from robofleet.reports.sampled import looks
from robofleet.tracking.pictures import jpeg
from tests.recording import recorded
from tests.reports import hostile

GUIDE = Path(__file__).parents[2] / "configs" / "NOTEBOOKS.md"
RECORDINGS = Path(__file__).parents[1] / "recordings"
PLATOON, HELD, LOST = (RECORDINGS / f"{name}.mcap" for name in ("platoon", "held", "lost"))
UNITS = ("_m", "_rad", "_s", "_mm", "_deg", "_ms")
PLAIN = {
    "robot", "group", "tick", "run_tick", "counts", "phase", "overruns", "cause", "by_operator", "saturated",
    "measured", "lost", "filtered", "blocked", "failed", "reference_parameter",
}  # fmt: skip
IN_THE_CSV = {column.name: column.csv or column.name for column in COLUMNS}


def numbers(run: RecordedRun, name: str) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = run.table(name, library="numpy")
    return found


@pytest.mark.parametrize("file", [PLATOON, HELD], ids=lambda file: file.stem)
def test_tables_are_what_metrics_csv_has_tick_by_tick(file: Path, tmp_path: Path) -> None:
    write_csv(looks(file), tmp_path / "metrics.csv")
    with (tmp_path / "metrics.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    run = robofleet.load(file)
    tables = {name: numbers(run, name) for name in ("poses", "commands", "platoon")}
    compared = set()
    for table in tables.values():
        assert list(table["robot"]) == [row["robot"] for row in rows]
        for name, values in table.items():
            if (column := IN_THE_CSV.get(name, name)) not in ("robot", "group"):
                expected = [float(row[column] or "nan") for row in rows]
                np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6, err_msg=name)
                compared.add(column)
    assert rows[0].keys() - compared == {"run_tick", "robot", "group", "clock_time_s"}


@pytest.mark.parametrize("name", ["poses", "commands", "ticks", "stops", "platoon"])
def test_a_table_is_the_same_in_each_library_and_its_names_have_units(name: str) -> None:
    run = robofleet.load(LOST)
    table, pandas, polars = numbers(run, name), run.table(name), run.table(name, library="polars")
    assert list(table) == list(pandas.columns) == polars.columns
    for column, values in table.items():
        assert column in PLAIN or column.endswith(UNITS), column
        assert pandas[column].tolist() == pytest.approx(values.tolist(), nan_ok=True)
        assert [float("nan") if v is None else v for v in polars[column]] == pytest.approx(values.tolist(), nan_ok=True)
    if "robot" in table:
        assert str(pandas.dtypes["robot"]) == "category"
        assert list(pandas.robot.cat.categories) == list(polars["robot"].dtype.categories) == ["r1", "r2"]


def test_the_mean_of_what_counts_is_the_summarys() -> None:
    run = robofleet.load(PLATOON)
    table = numbers(run, "platoon")
    for name, figure in run.summary["groups"]["platoon"].items():
        if name in table and isinstance(figure, dict):
            assert np.nanmean(table[name][table["counts"]]) == pytest.approx(figure["mean"], abs=6e-5), name


def test_a_stop_has_its_robot_and_its_cause() -> None:
    (stop,) = robofleet.load(LOST).table("stops").to_dict("records")
    assert (stop["robot"], stop["cause"], stop["by_operator"]) == ("r2", "not seen by the tracker", False)


def test_of_a_long_run_the_parts_make_the_same_table(monkeypatch: pytest.MonkeyPatch) -> None:
    run = robofleet.load(PLATOON)
    whole = {name: numbers(run, name) for name in run.tables}
    monkeypatch.setattr(reading, "_AROUND_NS", 3 * S // 2)
    monkeypatch.setattr(run_tables, "_TOGETHER", 30_000)
    assert len([*run_tables.parts(PLATOON, run._about.groups, "poses")]) > 2
    for name, table in whole.items():
        for column, values in numbers(run, name).items():
            np.testing.assert_array_equal(values, table[column], err_msg=f"{name}: {column}")


def test_only_topics_are_read_that_a_table_needs() -> None:
    recording, _ = next(reading.parts(PLATOON, topics=(TICK, POSES)))
    assert {full.split("/", 2)[2] for full in recording.messages} == {"tick", "poses/overhead"}


def test_a_run_says_who_drove_and_what_it_measured(tmp_path: Path) -> None:
    shutil.copy(PLATOON, tmp_path / FILE)
    run = robofleet.load(str(tmp_path))
    assert (run.robots, run.groups) == (("r1", "r2", "r3"), {"platoon": ("r1", "r2", "r3")})
    assert (run.config.arena.name, run.file, run.trouble) == ("platoon", tmp_path / FILE, None)
    assert run.duration_s == pytest.approx(3.465)
    (tmp_path / "summary.json").write_text('{"version": 1, "duration_s": 4.5}')
    assert (robofleet.load(tmp_path).duration_s, run.duration_s) == (4.5, pytest.approx(3.465))
    for wrong in ("[]", '{"version": 0}', "[" * 100_000, "{"):
        (tmp_path / "summary.json").write_text(wrong)
        assert robofleet.load(tmp_path).duration_s == pytest.approx(3.465)


@pytest.mark.slow
def test_a_run_that_was_killed_is_read_up_to_there(run_file: Path, tmp_path: Path) -> None:
    content = run_file.read_bytes()
    (tmp_path / FILE).write_bytes(content[: len(content) * 3 // 4])
    run, whole = robofleet.load(tmp_path), robofleet.load(run_file)
    assert run.trouble is not None and "ends before its index" in run.trouble
    assert 0 < run.summary["ticks"] < whole.summary["ticks"]
    for name in ("poses", "commands", "ticks"):
        table, expected = numbers(run, name), numbers(whole, name)
        rows = len(table["t_s"]) - 12  # in the last ticks other topics are missing
        assert rows > 20
        for column, values in table.items():
            np.testing.assert_array_equal(values[:rows], expected[column][:rows], err_msg=column)
    assert "ends before its index" in run._repr_html_()


def test_the_images_that_were_recorded_come_with_their_times(tmp_path: Path) -> None:
    config = recorded.config()
    full, shots = key(config.arena.name, PICTURE, "overhead"), np.arange(0, 250, 100, np.uint8)
    with RunLog(tmp_path / FILE, config, drawn=False) as log:
        for k, grey in enumerate(shots):
            image = np.full((720, 1280), grey, np.uint8)
            log.add(full, PICTURE_LAYOUT.encode(Picture(1, k, k * S, 1280, 720, jpeg(image))), k * S)
        bomb = jpeg(np.zeros((64, 64), np.uint8)).replace(b"\x00\x40\x00\x40", b"\xff\xff\xff\xff")
        for strange in (jpeg(np.zeros((100, 100), np.uint8)), bomb, b"no picture", b""):
            log.add(full, PICTURE_LAYOUT.encode(Picture(1, 9, 9 * S, 1280, 720, strange)), 9 * S)
    found = list(robofleet.load(tmp_path).images("overhead"))
    assert [(image.t_s, image.camera, image.image.shape) for image in found] == [
        (t, "overhead", (720, 1280)) for t in (0.0, 1.0, 2.0)
    ]
    assert [int(image.image.mean()) for image in found] == shots.tolist()


@pytest.mark.parametrize(
    ("use", "why"),
    [
        (lambda run: run.table("pose"), "there is no table 'pose': did you mean 'poses'?"),
        (lambda run: run.table("xyz"), "known: commands, platoon, poses, stops, ticks"),
        (lambda run: run.table("poses", library="panda"), "did you mean 'pandas'?"),
        (lambda run: run.images("overheat"), "there is no camera 'overheat': did you mean 'overhead'?"),
    ],
)
def test_what_a_run_has_not_is_refused_in_a_line(use: Any, why: str) -> None:
    with pytest.raises(RobofleetError, match=re.escape(why)) as refused:
        use(robofleet.load(PLATOON))
    assert "\n" not in str(refused.value)


def test_what_is_no_run_of_this_version_is_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(RobofleetError, match="there is no such recording: name a run's folder"):
        robofleet.load(tmp_path)
    (tmp_path / FILE).write_bytes(b"nothing")
    with pytest.raises(RobofleetError, match="is not a recording"):
        robofleet.load(tmp_path)
    (tmp_path / FILE).write_bytes(hostile.file(recorded.config(), library=LIBRARY.format("9.9", 99)))
    with pytest.raises(RobofleetError, match="was made by wire version 99"):
        robofleet.load(tmp_path)


def test_without_pandas_the_next_library_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setattr(run_tables, "find_spec", lambda name: None if name == "pandas" else name)
    assert type(robofleet.load(PLATOON).table("stops")).__module__.startswith("polars")
    monkeypatch.setattr(run_tables, "find_spec", lambda name: name if name == "numpy" else None)
    assert isinstance(robofleet.load(PLATOON).table("stops"), dict)


def test_a_group_may_have_the_name_of_a_table() -> None:
    run = robofleet.load(PLATOON)
    groups = [group._replace(name="poses") for group in run._about.groups]
    assert run_tables.names(groups) == ("poses", "commands", "ticks", "stops", "own_poses")


def test_a_notebook_shows_the_arena_and_no_script(tmp_path: Path) -> None:
    nasty = tmp_path / "<script>alert(1)"
    nasty.mkdir()
    shutil.copy(PLATOON, nasty / FILE)
    page = robofleet.load(nasty)._repr_html_()
    assert len(page) < 100_000
    assert "<script" not in page
    tree = ElementTree.fromstring(page.replace("&nbsp;", " "))
    texts = ["".join(element.itertext()) for element in tree.iter()]
    assert any("<script>alert(1)" in text for text in texts), "it is shown as text"
    assert {"r1", "r2", "r3", "control error, mean"} <= set(texts)


@pytest.mark.slow
def test_a_plot_has_the_floor_and_the_errors_over_time(run_file: Path) -> None:
    figure = robofleet.load(run_file).plot()
    floor, *errors = figure.axes
    assert {"r1", "r2", "0.5 m"} <= {text.get_text() for text in floor.texts}
    assert [axes.get_ylabel() for axes in errors] == ["control error, mm", "timed error, mm", "path error, mm"]
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_the_guide_works_as_it_stands(run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    guide = GUIDE.read_text()
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", guide, re.DOTALL):
        exec(code.replace("runs/20260102T030405Z-platoon", str(run_file)), names)
    assert (tmp_path / "run.pdf").is_file()
    for name in re.findall(r"`run\.(\w+)", " ".join(re.findall(r"^\| `run\..*? \|", guide, re.MULTILINE))):
        assert hasattr(names["run"], name), name
    listed = {row.split("`")[1] for row in guide.splitlines() if row.startswith("| `")}
    assert {"poses", "commands", "ticks", "stops", *run_tables.KEYS} <= listed
