"""``robofleet paper``: what it writes, what it prints, and what it refuses."""

import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from robofleet import cli
from robofleet.config.files.parameters import Parameters, load_parameters
from robofleet.config.load import ConfigError
from robofleet.experiments import closed_curve, paper
from robofleet.experiments.closed_curve import ClosedCurveParameters
from robofleet.experiments.lane_change import LaneChangeParameters
from robofleet.experiments.paper import SHIPPED
from robofleet.experiments.simulate import DivergedError


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def robofleet(*arguments: str) -> Result:
    return CliRunner().invoke(cli.app, ["paper", *arguments], env={"COLUMNS": "80"})


@pytest.mark.long
def test_tables_on_the_terminal_figures_and_numbers_in_the_folder(folder: Path) -> None:
    result = robofleet("closed-curve", "--out", "new")
    assert result.exit_code == 0, result.output
    assert max(map(len, result.stdout.splitlines())) <= 80
    for text in ("Table 1", "Zhou 17", "other models on other roads", "the paper's is not published", "35 km/h"):
        assert text in result.stdout
    content = json.loads((folder / "new" / "closed-curve.json").read_text())
    assert content["tables"][0]["rows"][0]["Zhou 17"] == 36.0
    assert content["parameters"]["flow"]["horizon_s"] == 0.5
    names = {"curve", "control-error", "acceleration", "lateral-error", "heading-error"}
    assert set(content["figures"]) == {f"closed-curve-{name}" for name in names}
    for stem in content["figures"]:
        assert (folder / "new" / f"{stem}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (folder / "new" / f"{stem}.svg").read_text()


@pytest.mark.long
def test_json_is_one_object_and_nothing_else(folder: Path) -> None:
    result = robofleet("closed-curve", "--json")
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert re.fullmatch(r"runs/\d{8}T\d{6}Z-paper", printed["folder"])
    written = json.loads((folder / printed["folder"] / "closed-curve.json").read_text())
    assert printed["experiments"] == {"closed-curve": written}


def test_a_folder_that_is_not_empty_is_refused(folder: Path) -> None:
    (folder / "old").mkdir()
    (folder / "old" / "kept").write_text("kept")
    result = robofleet("closed-curve", "--out", "old")
    assert result.exit_code == 2
    assert "old exists already and is not empty" in result.stderr
    assert [path.name for path in (folder / "old").iterdir()] == ["kept"]


def test_another_experiment_goes_into_the_same_folder_and_the_same_one_does_not(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        paper, "report", lambda name, _parameters, out, *, quiet: (out / f"{name}.json").write_text(f"{quiet}")
    )
    for name in ("closed-curve", "lane-change"):
        assert robofleet(name, "--out", "results").exit_code == 0
    assert sorted(path.name for path in (folder / "results").iterdir()) == ["closed-curve.json", "lane-change.json"]
    for name in ("lane-change", "all"):
        result = robofleet(name, "--out", "results")
        assert result.exit_code == 2
        assert re.fullmatch(r"--out: results has \S+ already: name another folder\n", result.stderr)


def test_an_unknown_name_is_refused_with_a_hint(folder: Path) -> None:
    result = robofleet("lane-chnage", "--out", "new")
    assert result.exit_code == 2
    assert result.stderr == "there is no experiment 'lane-chnage': did you mean 'lane-change'?\n"
    assert not (folder / "new").exists()


def test_every_shipped_file_is_an_experiment_and_is_valid() -> None:
    assert {file.stem for file in SHIPPED.glob("*.yaml")} >= set(paper.EXPERIMENTS)
    assert paper.chosen("all") == tuple(paper.EXPERIMENTS)
    for name in paper.EXPERIMENTS:
        assert isinstance(paper.parameters_of(name), Parameters)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("closed-curve", "horizon_s: 0.5", "horizon_s: «0", "flow.horizon_s: must be at least 1e-09, not 0"),
        ("closed-curve", "alpha: 30, integrator: euler", "alpha: «-30, integrator: euler",
         "flow.alpha: must be at least 1e-09, not -30"),
        ("closed-curve", "curvature_ramp_m: 3", "curvature_ramp_m: «50",
         "track.curvature_ramp_m: must be at most 44.0: a corner turns 90 degrees"),
        ("closed-curve", "settle_s: 2", "«setle_s: 2", "setle_s: unknown key: did you mean 'settle_s'?"),
        ("lane-change", "curve_length_m: 490", "curve_length_m: «480",
         "curve_length_m: too short: the fastest drive asks for r(t + delay + T) up to 486.6 m, not 480"),
        ("lane-change", "computing_delay_s: 0.01 ", "computing_delay_s: «0.015 ",
         "computing_delay_s: must be a whole multiple of control_step_s, 0.01, not 0.015"),
        ("lane-change", "second_term: plus, flow: {horizon_s: 0.5", "second_term: plus, flow: {horizn_s: 0.5",
         "readings.0.flow.horizn_s: unknown key: did you mean 'horizon_s'?"),
        ("memoryless", "duration_s: 40", "duration_s: «12", "duration_s: must be longer than 10 s of transient"),
        ("memoryless", "coupling: 0.8", "coupling: «1.0", "coupling: "),
        ("stability", "horizon_s: [0.01, 1]", "horizon_s: «[1, 1]",
         "horizon_s: the first number must be below the second, got 1 and 1"),
        ("comparison", "[flow, flow-paper,", "«[flow-paper,", "controllers: must contain flow"),
        ("comparison", "curve_length_m: 220", "curve_length_m: «140", "curve_length_m: must be at least 151"),
        ("comparison", "delays_s: [0.03,", "delays_s: [«0.035,",
         "trouble.delays_s.0: must be a whole multiple of 0.01, not 0.035"),
        ("comparison", "stanley]", "«stanly]", "controllers.9: "),
    ],
)  # fmt: skip
def test_bad_parameters_are_refused_at_their_line_and_column(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, old: str, new: str, message: str
) -> None:
    copy = Path(shutil.copytree(SHIPPED, folder / "paper"))
    text = (copy / f"{name}.yaml").read_text()
    assert text.count(old) == 1
    (copy / f"{name}.yaml").write_text(text.replace(old, new.replace("«", "")))
    monkeypatch.setattr(paper, "SHIPPED", copy)
    result = robofleet(name, "--out", "new")
    assert result.exit_code == 2
    assert result.stdout == ""
    lines = [line for line in result.stderr.splitlines() if message in line]
    assert len(lines) == 1, result.stderr
    if "«" in new:
        before = text.replace(old, new).split("«")[0]
        position = f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
        assert lines[0].startswith(f"{copy / name}.yaml:{position}: {message}")
    assert not (folder / "new").exists()


@pytest.mark.parametrize("kind", [ClosedCurveParameters, LaneChangeParameters])
def test_all_faults_at_once_in_the_order_of_the_file(folder: Path, kind: type[Parameters]) -> None:
    file = folder / "bad.yaml"
    file.write_text("duration_s: 0\ncontrol_step_s: 1e-3\nspeeds: [1]\n")
    with pytest.raises(ConfigError) as refused:
        load_parameters(kind, file)
    at = [tuple(map(int, fault.removeprefix(str(file)).split(":")[1:3])) for fault in refused.value.faults]
    assert at == sorted(at)
    assert {(1, 13), (2, 17), (3, 1)} <= set(at)


def test_a_missing_file_is_said(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml:1:1: there is no such file"):
        load_parameters(ClosedCurveParameters, folder / "none.yaml")


def test_what_ends_without_a_result_ends_the_command_with_its_cause(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverging(_: ClosedCurveParameters) -> None:
        raise DivergedError("t = 1.25 s: diverged, the control error is 4e+03 m")

    monkeypatch.setattr(closed_curve, "run", diverging)
    result = robofleet("closed-curve", "--json")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == "closed-curve: t = 1.25 s: diverged, the control error is 4e+03 m\n"


@pytest.mark.long
def test_a_drive_that_diverges_ends_the_command_with_its_cause(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = Path(shutil.copytree(SHIPPED, folder / "paper"))
    text = (copy / "closed-curve.yaml").read_text()
    bad = text.replace("computing_delay_s: 0.01 ", "computing_delay_s: 0.15 ").replace(
        "horizon_s: 0.5", "horizon_s: 0.1"
    )
    (copy / "closed-curve.yaml").write_text(bad)
    monkeypatch.setattr(paper, "SHIPPED", copy)
    result = robofleet("closed-curve", "--json")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert re.search(r"closed-curve: t = \d+\.\d\d s: ", result.stderr)
