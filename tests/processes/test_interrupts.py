"""What an operator can do to the launcher by the terminal; each is a controlled stop."""

import signal

import pytest

from robofleet.processes import launcher


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP"])
def test_no_signal_of_the_terminal_leaves_the_robots_driving_alone(name: str) -> None:
    number = signal.Signals[name]
    before = signal.getsignal(number)
    with launcher._interrupts() as interrupts:
        assert signal.getsignal(number) is interrupts
        signal.raise_signal(number)
        assert interrupts.count == 1
    assert signal.getsignal(number) == before
