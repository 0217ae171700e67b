"""A run's state in words: one function for terminal, page, commands, launcher and gateways."""

from dataclasses import dataclass

from robofleet.bus.messages import BusyMachine, RunState
from robofleet.recording.causes import driven_out, named, run_cause
from robofleet.safety import busy
from robofleet.safety.advice import advised
from robofleet.safety.arming import Stage
from robofleet.safety.busy import Lateness
from robofleet.safety.supervisor import Phase

GOES_ON = "Every robot stands. Everything is simulated: the run goes on by itself."
_NAMED = 3  # robots in a line
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
    more = f" and {len(tried) - _NAMED} more" if len(tried) > _NAMED else ""
    return f"{check} of {', '.join(tried[:_NAMED])}{more}"
