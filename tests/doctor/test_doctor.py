"""`robofleet doctor`: a line each, exit codes, JSON, and a machine without the packages of ``lab``."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import Result

from robofleet.config.load import load_config
from robofleet.core.refusal import LAB_MODULES
from robofleet.doctor import cameras, computer, elsewhere, examination, places, software
from robofleet.doctor.findings import Finding, Mark, Paste, ok
from robofleet.doctor.needs import Needs
from robofleet.doctor.view import pastes, show
from tests.command import robofleet

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("TMPDIR", str(tmp_path_factory.mktemp("tmp")))
    monkeypatch.chdir(tmp_path)
    for module, answer in ((software, [str(tmp_path / "kernels"), ""]), (cameras, [])):
        monkeypatch.setattr(module, "run_apart", lambda _script, answer=answer: answer)  # numba takes seconds
    return tmp_path


def doctor(*arguments: object) -> Result:
    return robofleet("doctor", *arguments)


def test_a_machine_on_which_the_platoon_drives_is_exit_0_and_nothing_is_left_behind(folder: Path) -> None:
    result = doctor(CONFIGS / "platoon.yaml")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    named = [line.removeprefix("✓ ").removeprefix("! ").split(maxsplit=1)[0] for line in lines if line]
    assert "missing" not in named
    assert lines[-1].startswith(f"{CONFIGS / 'platoon.yaml'} would work here.")
    assert list(folder.iterdir()) == []


def test_what_a_configuration_lacks_is_exit_1_with_a_cure_each() -> None:
    result = doctor(CONFIGS / "lab.yaml", "--json")
    assert result.exit_code == 1
    report = json.loads(result.stdout)
    assert result.stderr == ""
    assert (report["works"], report["config"]) == (False, str(CONFIGS / "lab.yaml"))
    missing = {finding["name"]: finding for finding in report["findings"] if finding["mark"] == "missing"}
    assert set(missing) >= {"r1's port", "r2's port", "r3's port"}
    assert all(finding["cure"] for finding in missing.values())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nothing.yaml"], "there is no such file"),
        ([CONFIGS / "platoon.yaml", "--set", "robots.0.tga=1"], "unknown key"),
        ([CONFIGS / "platoon.yaml", "--robots", "r9"], "there is no robot 'r9'"),
        (["--ask", ""], "--ask: name a serial port"),
        (["--set", "robots.0.tag=1"], "--set: it belongs to a configuration"),
        ([CONFIGS / "platoon.yaml", "--set", "robots.0.settings={port: x}"], "takes none"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments: list[object], says: str) -> None:
    result = doctor(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert says in line


@pytest.mark.slow
def test_a_machine_without_lab_can_run_a_robots_driver_and_no_run(folder: Path) -> None:
    script = folder / "bare.py"
    script.write_text(f"""
import sys
import importlib.metadata as installed
for name in {(*LAB_MODULES, "pypylon")!r}:
    sys.modules[name] = None
there = installed.version
def version(name):
    if name in ("numba", "matplotlib", "opencv-python-headless"):
        raise installed.PackageNotFoundError(name)
    return there(name)
installed.version = version
from typer.testing import CliRunner
from robofleet.cli import app
for arguments in ([], ["--robots", "r1,r2"]):
    done = CliRunner().invoke(app, ["doctor", {str(CONFIGS / "platoon.yaml")!r}, *arguments, "--json"])
    print(done.exit_code, done.stdout.strip())
""")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)

    def parts(line: str) -> tuple[int, dict[str, tuple[str, str]]]:
        code, _, output = line.partition(" ")
        return int(code), {
            finding["name"]: (finding["mark"], finding["says"]) for finding in json.loads(output)["findings"]
        }

    whole, drivers = map(parts, done.stdout.splitlines())
    code, found = whole
    mark, says = found["packages of lab"]
    assert (code, mark) == (1, "missing")
    assert "numba is not installed" in says
    code, found = drivers
    mark, says = found["packages of lab"]
    assert (code, mark) == (0, "ok")
    assert "not one that runs `robofleet node driver`" in says
    assert "browser" not in found


def test_a_check_that_hangs_or_fails_costs_its_own_line() -> None:
    ended = threading.Event()

    def hang(_needs: Needs) -> Iterator[Finding]:
        yield ok("first", "fine")
        ended.wait()

    def fail(_needs: Needs) -> Iterator[Finding]:
        raise PermissionError(13, "not yours")

    checks = {"slow": hang, "broken": fail, "last": lambda _: iter([ok("last", "fine")])}
    found = examination.examine(Needs(), checks, at_most_s=0.2)
    ended.set()
    assert [finding.name for finding in found] == ["first", "slow", "broken", "last"]
    assert [finding.mark for finding in found] == [Mark.OK, Mark.WARN, Mark.WARN, Mark.OK]
    assert "no answer within 0.2 s" in found[1].says
    assert "PermissionError" in found[2].says


def test_a_library_that_hangs_or_ends_its_process_is_told_apart_from_an_answer() -> None:
    assert elsewhere.run_apart("print('hello'); print([1, 2])") == [1, 2]
    with pytest.raises(elsewhere.NoAnswerError, match="killed by SIGSEGV"):
        elsewhere.run_apart("import os; os.kill(os.getpid(), 11)")
    with pytest.raises(elsewhere.NoAnswerError, match=r"no answer within 0.1 s"):
        elsewhere.run_apart("import threading; threading.Event().wait()", at_most_s=0.1)


def test_an_old_package_is_missing_and_a_wanted_extra_is_judged_by_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {"numba": "0.60.9"}
    version = software.version
    monkeypatch.setattr(software, "version", lambda name: versions.get(name) or version(name))
    found = {package.name: package for package in software.packages(Needs())}
    assert found["packages of lab"].mark is Mark.MISSING
    assert "numba 0.60.9 is installed, and >=0.61 is needed" in found["packages of lab"].says
    assert "pip install" in found["packages of lab"].cure


def test_a_driver_whose_package_is_not_there_is_missing() -> None:
    needs = Needs(load_config(CONFIGS / "platoon.yaml", ["robots.1.driver=sparrow:Sparrow"]))
    found = {driver.name: driver for driver in software.drivers(needs)}
    assert found["driver simulated"].mark is Mark.OK
    assert found["driver sparrow:Sparrow"].mark is Mark.MISSING
    assert "for r2" in found["driver sparrow:Sparrow"].says


def test_a_disk_without_room_or_a_folder_that_is_not_ours_is_missing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hour = Needs(load_config(CONFIGS / "platoon.yaml", ["run.duration_s=3600"]))
    monkeypatch.setattr(places.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 500_000_000}))
    assert [finding.mark for finding in places.disk(Needs())] == [Mark.OK]
    (full,) = places.disk(hour)
    assert full.mark is Mark.MISSING
    assert "needs 0.86 GB" in full.says
    monkeypatch.setattr(places.os, "access", lambda *_: False)
    assert [finding.mark for finding in (*places.disk(hour), *places.state(hour))] == [Mark.MISSING, Mark.MISSING]


def test_a_bus_in_a_folder_of_others_is_missing_with_the_command_that_closes_it(folder: Path) -> None:
    shared = folder / "shared"
    shared.mkdir(mode=0o777)
    shared.chmod(0o777)
    endpoint = f"bus.endpoint=unixsock-stream/{shared}/bus.sock"
    (found,) = places.bus(Needs(load_config(CONFIGS / "platoon.yaml", [endpoint])))
    assert found.mark is Mark.MISSING
    assert f"chmod 700 {shared}" in found.cure


def test_a_container_has_the_share_that_it_was_given(tmp_path: Path) -> None:
    quota = tmp_path / "cpu.max"
    everything = computer.usable_cores(tmp_path / "none")
    quota.write_text("max 100000\n")
    assert computer.usable_cores(quota) == everything
    quota.write_text("50000 100000\n")
    assert computer.usable_cores(quota) == 0.5


def test_priorities_that_are_refused_give_the_lines_to_paste(monkeypatch: pytest.MonkeyPatch) -> None:
    before = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    assert [finding.name for finding in computer.priorities(Needs())] == ["priorities"]
    assert (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)) == before

    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    (found,) = computer.priorities(Needs())
    assert found.mark is Mark.WARN
    assert "no real-time priority 20" in found.says
    assert {paste.line.split()[2:][0] for paste in found.pastes} == {"rtprio", "nice"}


def test_a_terminal_without_signs_gets_words_and_pastes_stand_whole(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rule = "x" * 300
    found = [
        ok("one", "fine", Paste("/etc/a", rule)),
        Finding("two", Mark.MISSING, "gone", "bring it", (Paste("/etc/a", rule),)),
    ]
    assert pastes(found) == ["", "To paste into /etc/a, as root:", rule]
    show(found, "Verdict.")
    assert capsys.readouterr().out.splitlines()[:2] == ["✓ ok       one  fine", "✗ missing  two  gone: bring it"]
    monkeypatch.setattr("rich.console.Console.encoding", "ascii")
    show(found, "Verdict.")
    assert capsys.readouterr().out.splitlines()[:2] == ["ok       one  fine", "missing  two  gone: bring it"]
