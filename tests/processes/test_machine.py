"""How busy the computer is, from what Linux writes; and whether that explains a silence."""

from collections.abc import Callable

import pytest

from robofleet.clock import MS, S
from robofleet.processes import machine
from robofleet.processes.machine import MachineProbe, Silence

Say = Callable[..., None]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch) -> Say:
    """Let the system say something; None: it has no such file."""
    files: dict[str, bytes | None] = {}

    def said(*, pressure_us: int | None, stolen: int = 0, ready: int = 1) -> None:
        full = (
            b""
            if pressure_us is None
            else b"some avg10=9.2 avg60=7.4 avg300=2.7 total=%d\nfull total=1\n" % pressure_us
        )
        files["pressure/cpu"] = full
        files["stat"] = b"cpu  1 2 3 4 5 6 7 %d 0 0\ncpu0 9 9 9 9\n" % stolen
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
