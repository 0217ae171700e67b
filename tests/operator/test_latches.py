"""Latches that an earlier run has left: they refuse the next start at once, and are reset between runs."""

import io
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import Result

from robofleet.nodes.unit.state_store import FileStateStore, StoredRobot
from robofleet.operator import direct
from robofleet.safety.latches import Latch
from robofleet.scripts.fleet import Fleet
from robofleet.scripts.script_link import FleetError
from tests.command import robofleet
from tests.runs.realrun import PLATOON, own_folders

STOPPED = StoredRobot(4, Latch.EMERGENCY_STOP, 7)
SCRIPT = PLATOON.parent / "script.yaml"


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    for name, value in own_folders(tmp_path).items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    yield tmp_path / "state" / "robofleet"


def leave(robots: str = "r1", *, arena: str = "platoon", simulated: bool = True, memory: StoredRobot = STOPPED) -> None:
    store = FileStateStore(arena, simulated=simulated)
    for robot in robots.split():
        store.save(robot, memory)


def left(arena: str = "platoon") -> list[str]:
    return [stored.robot for stored in FileStateStore(arena).latches()]


def reset(*words: str) -> Result:
    return robofleet("reset", *words)


@pytest.mark.slow
def test_the_same_command_is_refused_with_the_whole_command_that_works_before_anything_is_started(
    tmp_path: Path,
) -> None:
    leave("r1 r3")
    typed = ["run", str(PLATOON), "--set", "run.duration_s=3", "--web", "--out", "a run"]
    command = [sys.executable, "-m", "robofleet", *typed]
    done = subprocess.run(
        command, env=os.environ, capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert re.match(r"platoon: r1, r3 are latched by an emergency stop \(\d+ \w+ \d\d:\d\d\)\. Clear it with: ", line)
    assert re.findall("`([^`]+)`", line) == [
        "robofleet reset platoon",
        shlex.join(["robofleet", *typed, "--reset"]),
    ]
    assert not (tmp_path / "a run").exists()
    assert not [*(tmp_path / "tmp" / "robofleet").glob("*.json")], "the arena is free again"


@pytest.mark.parametrize("command", [["run", str(PLATOON)], ["go", str(PLATOON), "r1=0,0,0"]])
def test_real_robots_are_to_be_looked_at(command: list[str]) -> None:
    leave("r1", simulated=False)
    leave("r2", simulated=False, memory=STOPPED._replace(latch=Latch.RUNAWAY))
    done = robofleet(*command)
    assert done.exit_code == 2
    assert "r1 is latched by an emergency stop" in done.stderr
    assert "r2 is latched by a wheel that turned by itself" in done.stderr
    assert "Look at the robots. Clear it with: `robofleet reset platoon`" in done.stderr


def test_a_script_is_refused_too() -> None:
    leave("r2", arena="script")
    with pytest.raises(FleetError, match=r"r2 is latched by an emergency stop .*`robofleet reset script`"):
        Fleet(SCRIPT, settings=["arena.name=script"], out=False).open()


@pytest.mark.parametrize("words", [(), ("platoon",), (str(PLATOON),), (str(PLATOON), "--set", "run.seed=3")])
def test_simulated_robots_are_reset_between_runs_without_a_question(words: tuple[str, ...]) -> None:
    leave("r1 r2 r10")
    done = reset(*words)
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout == "platoon: r1, r2, r10: reset; nothing has moved, and the next run can start\n"
    assert FileStateStore("platoon").load("r1") == STOPPED._replace(latch=Latch.NONE), "its lease goes on counting"
    assert reset("platoon").stdout == "platoon: no robot is latched on this computer: nothing to reset\n"


def test_real_robots_are_reset_by_who_says_that_they_are_at_rest() -> None:
    leave("r1", simulated=False)
    leave("r2")
    refused = reset("platoon")
    assert refused.exit_code == 2
    assert "`robofleet reset platoon --yes`" in refused.stderr
    assert left() == ["r1", "r2"]
    assert reset("platoon", "--yes").exit_code == 0
    assert left() == []


class Keyboard(io.StringIO):
    """What somebody types at a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("answer", "code", "latched"), [("y\n", 0, []), ("\n", 1, ["r1"]), ("no\n", 1, ["r1"]), ("", 1, ["r1"])]
)
def test_at_a_terminal_it_asks(
    answer: str, code: int, latched: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    leave("r1", simulated=False)
    monkeypatch.setattr(sys, "stdin", Keyboard(answer))
    assert direct.run(["reset", "platoon"]) == code
    assert "Are they at rest, and may they drive again?" in capsys.readouterr().out
    assert left() == latched


@pytest.mark.parametrize("name", ["elsewhere", "../platoon", "/etc", "platoon/..", "", "Platoon", "platoon\n"])
def test_an_arena_that_never_was_here_is_refused_with_those_that_are_latched(name: str) -> None:
    leave("r1")
    leave("r1", arena="lab")
    done = reset(name)
    assert done.exit_code == 2
    assert "arenas with latched robots: lab, platoon" in done.stderr
    assert left() == ["r1"]


def test_several_arenas_are_not_reset_by_guessing_and_none_is_no_fault() -> None:
    assert (reset().exit_code, reset().stdout) == (0, "no robot is latched on this computer: nothing to reset\n")
    assert reset(str(PLATOON)).exit_code == 0
    leave("r1")
    leave("r1", arena="lab")
    done = reset()
    assert (done.exit_code, done.stderr) == (2, "several arenas have latched robots: name one of lab, platoon\n")


def test_a_torn_file_counts_as_a_real_robots_and_is_whole_after_the_reset(folders: Path) -> None:
    leave("r1")
    (folders / "platoon" / "r1.json").write_text('{"latch": 0')
    refused = reset("platoon")
    assert (refused.exit_code, "a state file that cannot be read" in refused.stderr) == (2, True)
    assert reset("platoon", "--yes").exit_code == 0
    assert FileStateStore("platoon").load("r1") == StoredRobot(0, Latch.NONE, 1)


def test_a_driver_that_runs_keeps_its_latch() -> None:
    leave("r1")
    driver = FileStateStore("platoon", simulated=True)
    driver.prove(("r1",))
    done = reset("platoon")
    assert (done.exit_code, "a driver of platoon runs on this computer" in done.stderr) == (2, True)
    assert left() == ["r1"]
    del driver
    assert reset("platoon").exit_code == 0


def test_a_latch_that_came_meanwhile_stays() -> None:
    leave("r1 r2")
    store = FileStateStore("platoon", simulated=True)
    seen = store.latches()
    store.save("r2", StoredRobot(4, Latch.RUNAWAY, 8))
    assert store.clear(seen) == ("r2",)
    assert left() == ["r2"]


def test_a_simulated_run_makes_no_simulated_one_of_a_real_robots_latch(folders: Path) -> None:
    """Its drivers write the file again when they start."""
    leave("r1", simulated=False)
    store = FileStateStore("platoon", simulated=True)
    store.prove(("r1", "r2"))
    (stored,) = store.latches()
    assert not stored.simulated
    store.save("r1", StoredRobot(5, Latch.NONE, 7))
    store.save("r1", StoredRobot(5, Latch.EMERGENCY_STOP, 8))
    assert [stored.simulated for stored in store.latches()] == [True]
    half = (folders / "platoon" / "r1.json").read_bytes()[:4096]
    assert json.loads(half.rstrip().removesuffix(b",") + b"}")["simulated"] is True


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_file_that_cannot_be_written_is_named(folders: Path) -> None:
    leave("r1")
    (folders / "platoon" / "r1.json").chmod(0o400)
    done = reset("platoon")
    assert (done.exit_code, f"{folders}/platoon/r1.json: Permission denied" in done.stderr) == (2, True)
