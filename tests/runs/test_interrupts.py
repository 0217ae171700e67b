"""What an operator can do to the launcher by the terminal's signals; no signal leaves the robots driving alone."""

import signal

import pytest

from robofleet.operator.terminal.terminal import interrupts


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP"])
def test_no_signal_of_the_terminal_leaves_the_robots_driving_alone(name: str) -> None:
    number = signal.Signals[name]
    before = signal.getsignal(number)
    with interrupts() as counted:
        assert signal.getsignal(number) is counted
        signal.raise_signal(number)
        assert counted.count == 1
        assert counted.hung_up == (number == signal.SIGHUP)
    assert signal.getsignal(number) == before


def test_who_asked_for_no_hangup_has_none() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # nohup
    try:
        with interrupts() as counted:
            signal.raise_signal(signal.SIGHUP)
            assert counted.count == 0
    finally:
        signal.signal(signal.SIGHUP, before)
