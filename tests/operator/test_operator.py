"""A running arena, reached from another terminal."""

import json
import signal
import termios
from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.bus.keys import TICK, key
from robofleet.nodes.unit.state_store import FileStateStore, StoredRobot
from robofleet.recording.reading import read
from robofleet.runs.replay import replay
from robofleet.safety.latches import Latch
from tests.command import robofleet
from tests.runs.realrun import ALONE, GONE_WITHIN_S, PLATOON, RealRun, of_robots, own_folders, wait

Start = Callable[..., RealRun]


def mode(run: RealRun) -> list[object]:
    """Return the terminal's mode, but for its speeds and characters."""
    assert run.keyboard is not None
    return termios.tcgetattr(run.keyboard)[:4]


def test_a_run_is_reset_armed_started_held_and_resumed_and_stops_also_when_its_supervisor_is_frozen(
    real_run: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By keys, and from another terminal."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    FileStateStore("platoon").save("r1", StoredRobot(4, Latch.EMERGENCY_STOP, 7))
    run = real_run(*of_robots("r1", "r2"), "--set", "run.start=operator", "--reset", terminal=True)
    before = mode(run)
    run.wait_for(lambda: "waiting: everything is there" in run.said)
    assert mode(run) != before, "single keys, without Enter"
    run.press(b"a")
    run.wait_for(lambda: "armed: every check is passed" in run.said)
    started = run.asked("start")
    assert started.exit_code == 0, started.stderr
    run.wait_until_running()
    assert run.latched() == {"r1": 0, "r2": 0}
    run.press(b"h")
    run.wait_for(lambda: run.newest.startswith("held: hold requested"))
    found = json.loads(run.asked("status", "--json").stdout)
    assert (found["arena"], found["phase"], found["cause"]) == ("platoon", "hold", "hold requested")
    assert found["next"] == "the run is held: resume it, or stop it"
    assert (found["pid"], found["folder"]) == (run.launcher.pid, str(run.folder))
    for robot, name in zip(found["robots"], ("r1", "r2"), strict=True):
        assert (robot["id"], robot["gate"], robot["latch"], robot["halted"]) == (name, "no enable", "none", None)
        assert 0 < robot["battery"] <= 1
        assert 0 <= robot["age_ms"] < 500, "not silent"

    second = run.asked("run", str(PLATOON), "--out", str(run.folder / "second"))
    assert second.exit_code == 2
    assert f"the arena platoon has a run already, in {run.folder} since " in second.stderr
    assert f"`kill {run.launcher.pid}`" in second.stderr
    assert not (run.folder / "second").exists()

    refused = run.asked("reset")
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert refused.stderr.startswith("refused: ")
    run.press(b"x")  # means nothing
    run.press(b"r")
    run.wait_until_running()
    assert run.asked("hold", "platoon").stdout == "ok\n"
    run.wait_for(lambda: run.newest.startswith("held: hold requested"))
    assert run.asked("resume").stdout == "ok\n"
    run.wait_until_running()

    (supervisor,) = run.children("supervisor")
    supervisor.send_signal(signal.SIGSTOP)
    stopped = run.robofleet("stop")
    assert (stopped.returncode, stopped.stderr) == (0, "")
    assert stopped.stdout.startswith("emergency stop of platoon: every robot has latched its gate, the last one after ")
    assert run.ended() == 1
    assert run.nothing_is_left()
    assert mode(run) == before
    assert run.latched() == {"r1": 2, "r2": 2}
    assert run.summary["outcome"] == "stopped"
    assert run.summary["cause"].startswith("emergency stop (at the gates; the supervisor went silent")


@pytest.mark.long
def test_one_key_stops_a_run(real_run: Start) -> None:
    run = real_run(*ALONE, terminal=True)
    run.wait_until_running()
    run.press(b"e")
    assert run.ended() == 1
    assert run.nothing_is_left()
    assert run.latched() == {"r1": 2}
    assert run.summary["outcome"] == "stopped"
    assert run.summary["cause"].startswith("emergency stop (by key); every robot has latched its gate")
    (stop,) = [stop for stop in run.summary["stops"] if stop["cause"] == "latched: emergency stop requested"]
    assert stop["robot"] == "r1"
    assert 0 <= stop["target_ms"] <= stop["output_ms"]
    assert stop["output_ms"] <= 230 or run.summary["busy_machine"]


@pytest.mark.long
def test_q_ends_a_run_and_what_it_leaves_is_replayed(real_run: Start) -> None:
    run = real_run(*ALONE, terminal=True)
    run.wait_until_running()
    run.press(b"q")
    assert run.ended() == 1
    assert run.nothing_is_left()
    assert (run.summary["outcome"], run.summary["cause"]) == ("stopped", "the operator ended it")
    assert run.summary["ticks"] > 0
    assert "stopped: the operator ended it" in run.said
    assert run.latched() == {"r1": 0}
    recording = read(run.folder)
    verdict = replay(recording, 0.0)
    assert verdict.equal, verdict.lines()
    assert verdict.ticks == len(recording.messages[key("platoon", TICK)]) > 60


@pytest.mark.long
def test_latches_outlive_a_run_until_they_are_reset_and_robofleet_stop_latches_again(
    real_run: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    FileStateStore("platoon").save("r1", StoredRobot(4, Latch.EMERGENCY_STOP, 7))
    refused = real_run(*ALONE)
    assert refused.ended() == 2
    assert "platoon: r1 is latched by an emergency stop (" in refused.said
    assert "`robofleet reset platoon` or: `robofleet run " in refused.said
    assert refused.said.endswith(" --reset`\n"), "the whole command"
    assert not refused.folder.exists()
    assert refused.latched() == {"r1": 2}

    run = real_run(*ALONE, "--reset", name="again")
    run.wait_until_running()
    assert run.latched() == {"r1": 0}
    stopped = run.robofleet("stop")
    assert (stopped.returncode, stopped.stderr) == (0, "")
    assert stopped.stdout.startswith("emergency stop of platoon: every robot has latched its gate, the last one after ")
    assert run.ended() == 1
    assert run.latched() == {"r1": 2}
    assert run.summary["cause"].startswith("emergency stop; every robot has latched its gate")


@pytest.mark.long
def test_a_bus_that_does_not_answer_does_not_keep_the_operator_waiting(real_run: Start) -> None:
    run = real_run(*ALONE)
    run.wait_until_running()
    (router,) = run.children("router")
    router.send_signal(signal.SIGSTOP)
    stopped = run.robofleet("stop")
    assert stopped.returncode == 1
    assert "does not answer: the launcher was told to end every process" in stopped.stderr
    assert wait(lambda: not run.children("driver"), GONE_WITHIN_S)
    assert run.ended(10) == 1
    assert run.children() == []


def test_without_a_run_there_is_nothing_to_stop(tmp_path: Path) -> None:
    for command in ("stop", "hold", "resume", "status"):
        done = robofleet(command, env=own_folders(tmp_path))
        assert (done.exit_code, done.stdout) == (2, ""), command
        where = f"{tmp_path}/tmp/robofleet or {tmp_path}/rt/robofleet"
        assert done.stderr == f"no arena has a run in {where}: start one with `robofleet run CONFIG`\n", command
