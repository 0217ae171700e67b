"""The operator's commands: what they print, where, and with which exit code; bad input starts nothing."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from robofleet.core.refusal import LAB_MODULES
from robofleet.operator import run_command
from tests.command import robofleet
from tests.recording.recorded import room_for
from tests.shipped import PLATOON

pytestmark = pytest.mark.usefixtures("unplotted")

RECORDING = Path(__file__).parent / "recordings" / "platoon.mcap"
TRUTH = ("--lockstep", "--set", "tracker.source=truth")
SUMMARY_KEYS = {
    "version", "config", "seed", "mode", "outcome", "cause", "duration_s", "ticks", "real_time_factor", "trace_hash",
    "robots", "control_error_mm", "timed_error_mm", "path_error_mm", "centre_error_mm", "spacing_m", "min_gap_mm",
    "pose_error", "tracker", "tick", "latency_ms", "saturated_fraction", "filtered_fraction", "stops", "rejected",
    "bounds", "began",
}  # fmt: skip
PARTS = {
    "control_error_mm": {"mean", "max", "per_robot_mean"},
    "timed_error_mm": {"mean", "max", "per_robot_mean"},
    "path_error_mm": {"mean", "max", "per_robot_mean"},
    "centre_error_mm": {"mean", "max", "per_robot_mean"},
    "spacing_m": {"mean", "max_deviation_mm"},
    "pose_error": {"rms_mm", "max_mm", "heading_rms_deg"},
    "tracker": {"frames", "measured_fraction", "false_ids", "frame_ms"},
    "tick": {"period_ms", "compute_us", "lateness_us", "overruns"},
    "latency_ms": {"exposure_to_wheel", "stages"},
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which the operator stands."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    monkeypatch.setenv("TMPDIR", str(tmp_path_factory.mktemp("tmp")))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Return what ``robofleet run`` says in its one line; nothing is started and nothing written."""

    def run(*arguments: object) -> str:
        started: list[Any] = []
        monkeypatch.setattr(run_command, "_result", lambda *a, **k: started.append((a, k)))
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        result = robofleet("run", *arguments)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert started == []
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
        assert not (folder / "runs").exists()
        assert not (folder / "new").exists()
        (line,) = result.stderr.splitlines()
        return str(line)

    return run


@pytest.fixture
def taken_port() -> Iterator[int]:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        yield server.getsockname()[1]


def test_a_port_in_use_is_refused(refused: Callable[..., str], taken_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{taken_port}"
    keys = ["--set", f"bus.endpoint={endpoint}", "--set", "bus.insecure=loopback"]
    line = refused(PLATOON, *keys, "--out", "new")
    assert line.startswith(f"bus.endpoint: {endpoint} ")
    assert "in use" in line


def test_every_fault_at_once_one_line_each(folder: Path) -> None:
    changes = ("--set", "robots.1.tag=1", "--set", "controller.alpha=-3", "--set", "groups.0.pathrate=1")
    result = robofleet("run", PLATOON, *changes)
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) >= 2
    assert all(line.startswith("--set ") for line in result.stderr.splitlines())
    assert list(folder.iterdir()) == []


@pytest.mark.slow
def test_json_is_one_object_and_nothing_else(folder: Path) -> None:
    (folder / "new" / "deep").mkdir(parents=True)  # an empty folder is used
    result = robofleet("run", PLATOON, *TRUTH, "--duration", "6", "--seed", "5", "--json", "--out", "new/deep")
    assert result.exit_code == 0, result.stderr
    (line,) = result.stdout.splitlines()
    summary = json.loads(line)
    assert summary == json.loads((folder / "new" / "deep" / "summary.json").read_text())
    assert set(summary) >= SUMMARY_KEYS
    for name, parts in PARTS.items():
        assert set(summary[name]) >= parts, name
    assert (summary["version"], summary["config"], summary["seed"]) == (1, "platoon", 5)
    assert (summary["mode"], summary["outcome"], summary["cause"]) == ("lockstep", "completed", None)
    assert summary["duration_s"] == pytest.approx(6, abs=0.033)
    assert len(summary["trace_hash"]) == 32
    assert 0.0 <= summary["filtered_fraction"] < 0.1


def test_a_run_ends_with_a_table_in_a_folder_of_its_own(folder: Path) -> None:
    result = robofleet("run", PLATOON, *TRUTH, "--duration", "6", "--quiet")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    (made,) = (folder / "runs").iterdir()
    assert re.fullmatch(r"\d{8}T\d{6}Z-platoon", made.name)
    assert str(made.relative_to(folder) / "summary.json") in result.stdout
    assert "control error" in result.stdout
    summary, page = ((made / name).read_text() for name in ("summary.json", "report.html"))
    assert f"{json.loads(summary)['began'].replace('T', ' ').removesuffix('Z')} UTC; 4 robots" in page


@pytest.mark.parametrize("command", [["report"], ["replay"], ["repair"], ["layout", "foxglove"]], ids=" ".join)
def test_a_command_on_a_run_takes_the_newest_one(command: list[str], folder: Path) -> None:
    newest = folder / "runs" / "20260102T030405Z-platoon"
    newest.mkdir(parents=True)
    shutil.copy(RECORDING, newest / "run.mcap")
    result = robofleet(*command)
    assert result.exit_code == (1 if command == ["report"] else 0), result.output  # it is too short for its bounds
    assert "the newest run is taken: runs/20260102T030405Z-platoon\n" in result.stderr


@pytest.mark.slow
def test_a_fault_is_exit_code_1_with_its_cause_and_a_summary(folder: Path) -> None:
    unseen = ("--set", "tracker.truth.dropout=1.0")
    result = robofleet("run", PLATOON, *TRUTH, *unseen, "--json", "--out", "new")
    assert result.exit_code == 1
    summary = json.loads(result.stdout)
    assert summary["outcome"] == "fault"
    assert f"fault: {summary['cause']}" in result.stderr
    assert set(summary) >= SUMMARY_KEYS
    assert json.loads((folder / "new" / "summary.json").read_text()) == summary


def test_strict_ends_with_1_where_a_bound_is_not_met_and_junit_says_which(folder: Path) -> None:
    bounds = "run.bounds={control_error_mean_mm: 1.0e-6, overruns: 0}"
    options = ["--duration", "2", "--set", bounds, "--junit", "ci/b.xml"]
    result = robofleet("run", PLATOON, *TRUTH, *options, "--strict", "--quiet", "--out", "new1")
    assert result.exit_code == 1, result.stderr
    (line,) = result.stderr.splitlines()
    assert line.startswith("bound not met: control error, mean: ")
    (suite,) = ElementTree.parse(folder / "ci" / "b.xml").getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "0")
    again = robofleet("report", "new1", "--junit", "again.xml")
    assert again.exit_code == 1
    assert (folder / "again.xml").read_text() == (folder / "ci" / "b.xml").read_text()


@pytest.mark.slow
def test_results_that_are_lost_on_a_full_disk_are_exit_code_1(folder: Path) -> None:
    with room_for(300_000):
        result = robofleet("run", PLATOON, *TRUTH, "--duration", "6", "--quiet", "--out", "new")
    assert result.exit_code == 1
    assert re.search(r"results are lost: new/run.mcap: it lacks [\d,]+ messages of the run: make room", result.stderr)
    assert json.loads((folder / "new" / "summary.json").read_text())["outcome"] == "completed"


def test_a_run_whose_robots_could_not_remember_a_stop_is_not_begun(
    refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    no_folder = tmp_path_factory.mktemp("spoilt") / "state"
    no_folder.write_text("a file")
    monkeypatch.setenv("XDG_STATE_HOME", str(no_folder))
    line = refused(PLATOON, "--out", "new")
    assert line.startswith(f"{no_folder}/robofleet/platoon/r1.json: Not a directory: ")
    assert "name another folder in XDG_STATE_HOME" in line


def test_a_ci_that_asks_for_nothing_is_told_so(refused: Callable[..., str], folder: Path) -> None:
    assert "write run.bounds" in refused(PLATOON, *TRUTH, "--strict", "--set", "run.bounds={}", "--out", "new")
    (folder / "there").mkdir()
    assert refused(PLATOON, *TRUTH, "--junit", "there", "--out", "new").startswith("--junit: there is a folder")


@pytest.mark.slow
def test_a_terminal_of_the_c_locale_gets_ascii_alone(folder: Path) -> None:
    command = [sys.executable, "-m", "robofleet", "check", str(PLATOON)]
    for locale, plain in (({"LC_ALL": "C"}, True), ({"LANG": "C.UTF-8"}, False)):
        environment = {name: value for name, value in os.environ.items() if name[:3] not in ("LC_", "LAN")}
        output = subprocess.run(command, env=environment | locale, capture_output=True, check=True).stdout
        assert output.isascii() == plain, locale
        assert (b"<= 12.5 rad/s" in output) == plain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("redirections", "code", "says"),
    [
        (">/dev/full", 1, "robofleet: the output cannot be written: No space left on device\n"),
        (">&- <&-", 0, ""),
        (">&- 2>&- <&-", 0, ""),
    ],
)
def test_an_output_that_is_full_or_closed_is_no_traceback(redirections: str, code: int, says: str) -> None:
    ended = subprocess.run(
        f"'{sys.executable}' -m robofleet --version {redirections}",
        check=False,
        shell=True,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert (ended.returncode, ended.stderr) == (code, says)


def test_check_prints_what_it_proved(folder: Path) -> None:
    result = robofleet("check", PLATOON)
    assert (result.exit_code, result.stderr) == (0, "")
    for proved in ("limits hold", "wheel", "12.5 rad/s", "0.2 m/s"):
        assert proved in result.stdout
    assert list(folder.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["run", str(PLATOON), "--lockstep"], ["replay", "runs"], ["report", "runs"]])
def test_a_robots_computer_without_the_extra_is_told_which_one_a_command_needs(arguments: list[str]) -> None:
    hidden = "import sys; sys.modules.update(numba=None, mcap=None)"
    code = f"{hidden}; sys.argv[1:] = {arguments}; from robofleet.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(
        r"this needs (numba|mcap): \S+ -m pip install -e '\.\[lab\]' in robofleet's folder\n", done.stderr
    )


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["run", "--help"], ["calibrate", "intrinsics", "--help"], ["schema"]])
def test_a_robots_computer_without_the_extra_has_every_commands_help_and_the_schema(arguments: list[str]) -> None:
    hidden = f"import sys; sys.modules.update(dict.fromkeys({LAB_MODULES}))"
    code = f"{hidden}; sys.argv[1:] = {arguments}; from robofleet.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage: robofleet " + arguments[0] in done.stdout or json.loads(done.stdout)["type"] == "object"


COMMANDS_ON_A_RUN = [["stop"], ["hold"], ["status"], ["status", "--json"], ["web"]]
ONE_PROCESS = [["node", name] for name in ("router", "supervisor", "tracker", "controller")]
ONE_PROCESS += [["node", "driver", "--robots", "r1,r2,r3,r4"]]


@pytest.mark.parametrize("command", [*COMMANDS_ON_A_RUN, *ONE_PROCESS, ["run"]], ids=" ".join)
def test_a_runtime_folder_that_is_a_file_is_named_in_a_line(
    command: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "file").write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder / "file"))
    given = [] if command in COMMANDS_ON_A_RUN else [str(PLATOON)]
    result = robofleet(*command, *given)
    assert result.exit_code == 2
    assert f"{folder}/file/robofleet: Not a directory: set XDG_RUNTIME_DIR to a folder of yours" in result.stderr
    assert len(result.stderr.splitlines()) == (2 if command in COMMANDS_ON_A_RUN else 1), result.stderr
    assert not (folder / "runs").exists()
