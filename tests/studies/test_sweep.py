"""A sweep: its runs are decided and checked before the first, none is lost, and wherever they run the table is one."""

import csv
import html
import json
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.studies.progress import bar
from robofleet.studies.sweep import journal
from robofleet.studies.sweep.load import load
from robofleet.studies.sweep.plan import Distribution, Sweep, settings
from robofleet.studies.sweep.plots import scale
from tests.command import robofleet
from tests.policies import small_policies

CONFIGS = Path(__file__).parents[2] / "configs"
HEAD = f"config: {CONFIGS / 'platoon.yaml'}\n"
# Noisy poses end the checks before a start: half of the runs break.
TEXT = f"""{HEAD}set: {{run.duration_s: 30, tracker.source: truth}}
grid: {{tracker.truth.position_noise_m: [0.0003, 0.006]}}
seeds: {{first: 3, count: 2}}
"""


def sweep(*arguments: str) -> tuple[int, str, str]:
    done = robofleet("sweep", *arguments)
    return done.exit_code, done.stdout, done.stderr


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "runs.csv").open() as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("sweep") / "noise.yaml"
    made.write_text(TEXT)
    return made


@pytest.fixture(scope="module")
def interrupted(file: Path) -> Iterator[tuple[Path, str]]:
    """Return the folder of a sweep that was interrupted after its first run, and what it said."""
    folder = file.parent / "out"
    command = [sys.executable, "-m", "robofleet", "sweep", str(file), "--out", str(folder), "--jobs", "1"]
    command = ["env", "--default-signal=INT", *command]  # what runs in a shell's background ignores it
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None and len(_lines(folder)) < 2:
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.005)
        process.send_signal(signal.SIGINT)
        _, output = process.communicate()
    assert process.returncode == 1
    yield folder, output


def _lines(folder: Path) -> list[bytes]:
    file = folder / journal.FILE
    return file.read_bytes().splitlines() if file.exists() else []


@pytest.mark.slow
def test_an_interrupted_sweep_keeps_what_is_finished_and_goes_on(file: Path, interrupted: tuple[Path, str]) -> None:
    folder, output = interrupted
    kept = _lines(folder)
    assert 2 <= len(kept) < 5
    assert f"interrupted: {len(kept) - 1} of 4 runs are kept; to go on: robofleet sweep" in output
    with (folder / journal.FILE).open("ab") as stream:
        stream.write(b'{"run": 4, "summ')  # of a run that was being written

    code, out, err = sweep(str(file), "--out", str(folder), "--jobs", "1", "--json")

    assert code == 1, err  # two runs broke
    assert _lines(folder)[: len(kept)] == kept
    found = rows(folder)
    assert [row["run"] for row in found] == ["1", "2", "3", "4"]
    assert [row["seed"] for row in found] == ["3", "4", "3", "4"]
    assert [row["tracker.truth.position_noise_m"] for row in found] == ["0.0003", "0.0003", "0.006", "0.006"]
    assert [row["outcome"] for row in found] == ["completed", "completed", "fault", "fault"]
    assert len({row["trace_hash"] for row in found}) == 4
    assert all(float(row["min_gap_mm"]) > 0 for row in found[:2])
    status = json.loads(out)
    assert (status["runs"], status["completed"]) == (4, 2)
    assert [run["run"] for run in status["failed"]] == [3, 4]
    assert all(run["cause"] in err or run["run"] <= len(kept) - 1 for run in status["failed"])
    page = html.unescape((folder / "sweep.html").read_text())
    assert all(run["replay"] in page for run in status["failed"])
    replay = shlex.split(status["failed"][0]["replay"])[1:]
    replayed = robofleet(*replay, "--quiet", "--json", f"--out={folder / 'again'}")
    assert json.loads(replayed.stdout)["trace_hash"] == found[2]["trace_hash"]
    _same_in_parquet(folder, found)


def _same_in_parquet(folder: Path, found: list[dict[str, str]]) -> None:
    table = pytest.importorskip("pyarrow.parquet").read_table(folder / "runs.parquet").to_pylist()
    assert [{name: "" if cell is None else str(cell) for name, cell in row.items()} for row in table] == found


@pytest.mark.slow
def test_robots_are_opened_once_for_each_setting_that_is_theirs_and_not_for_each_combination(tmp_path: Path) -> None:
    opened = tmp_path / "opened"
    (tmp_path / "counted.py").write_text(
        "from robofleet.drivers.simulated import SimulatedRobot\n"
        "class Counted(SimulatedRobot):\n"
        "    def __init__(self, context):\n"
        f"        open({str(opened)!r}, 'a').write('x')\n"
        "        super().__init__(context)\n"
    )
    (tmp_path / "lab.yaml").write_text((CONFIGS / "platoon.yaml").read_text())
    (tmp_path / "s.yaml").write_text(
        "config: lab.yaml\nset: {robots.0.driver: 'counted:Counted'}\n"
        "grid: {controller.alpha: [30, 31, 32], robots.1.tag: [12, 13], run.duration_s: [1, 2]}\n"
    )
    study = load(tmp_path / "s.yaml", lambda sweep: bar("checks", sweep))
    assert len(study.runs) == 12
    assert opened.read_text() == "xx", "once for each tag of robots"


@pytest.mark.slow
def test_bounds_are_met_missed_or_not_judged_and_only_met_is_green(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(
        f"{HEAD}set: {{run.duration_s: 0.1, tracker.source: truth, run.bounds: {{min_obstacle_gap_mm: 10}}}}\n"
        "grid: {controller.alpha: [30, 31]}"
    )
    code, out, err = sweep(str(tmp_path / "s.yaml"), "--out", str(tmp_path / "out"), "--jobs", "1", "--json")
    assert code == 0, err
    result = json.loads(out)
    assert (result["completed"], result["bounds_missed"], result["bounds_not_judged"]) == (2, 0, 2)
    assert [row["bounds_not_judged"] for row in rows(tmp_path / "out")] == ["1", "1"]
    page = (tmp_path / "out" / "sweep.html").read_text()
    assert "2 completed and missed no bound, but not every bound was checked" in page
    assert "not measured in any run, not checked; bound 10" in page
    assert "completed and missed a bound" not in page
    assert "met its bounds" not in page


@pytest.mark.parametrize(("bound", "values"), [(None, [0.2, 0.202]), (1.0, [0.0, 0.002]), (None, [-3.0, -3.1])])
def test_differences_of_no_weight_share_a_tenth_of_a_scale(bound: float | None, values: list[float]) -> None:
    low, high = scale(np.array(values), bound)
    assert low <= min(values) < max(values) <= high
    assert (max(values) - min(values)) / (high - low) < 0.4
    assert scale(np.array([1.0, np.nan, 3.0]), bound) == (1.0, 3.0)


@pytest.mark.long
def test_ray_leaves_the_same_bytes(file: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    for on in ("local", "ray"):
        command = [sys.executable, "-m", "robofleet", "sweep", str(file), "--out", str(tmp_path / on), "--on", on]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, (tmp_path / on / "runs.csv").exists()) == (1, True), done.stderr
    for name in ("runs.csv", "runs.parquet"):
        assert (tmp_path / "local" / name).read_bytes() == (tmp_path / "ray" / name).read_bytes()


BAD: dict[str, tuple[str, str]] = {
    "no key": (HEAD, "s.yaml:1:1: names no key to vary: add `grid"),
    "an unknown key": (f"{HEAD}grid: {{controller.alpa: [30]}}", "s.yaml:2:8: controller.alpa: unknown key: did you"),
    "a value of another kind": (
        f"{HEAD}grid:\n  controller.alpha: [30, fast]",
        "s.yaml:3:26: controller.alpha: must be a number, not 'fast' (run 2: controller.alpha=fast; ",
    ),
    "a value that cannot work": (
        f"{HEAD}random: {{count: 2, keys: {{groups.0.settings.path_rate: {{uniform: [1, 2]}}}}}}",
        "s.yaml:2:56: groups.0.settings.path_rate: ",
    ),
    "a base that is not there": ("config: x.yaml\ngrid: {run.duration_s: [1]}", "x.yaml:1:1: there is no such file"),
    "more runs than asked for": (
        f"{HEAD}grid: {{controller.alpha: [30, 45]}}\nseeds: {{count: 600}}\nruns: 1000",
        "s.yaml:4:7: runs: these are 1,200 runs (2 combinations of the grid x 600 seeds): at most 1,000 are asked for",
    ),
    "two places for a key": (
        f"{HEAD}set: {{controller.alpha: 3}}\ngrid: {{controller.alpha: [30]}}",
        "s.yaml:3:8: grid.controller.alpha: stands under set already",
    ),
    "seeds as a key": (f"{HEAD}grid: {{run.seed: [1]}}", "s.yaml:2:8: grid.run.seed: seeds stand under `seeds`"),
    "no distribution": (
        f"{HEAD}random: {{count: 2, keys: {{controller.alpha: {{normal: [1, 2]}}}}}}",
        "s.yaml:2:46: random.keys.controller.alpha.normal: unknown key",
    ),
    "a span that falls": (
        f"{HEAD}random: {{count: 2, keys: {{controller.alpha: {{uniform: [2, 1]}}}}}}",
        "s.yaml:2:45: random.keys.controller.alpha: uniform must rise: write [1, 2]",
    ),
    "a key of a case that the grid has": (
        f"{HEAD}grid: {{controller.alpha: [30]}}\ncases: {{slow: {{set: {{controller.alpha: 20}}}}}}",
        "s.yaml:3:22: cases.slow.set.controller.alpha: stands under grid already",
    ),
    "an environment without a policy": (
        f"{HEAD}cases:\n  plain: {{}}\n  arenas: {{mode: environment}}",
        "s.yaml:4:18: cases.arenas.mode: an environment runs the behaviour policy, which no group has",
    ),
    "faults that are not there": (
        f"{HEAD}grid: {{controller.alpha: [30]}}\nfaults: [no.yaml]", "no.yaml:1:1: there is no such file",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_nothing_is_written(
    text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(text)
    code, _, err = sweep("s.yaml", "--out", "out")
    # Where a machine is slow, lines say how far the checks are.
    errors = [line for line in err.splitlines() if not line.startswith("checks: ")]
    assert (code, len(errors)) == (2, 1), err
    assert errors[0].startswith(message)
    assert not Path("out").exists()


def test_a_folder_of_another_sweep_is_refused(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(f"{HEAD}grid: {{controller.alpha: [30]}}")
    file = tmp_path / journal.FILE
    for kept, message in ((b'{"sweep":"0","runs":1}\n', "is of another sweep"), (b"\x00\n", "is damaged")):
        file.write_bytes(kept)
        code, _, err = sweep(str(tmp_path / "s.yaml"), "--out", str(tmp_path))
        assert code == 2
        assert err.startswith(f"--out: {file} {message}")
        assert file.read_bytes() == kept


def test_the_runs_of_a_sweep_are_every_combination_in_one_order() -> None:
    keys: dict[str, Any] = {"a": {"choice": [True, False]}, "b": {"integers": [1, 9]}}
    plan = Sweep(config="c", grid={"x": [1, 2], "y": ["u", "v"]}, random={"count": 3, "keys": keys}, faults=[None, "f"])
    found = [(*setting.values.values(), setting.faults) for setting in settings(plan)]
    assert len(found) == len(set(found)) or len(found) == plan.total
    assert [row[:2] for row in found[::6]] == [(1, "u"), (1, "v"), (2, "u"), (2, "v")]
    assert [row[2:4] for row in found[:6:2]] == [row[2:4] for row in found[6:12:2]]  # every combination has each draw
    assert [row[4] for row in found[:4]] == [0, 1, 0, 1]
    more = plan.model_copy(update={"random": plan.random.model_copy(update={"keys": {"b": plan.random.keys["b"]}})})  # type: ignore[union-attr]
    assert [setting.values["b"] for setting in settings(more)] == [row[3] for row in found]


def test_cases_change_keys_together(tmp_path: Path) -> None:
    """Each case has its keys, those that it does not name stay; both cases may name the same one."""
    text = f"""{HEAD}set: {{tracker.source: truth}}
cases:
  near: {{set: {{groups.0.settings.spacing_m: 0.22, controller.alpha: 30}}}}
  far: {{set: {{groups.0.settings.spacing_m: 0.28}}, mode: real_time}}
grid: {{run.duration_s: [5, 6]}}
"""
    (tmp_path / "s.yaml").write_text(text)
    study = load(tmp_path / "s.yaml", lambda total: bar("checks", total))
    found = [
        (run.values["case"], run.values["run.duration_s"], run.config.controller.alpha, run.mode) for run in study.runs
    ]
    assert found == [
        ("near", 5, 30, "lockstep"), ("near", 6, 30, "lockstep"),
        ("far", 5, 45, "real_time"), ("far", 6, 45, "real_time"),
    ]  # fmt: skip
    assert study.keys == ("case", "run.duration_s")
    assert ["--lockstep" in run.replay for run in study.runs] == [True, True, False, False]
    assert "groups.0.settings.spacing_m=0.22 " in study.runs[0].replay


@pytest.mark.slow
def test_a_policy_earns_the_same_in_its_environment_in_lockstep_and_in_real_time(tmp_path: Path, alone: None) -> None:
    small_policies.saved(tmp_path / "go_to.onnx")
    small_policies.laboratory(tmp_path)
    cases = "cases: {environment: {mode: environment}, lockstep: {}, real_time: {mode: real_time}}\n"
    (tmp_path / "s.yaml").write_text(f"config: policy.yaml\n{cases}")
    code, out, err = sweep(str(tmp_path / "s.yaml"), "--out", str(tmp_path / "out"))
    assert code == 0, out + err
    returns = {row["case"]: float(row["groups.policy.final_return.mean"]) for row in rows(tmp_path / "out")}
    assert returns["lockstep"] == pytest.approx(returns["environment"], rel=0.03)
    assert returns["real_time"] == pytest.approx(returns["environment"], rel=0.05)


@pytest.mark.parametrize("kind", ["uniform", "log_uniform", "integers"])
def test_what_is_drawn_lies_within_its_span_and_fills_it(kind: str) -> None:
    low, high = 2, 50
    drawn = Distribution.model_validate({kind: [low, high]}).draw(1, "a", 2000)
    assert low <= min(drawn) < low + 2
    assert high - 2 < max(drawn) <= high
    middle = sorted(drawn)[1000]
    assert abs(middle - (10 if kind == "log_uniform" else 26)) < 3
    assert all(isinstance(value, int) for value in drawn) == (kind == "integers")
