"""The operator's terminal in a real run: keys, the dead man's handle, and the terminal given back as it was."""

import signal
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.processes.realrun import RealRun

TRUTH = ("--set", "tracker.source=truth")
ATTENDED = (*TRUTH, "--set", "run.attended=true")
ALL_LATCHED = dict.fromkeys(("r1", "r2", "r3", "r4"), 2)
NONE_LATCHED = dict.fromkeys(ALL_LATCHED, 0)

Start = Callable[..., RealRun]


def mode(run: RealRun) -> list[object]:
    """Return the terminal's mode, but for its speeds and characters."""
    assert run.keyboard is not None
    return termios.tcgetattr(run.keyboard)[:4]


@pytest.mark.parametrize("key", [b"e", b" "], ids=["e", "space"])
def test_one_key_is_the_emergency_stop(real_run: Start, key: bytes) -> None:
    run = real_run(*TRUTH, terminal=True)
    before = mode(run)
    run.wait_until_running()
    assert mode(run) != before, "single keys, without Enter"
    run.press(key)
    assert run.ended(5) == 1
    assert run.children() == []
    assert mode(run) == before
    assert run.latched() == ALL_LATCHED
    assert run.summary["outcome"] == "stopped"
    assert run.summary["cause"].startswith("emergency stop (by key); every robot has latched its gate")
    stops = [stop for stop in run.summary["stops"] if "emergency stop requested" in stop["cause"]]
    assert {stop["robot"] for stop in stops} == set(ALL_LATCHED)
    assert all(0 <= stop["target_ms"] <= stop["output_ms"] <= 230 for stop in stops)


def test_a_robot_that_does_not_answer_is_named(real_run: Start) -> None:
    run = real_run(*TRUTH, terminal=True)
    run.wait_until_running()
    (driver,) = run.children("driver", "r3")
    driver.send_signal(signal.SIGSTOP)
    run.press(b"e")
    assert run.ended(5) == 1
    assert run.summary["cause"] == "emergency stop (by key); NOT acknowledged within 200 ms by r3: stop them by hand"
    assert run.latched() == ALL_LATCHED | {"r3": 0}


def test_h_holds_r_resumes_q_ends(real_run: Start) -> None:
    run = real_run(*TRUTH, terminal=True)
    run.wait_until_running()
    run.press(b"h")
    run.wait_for(lambda: "\nheld: hold requested" in run.said)
    run.press(b"x")  # means nothing
    run.press(b"r")
    run.wait_for(lambda: run.said.count("\nrunning") == 2)
    run.press(b"q")
    assert run.ended(5) == 1
    assert (run.summary["outcome"], run.summary["cause"]) == ("stopped", "the operator ended it")
    assert run.latched() == NONE_LATCHED


def test_ctrl_c_twice_is_the_emergency_stop(real_run: Start) -> None:
    run = real_run(*TRUTH, terminal=True)
    before = mode(run)
    run.wait_until_running()
    run.press(b"\x03")
    run.wait_for(lambda: "\nstopping" in run.said)
    run.press(b"\x03")
    assert run.ended(5) == 1
    assert run.summary["cause"].startswith("emergency stop (interrupted twice); every robot")
    assert run.latched() == ALL_LATCHED
    assert mode(run) == before


def test_ctrl_z_is_a_controlled_stop_and_gives_the_terminal_back(real_run: Start) -> None:
    run = real_run(*TRUTH, terminal=True)
    before = mode(run)
    run.wait_until_running()
    run.press(b"\x1a")
    assert run.ended(5) == 1
    assert run.summary["cause"] == "the operator interrupted"
    assert mode(run) == before


def test_an_attended_run_stops_at_once_when_its_terminal_is_closed(real_run: Start) -> None:
    run = real_run(*ATTENDED, terminal=True)
    run.wait_until_running()
    run.close_terminal()
    assert run.ended(5) == 1
    assert run.summary["cause"].startswith("emergency stop (the operator's terminal is gone); every robot")
    assert run.latched() == ALL_LATCHED


def test_a_run_that_nobody_attends_stops_well_when_its_terminal_is_closed(real_run: Start) -> None:
    run = real_run(*TRUTH, terminal=True)
    run.wait_until_running()
    run.close_terminal()
    assert run.ended(5) == 1
    assert run.summary["cause"] == "the operator interrupted"
    assert run.latched() == NONE_LATCHED


def test_an_attended_run_without_a_terminal_is_refused(real_run: Start) -> None:
    run = real_run(*ATTENDED)
    assert run.ended(20) == 2
    assert run.said == "run.attended: stdin is no terminal: start the run in one, or set it to false\n"
    assert not run.folder.exists()


def test_a_run_in_the_background_of_its_terminal_takes_no_keys(tmp_path: Path) -> None:
    """A read from the background would stop the launcher, and the robots would go on."""
    code = "from robofleet.processes.terminal import Terminal\nwith Terminal() as t: print(t.present)"
    shell = f"{sys.executable} -c '{code}' & wait"  # a shell without job control gives it /dev/null; `script` below not
    done = subprocess.run(
        ["script", "-qec", f"bash -ic \"{shell}\"", "/dev/null"],
        capture_output=True, text=True, check=False, timeout=20, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert "False" in done.stdout
    assert "True" not in done.stdout
