"""How busy the computer is, from what Linux writes; and whether that explains a silence."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from robofleet.core.clock import MS, S, WallClock
from robofleet.nodes import machine
from robofleet.nodes.machine import MachineProbe, Siblings, Silence
from robofleet.safety import busy
from robofleet.safety.busy import CONTROLLER
from robofleet.safety.view import Turns

Say = Callable[..., None]
CLOCK = WallClock()


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch) -> Say:
    """Let the system say something; None: it has no such file."""
    files: dict[str, bytes | None] = {}

    def said(*, pressure_us: int | None, stolen: int = 0, ready: int = 1, account: bytes = b"") -> None:
        full = (
            b""
            if pressure_us is None
            else b"some avg10=9.2 avg60=7.4 avg300=2.7 total=%d\nfull total=1\n" % pressure_us
        )
        files["pressure/cpu"] = full
        files["stat"] = b"cpu  1 2 3 4 5 6 7 %d 0 0\ncpu0 9 9 9 9\n" % stolen
        files["7/schedstat"] = account
        files["loadavg"] = b"6.13 4.2 3.1 %d/416 99\n" % ready

    monkeypatch.setattr(machine, "_opened", lambda path: path.removeprefix("/proc/"))
    monkeypatch.setattr(machine, "_read", lambda name: files.get(name) or b"")
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda _: {0, 1})
    return said


def test_contention_is_pressure_and_what_a_hypervisor_took(say: Say) -> None:
    probe = MachineProbe()
    say(pressure_us=1_000_000, stolen=4)
    before = probe(0)
    say(pressure_us=1_250_000, stolen=8)
    after = probe(S)
    assert before is not None
    assert after is not None
    assert (after.load, after.cores) == (6.13, 2)
    assert after.contended_ns - before.contended_ns == 250 * MS + 4 * 10 * MS // 2


def test_without_pressure_the_processes_that_are_ready_are_counted(say: Say) -> None:
    probe, contended = MachineProbe(), []
    for at_ns, ready in ((0, 9), (S, 3), (2 * S, 2), (3 * S, 9)):
        say(pressure_us=None, ready=ready)
        measured = probe(at_ns)
        assert measured is not None
        contended.append(measured.contended_ns)
    assert contended == [0, S, S, 2 * S]


def test_a_system_that_says_nothing_is_not_measured(say: Say) -> None:
    assert MachineProbe()(0) is None
    assert Silence(0).load(S) == ""


def test_this_computer_is_measured() -> None:
    probe = MachineProbe()
    first, second = probe(0), probe(S)
    probe.close()
    assert first is not None
    assert second is not None
    assert second.contended_ns >= first.contended_ns > 0
    assert second.cores > 0


WORKS = "import time; print(1, flush=True)\nwhile True: time.sleep(0.01)"


@pytest.fixture
def started() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Return what starts a program under a process's command line, and returns when it runs."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(program: str, *command: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-c", program, "robofleet", "node", *command], stdout=subprocess.PIPE
        )
        processes.append(process)
        assert process.stdout is not None
        process.stdout.read(1)
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def turned(probe: Callable[[], Turns | None], times: int) -> int:
    """Wait until a process has taken so many turns more; returns how many it took."""
    first = now = probe()
    end_ns = CLOCK.now_ns() + 10 * S
    while first is not None and now is not None and now.taken - first.taken < times and CLOCK.now_ns() < end_ns:
        CLOCK.sleep_until(CLOCK.now_ns() + 10 * MS)
        now = probe()
    assert first is not None
    assert now is not None
    return now.taken - first.taken


def test_the_processes_of_a_run_are_found_by_their_command_lines_and_their_turns_counted(
    started: Callable[..., subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine.os, "getppid", os.getpid)
    started(WORKS, "driver", "run.yaml", "--robots", "r2,r3")
    started(WORKS, "controller", "run.yaml")
    tracker = started(
        WORKS, "tracker", "run.yaml", "--camera", "left"
    )  # one of several: whose poses are newest changes
    siblings = Siblings(["r1", "r2", "r3"])
    found = siblings(0)
    if not any(found):
        found = siblings(S)
    assert [turns is not None for turns in found] == [False, True, False, False, True, True]
    assert found[4] == found[5]
    assert turned(lambda: siblings(0)[4], 5) >= 5
    tracker.kill()
    siblings.close()


def test_a_stopped_process_does_not_try_and_one_that_works_does(
    started: Callable[..., subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine.os, "getppid", os.getpid)
    process = started(WORKS, "controller", "run.yaml")
    siblings = Siblings(["r1"])
    siblings(0)
    assert turned(lambda: siblings(S)[CONTROLLER], 3) >= 3
    os.kill(process.pid, signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)
    then = siblings(2 * S)[CONTROLLER]
    CLOCK.sleep_until(CLOCK.now_ns() + 300 * MS)
    assert not busy.tries(then, siblings(3 * S)[CONTROLLER], 300 * MS)
    os.kill(process.pid, signal.SIGCONT)
    assert turned(lambda: siblings(3 * S)[CONTROLLER], 6) >= 6
    assert busy.tries(then, siblings(3 * S)[CONTROLLER], 300 * MS)
    siblings.close()


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (b"9 20000000 101", ""),  # it ran once more, and was stopped
        (b"9 1010000000 101", "load 6.1 on 2 cores"),  # it waited for half of the time
        (b"9 20000000 140", "load 6.1 on 2 cores"),  # it works, and its words were late
        (b"0 0 0", "load 6.1 on 2 cores"),  # this system counts nothing
    ],
)
def test_load_does_not_explain_the_silence_of_a_process_that_does_not_try(say: Say, after: bytes, words: str) -> None:
    say(pressure_us=5, account=b"5 10000000 100")
    silence = Silence(0)
    silence.of(7)
    silence.heard(10 * S)
    say(pressure_us=2_000_005, account=after)
    assert silence.load(12 * S) == words


@pytest.mark.parametrize(("waited_us", "words"), [(1_000_000, "load 6.1 on 2 cores"), (999_999, "")])
def test_load_explains_a_silence_in_which_no_core_was_free_for_half_of_the_time(
    say: Say, waited_us: int, words: str
) -> None:
    say(pressure_us=5)
    silence = Silence(0)
    silence.heard(10 * S)
    say(pressure_us=5 + waited_us)
    assert silence.lasts_ns(12 * S) == 2 * S
    assert silence.load(12 * S) == words
