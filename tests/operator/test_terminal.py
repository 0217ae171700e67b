"""The operator's terminal in a real run: keys, the dead man's handle, and the terminal given back as it was."""

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.runs.realrun import ALONE, PLATOON, RealRun, of_robots, own_folders, take_terminal, wait

ATTENDED = (*ALONE, "--set", "run.attended=true")

Start = Callable[..., RealRun]


@pytest.mark.long
def test_ctrl_c_twice_is_the_emergency_stop_and_who_does_not_answer_is_named(real_run: Start) -> None:
    run = real_run(*of_robots("r1", "r2"), "--set", "drivers.robots_per_process=1", terminal=True)
    run.wait_until_running()
    (driver,) = run.children("driver", "r2")
    driver.send_signal(signal.SIGSTOP)
    run.press(b"\x03")
    run.wait_for(lambda: "\nstopping" in run.said)
    run.press(b"\x03")
    assert run.ended() == 1
    silent = "NOT acknowledged within 200 ms by r2: stop them by hand"
    assert run.summary["cause"] == f"emergency stop (interrupted twice); {silent}"
    assert run.latched() == {"r1": 2, "r2": 0}
    assert run.nothing_is_left()


@pytest.mark.long
def test_an_attended_run_stops_at_once_when_its_terminal_is_closed(real_run: Start) -> None:
    run = real_run(*ATTENDED, terminal=True)
    run.wait_until_running()
    run.close_terminal()
    assert run.ended() == 1
    assert run.summary["cause"].startswith("emergency stop (the operator's terminal is gone); every robot")
    assert run.latched() == {"r1": 2}


@pytest.mark.long
def test_an_attended_run_whose_launcher_wakes_says_why_it_stopped(real_run: Start) -> None:
    run = real_run(*ATTENDED, terminal=True)
    run.wait_until_running()
    run.launcher.send_signal(signal.SIGSTOP)
    run.wait_for(lambda: run.latched() == {"r1": 2})
    run.launcher.send_signal(signal.SIGCONT)
    assert run.ended() == 1
    assert run.summary["cause"].startswith("emergency stop (the operator's terminal is gone); every robot")


@pytest.mark.slow
def test_an_attended_run_stops_when_its_launcher_is_frozen_and_nothing_is_left_when_it_is_killed(
    real_run: Start,
) -> None:
    run = real_run(*ATTENDED, terminal=True)
    run.wait_until_running()
    assert len(run.children()) == 6
    run.launcher.send_signal(signal.SIGSTOP)
    run.wait_for(lambda: run.latched() == {"r1": 2})
    run.launcher.kill()
    assert run.nothing_is_left()
    assert run.ended(1) == -signal.SIGKILL


@pytest.mark.slow
def test_an_attended_run_without_a_terminal_is_refused(real_run: Start) -> None:
    run = real_run(*ATTENDED)
    assert run.ended() == 2
    assert run.said == "run.attended: stdin is not a terminal: start the run in one, or set it to false\n"
    assert not run.folder.exists()


IN_A_TERMINAL = """
import os, pty, sys
child, keyboard = pty.fork()
if child == 0:
    os.execv(sys.executable, [sys.executable, "-c", sys.argv[1]])
said = b""
try:
    while more := os.read(keyboard, 999):
        said += more
except OSError:
    pass
print(said.decode())
"""
IN_THE_BACKGROUND = """
import os, signal, termios
from robofleet.operator.terminal.terminal import Terminal
before = termios.tcgetattr(0)
child = os.fork()
if child == 0:
    os.setpgid(0, 0)
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
    with Terminal() as terminal:
        os._exit(10 + terminal.present)
_, status = os.waitpid(child, os.WUNTRACED)
print("there" if Terminal().__enter__().present else "", os.WIFEXITED(status) and os.WEXITSTATUS(status))
"""
FAILING = """
import termios
from robofleet.operator.terminal.terminal import Terminal
before = termios.tcgetattr(0)
try:
    with Terminal():
        assert termios.tcgetattr(0) != before
        raise RuntimeError
except RuntimeError:
    print("given back:", termios.tcgetattr(0) == before)
"""


def in_a_terminal(code: str) -> str:
    command = [sys.executable, "-c", IN_A_TERMINAL, code]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.strip()


def test_a_run_in_the_background_of_its_terminal_takes_no_keys() -> None:
    """Reading there, or setting the mode, would stop the launcher and leave the robots driving."""
    assert in_a_terminal(IN_THE_BACKGROUND) == "there 10"


def test_the_terminal_is_given_back_after_an_exception() -> None:
    assert in_a_terminal(FAILING) == "given back: True"


BLOCKED = """
import os
from robofleet.operator.terminal.terminal import Terminal
hear, told = os.pipe()
with Terminal() as terminal:
    terminal.emergency = lambda: os.write(told, b"!")
    print("ready", flush=True)
    os.read(hear, 1)
"""
BLOCKED_RUN = """
import os, sys
from pathlib import Path
from robofleet.bus.endpoint import settled
from robofleet.config.load import load_config
from robofleet.runs.launcher import Launcher
from robofleet.operator.terminal.terminal import Terminal

def watch(recording, phase):
    print(phase, flush=True)
    if phase == "running":
        print("ready", flush=True)
        os.read(os.pipe()[0], 1)

config = settled(load_config(Path(sys.argv[1]), sys.argv[3::2]), listen=True)
with Terminal() as terminal:
    Launcher(config, Path(sys.argv[2]), watch, terminal).run()
"""


@contextmanager
def seated(code: str, *arguments: str, env: dict[str, str] | None = None) -> Iterator[tuple[Any, Callable[[], bytes]]]:
    """Run code in a terminal; gives (its process, what presses the space bar once it is ready)."""
    keyboard, theirs = pty.openpty()
    command = [sys.executable, "-c", code, *arguments]
    process = subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True, env=env,
        preexec_fn=take_terminal,  # noqa: PLW1509 - no thread holds a lock here
    )  # fmt: skip
    os.close(theirs)

    def press() -> bytes:
        output = b""
        while b"ready" not in output:
            output += os.read(keyboard, 999)
        os.write(keyboard, b" ")
        return output

    try:
        yield process, press
    finally:
        process.kill()
        process.wait()
        os.close(keyboard)


def test_the_emergency_key_is_heard_whatever_keeps_the_main_thread() -> None:
    with seated(BLOCKED) as (process, press):
        press()
        assert process.wait(10) == 0


@pytest.mark.long
def test_the_emergency_key_stops_the_robots_whatever_keeps_the_run_itself(alone: None, tmp_path: Path) -> None:
    environment, folder = own_folders(tmp_path), tmp_path / "run"
    folder.mkdir()
    kept = tmp_path / "state" / "robofleet" / "platoon" / "r1.json"
    with seated(BLOCKED_RUN, str(PLATOON), str(folder), *ALONE[1:], env=environment) as (_, press):
        press()
        assert wait(lambda: kept.exists() and json.loads(kept.read_text())["latch"] == 2, 5)
