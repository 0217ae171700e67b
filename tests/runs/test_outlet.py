"""A screen that takes nothing, or is gone: the run goes on, ends as it would have, and leaves all its files."""

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.runs.realrun import ALONE, PLATOON, RealRun, fill, own_folders, wait

pytestmark = pytest.mark.long

Start = Callable[..., RealRun]
_BRIEF = (*ALONE, "--duration", "1")


def phase(run: RealRun) -> str | None:
    """Return where a run is, as another terminal sees it."""
    done = run.robofleet("status", "--json")
    return None if done.returncode else json.loads(done.stdout)["phase"]


def outcome(folder: Path) -> str:
    """Return how a run ended, by the files that every run leaves."""
    assert (folder / "report.html").is_file()
    return str(json.loads((folder / "summary.json").read_text())["outcome"])


def read_until(descriptor: int, word: bytes) -> None:
    output = b""
    while word not in output:
        more = os.read(descriptor, 999)
        assert more, output
        output += more


@pytest.mark.parametrize("key", [b" ", b"e"])
@pytest.mark.parametrize("stopped_by", ["nobody reads", "Ctrl-S"])
def test_the_emergency_key_is_heard_though_the_terminal_takes_no_output(
    real_run: Start, key: bytes, stopped_by: str
) -> None:
    run = real_run(*ALONE, terminal=True, screen="full terminal" if stopped_by == "nobody reads" else "terminal")
    run.wait_for(lambda: phase(run) == "running")
    if stopped_by == "Ctrl-S":
        run.press(b"\x13")
    run.press(key)
    assert wait(lambda: run.latched() == {"r1": 2}, 5)
    assert run.ended() == 1
    assert outcome(run.folder) == "stopped"
    assert run.nothing_is_left()


def test_a_run_on_a_terminal_that_takes_no_output_is_ended_by_its_key(real_run: Start) -> None:
    run = real_run(*ALONE, terminal=True, screen="full terminal")
    run.wait_for(lambda: phase(run) == "running")
    run.press(b"q")
    assert run.ended() == 1
    assert outcome(run.folder) == "stopped"
    assert run.latched() == {"r1": 0}


@pytest.mark.parametrize("how", [(), ("--json",), ("--quiet",)])
@pytest.mark.parametrize("reader", ["gone", "asleep"])
def test_a_run_is_completed_whoever_reads_what_it_says(real_run: Start, how: tuple[str, ...], reader: str) -> None:
    reading, writing = os.pipe()
    if reader == "asleep":
        fill(writing)
    run = real_run(*_BRIEF, *how, screen=writing)
    os.close(writing)
    if reader == "gone":
        os.close(reading)
    assert run.ended() == 0
    assert outcome(run.folder) == "completed"


def test_a_reader_that_ends_in_the_middle_ends_no_run(real_run: Start) -> None:
    reading, writing = os.pipe()
    run = real_run(*_BRIEF, screen=writing)
    os.close(writing)
    read_until(reading, b"\nrunning")
    os.close(reading)
    assert run.ended() == 0
    assert outcome(run.folder) == "completed"


@pytest.mark.parametrize("nohup", [False, True])
def test_a_closed_terminal_leaves_a_run_with_all_its_files(real_run: Start, nohup: bool) -> None:
    """Unattended: without nohup its hang-up is one Ctrl-C; with it the run goes on to its end."""
    run = real_run(*ALONE, "--duration", "3" if nohup else "60", terminal=True, screen="terminal", nohup=nohup)
    run.wait_for(lambda: phase(run) == "running")
    run.close_terminal()
    assert run.ended() == (0 if nohup else 1)
    assert outcome(run.folder) == ("completed" if nohup else "stopped")


@pytest.fixture
def lockstep(tmp_path: Path) -> Iterator[Callable[..., "subprocess.Popen[bytes]"]]:
    """Return what starts a lockstep run that says everything to a descriptor."""
    started: list[subprocess.Popen[bytes]] = []

    def start(screen: int, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-W", "error", "-m", "robofleet", "run", str(PLATOON), "--lockstep", *_BRIEF]
        started.append(
            subprocess.Popen(
                [*command, "--out", str(tmp_path / "run"), *arguments],
                env=own_folders(tmp_path),
                stdin=subprocess.DEVNULL,
                stdout=screen,
                stderr=screen,
                start_new_session=True,
            )
        )
        os.close(screen)
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.parametrize("how", [(), ("--json",)])
@pytest.mark.parametrize("screen", ["full terminal", "closed terminal", "full pipe", "closed pipe"])
def test_a_lockstep_run_is_completed_whoever_reads_what_it_says(
    lockstep: Callable[..., "subprocess.Popen[bytes]"], tmp_path: Path, how: tuple[str, ...], screen: str
) -> None:
    reading, writing = pty.openpty() if "terminal" in screen else os.pipe()
    if "full" in screen:
        fill(writing)
    run = lockstep(writing, *how)
    if "closed" in screen:
        os.close(reading)
    assert run.wait(90) == 0
    assert outcome(tmp_path / "run") == "completed"


def test_a_lockstep_run_whose_terminal_hangs_up_ends_as_by_ctrl_c(
    lockstep: Callable[..., "subprocess.Popen[bytes]"], tmp_path: Path
) -> None:
    reading, writing = os.pipe()
    run = lockstep(writing, "--duration", "100000", "--set", "run.seed=3")
    read_until(reading, b"running")
    run.send_signal(signal.SIGHUP)
    os.close(reading)
    assert run.wait(60) == 1
    assert outcome(tmp_path / "run") == "stopped"


SAYS = """
import sys
from robofleet.operator.terminal.outlet import unhindered
with unhindered():
    for line in range(4000):
        print("out", line)
        print("err", line, file=sys.stderr)
print("after")
"""


def test_what_is_read_comes_whole_and_in_the_order_in_which_it_was_said() -> None:
    """On one terminal or pipe; a reader that is slow loses the oldest, never the newest."""
    reading, writing = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", SAYS], stdout=writing, stderr=writing)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        lines = stream.read().decode().splitlines()
    assert process.wait(20) == 0
    assert lines[-3:] == ["out 3999", "err 3999", "after"]
    numbers = [2 * int(n) + (which == "err") for which, n in map(str.split, lines[:-1])]
    assert numbers == sorted(set(numbers))
