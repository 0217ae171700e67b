"""What a run's messages say of a busy machine, in words and in figures."""

from collections.abc import Iterable
from typing import Any

from robofleet.bus.messages import BUSY_MACHINE, BusyMachine
from robofleet.safety import busy
from robofleet.safety.busy import DRIVERS, Lateness

_NAMES = "supervisor", "controller", "tracker"


def notice(message: BusyMachine, robots: tuple[str, ...]) -> str:
    """Return what is said once in a run; ``robots`` are the ids in the group's order."""
    return f"this machine is busy: {_so_far(message, robots)}"


def figures(payloads: Iterable[bytes], robots: tuple[str, ...]) -> dict[str, Any] | None:
    """Return how busy the machine was, as ``summary.json`` has it; None: nobody was late by its load.

    ``late_s``: the most that each process was; ``resumed``: how often the run went on by itself; ``armed_again``: how
    often the checks before the start began anew.
    """
    messages = [message for payload in payloads if (message := BUSY_MACHINE.decode(payload)) is not None]
    if not messages:
        return None
    newest, load = messages[-1], max(message.load for message in messages)
    return {
        "resumed": newest.resumed,
        "armed_again": newest.attempts,
        "load": round(load, 2),
        "cores": newest.cores,
        "late_s": {_name(process.process, robots): round(process.most_ns / 1e9, 3) for process in newest.late},
        "words": verdict(newest, load, robots),
    }


def verdict(message: BusyMachine, load: float, robots: tuple[str, ...]) -> str:
    """Return a run's verdict on its machine."""
    sentence = f"This machine was busy: {_so_far(message._replace(load=load), robots)}."
    if message.attempts:
        sentence += f" The checks before the start began anew {_times(message.attempts)}."
    if message.resumed:
        sentence += f" The run was held and went on by itself {_times(message.resumed)}."
    return sentence


def _so_far(message: BusyMachine, robots: tuple[str, ...]) -> str:
    late = [Lateness(process.process, process.most_ns) for process in message.late]
    return busy.words(busy.latest(late), message.load, message.cores, robots)


def _name(process: int, robots: tuple[str, ...]) -> str:
    if process < DRIVERS:
        return _NAMES[process]
    row = process - DRIVERS
    return f"driver-{robots[row]}" if row < len(robots) else f"process-{process}"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
