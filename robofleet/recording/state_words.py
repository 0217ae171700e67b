"""A run's state and a busy machine in words: for terminal, page, commands, launcher, report and gateways."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from robofleet.bus.messages import BUSY_MACHINE, BusyMachine, RunState
from robofleet.recording.causes import driven_out, named, run_cause
from robofleet.safety import busy
from robofleet.safety.advice import advised
from robofleet.safety.arming import Stage
from robofleet.safety.busy import DRIVERS, Lateness
from robofleet.safety.supervisor import Phase

GOES_ON = "Every robot stands. Everything is simulated: the run goes on by itself."
ROBOT_WORDS = {  # what a robot does, in the terminal and on the page; the first that is so
    "drill": "its emergency stop is tried",
    "starting": "starting",  # it has not begun yet
    "latched": "latched: {}",
    "lost": "lost: no image of it",
    "halted": "halted: {}",
    "parked": "parked: this run does not drive it",
    "silent": "silent: nothing heard of it",
    "unsafe": "halted: no motion is safe",
    "kept_apart": "kept apart by the barrier",
    "drives": "drives",
    "stands": "stands",
}
_MOST_NAMED_ROBOTS = 3  # in a line
_PROCESSES = "supervisor", "controller", "tracker"
_STAGES = {
    Stage.CHECKS: "does every robot answer, is it seen, and is it at rest?",
    Stage.DRILL: "trying the emergency stop",
    Stage.WIGGLE: "trying the wheels",
    Stage.DONE: "every check is passed",
}


@dataclass(frozen=True, kw_only=True)
class StateWords:
    """What a run's state says."""

    phase: str
    cause: str  # what led to the phase, with the machine's load where that explains it
    advice: str  # the cause, and what to do about it
    check: str  # what is checked while the fleet is armed
    standing: str  # who stands while the run is held
    silent: tuple[str, ...]  # who has not acknowledged an emergency stop
    goes_on: bool  # the run is held, and goes on by itself


def state_words(state: RunState, message: BusyMachine | None, robots: tuple[str, ...]) -> StateWords:
    """Return a run's state in words; ``message``: what is known of the machine's load; ``robots``: in their order."""
    cause = run_cause(state, robots)
    explained = message is not None and state.cause != 0 and message.cause == state.cause
    if explained and message is not None:
        late = busy.latest(Lateness(process.process, process.late_ns) for process in message.late if process.late_ns)
        cause += f" (this machine was busy: {busy.words(late, message.load, message.cores, robots)})"
    rows = [*zip(robots, state.robots, strict=False)]
    out = [robot for row, robot in enumerate(robots) if driven_out(state, row)]
    return StateWords(
        phase=named(Phase, state.phase),
        cause=cause,
        advice=advised(cause, state.cause, busy=explained),
        check=_check(state.stage, [robot for robot, own in rows if own.stroke]),
        standing=f"{out[0]} is driven out at a crawl, all others stand." if out else "Every robot stands.",
        silent=tuple(robot for robot, own in rows if not own.acknowledged) if state.phase == Phase.ESTOP else (),
        goes_on=message is not None and state.phase == Phase.HOLD and bool(message.goes_on),
    )


def _check(stage: int, tried: list[str]) -> str:
    check = next((words for known, words in _STAGES.items() if known == stage), "another check")
    if not tried:
        return check
    more = f" and {len(tried) - _MOST_NAMED_ROBOTS} more" if len(tried) > _MOST_NAMED_ROBOTS else ""
    return f"{check} of {', '.join(tried[:_MOST_NAMED_ROBOTS])}{more}"


def busy_notice(message: BusyMachine, robots: tuple[str, ...]) -> str:
    """Return what is said once in a run; ``robots`` are the ids in the group's order."""
    return f"this machine is busy: {_busy_so_far(message, robots)}"


def busy_figures(payloads: Iterable[bytes], robots: tuple[str, ...]) -> dict[str, Any] | None:
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
        "late_s": {_process_name(process.process, robots): round(process.most_ns / 1e9, 3) for process in newest.late},
        "words": _busy_verdict(newest, load, robots),
    }


def _busy_verdict(message: BusyMachine, load: float, robots: tuple[str, ...]) -> str:
    sentence = f"This machine was busy: {_busy_so_far(message._replace(load=load), robots)}."
    if message.attempts:
        sentence += f" The checks before the start began anew {_times(message.attempts)}."
    if message.resumed:
        sentence += f" The run was held and went on by itself {_times(message.resumed)}."
    return sentence


def _busy_so_far(message: BusyMachine, robots: tuple[str, ...]) -> str:
    late = [Lateness(process.process, process.most_ns) for process in message.late]
    return busy.words(busy.latest(late), message.load, message.cores, robots)


def _process_name(process: int, robots: tuple[str, ...]) -> str:
    if process < DRIVERS:
        return _PROCESSES[process]
    row = process - DRIVERS
    return f"driver-{robots[row]}" if row < len(robots) else f"process-{process}"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
