"""The run's state in words for the page: where it is, what it checks, and what the operator can do now."""

from collections.abc import Sequence

from robofleet.bus.messages import RunState
from robofleet.bus.observer import RobotObserved
from robofleet.config.tree import Config
from robofleet.operator.terminal.on_the_way import WAYS
from robofleet.recording.causes import named
from robofleet.recording.state_words import GOES_ON, StateWords
from robofleet.runs.companion import ENDS
from robofleet.safety.arming import Stage
from robofleet.safety.supervisor import Phase

_NEXT = {
    Phase.IDLE: "Arm: every robot's wheels and its emergency stop are tried, one after the other.",
    Phase.ARMED: "Wait for the checks, or stop.",
    Phase.RUNNING: "Hold the run, or stop it.",
    Phase.HOLD: "Look, mend what is wrong, then resume; or stop.",
    Phase.FAULT: "Every robot stands. Mend the cause, then reset.",
    Phase.ESTOP: "Every robot has latched its gate. Look at the robots, then reset.",
}
ENDED = (Phase.IDLE, Phase.FAULT, Phase.ESTOP)  # nothing moves, and nothing will by itself


ENDING = "The robots come to rest, and the recording is completed."


def end_words(line: str) -> str:
    """Return how a run ends, by the launcher's newest line; empty while it does not say so."""
    return line.removeprefix(ENDS) if line.startswith(ENDS) else ""


def phase_name(state: RunState | None) -> str:
    """Return a run's phase; ``starting`` while the supervisor has not spoken."""
    return "starting" if state is None else named(Phase, state.phase)


def what_next(
    state: RunState | None, words: StateWords | None, observed: Sequence[RobotObserved], config: Config,
    way: Phase | None, how_far: str,
) -> str:  # fmt: skip
    """Return what the operator can do now; ``way``: that the robots are on, ``how_far`` they are."""
    if state is None or words is None:
        return "Wait: the processes are starting."
    if words.silent:
        return f"NOT acknowledged by {', '.join(words.silent)}: stop them by hand."
    latched = [robot for robot, (status, _) in zip(config.ids, observed, strict=True) if status and status.latch]
    if config.run.start == "auto" and state.phase in ENDED:
        by_itself = "This run starts and ends by itself."
        return by_itself if state.phase == Phase.IDLE else "Every robot stands and this run ends: look at the robots."
    if state.phase == Phase.IDLE and latched:
        return f"The gate of {', '.join(latched)} is latched: look at the robots, then reset."
    following = next((following for phase, following in _NEXT.items() if phase == state.phase), "")
    if way is not None and state.phase == way:
        how_far = how_far or f"the robots drive {WAYS[way].all} by themselves"
        following = f"{how_far[0].upper()}{how_far[1:]}. Then {WAYS[way].then}."
    elif state.phase == Phase.HOLD:
        standing = words.standing if way is None else f"Every robot stands on its way to {WAYS[way].goal}."
        following = f"{standing} {following}"
    elif state.phase == Phase.ARMED and state.stage == Stage.DONE:
        following = "Every check is passed: start the run, or stop."
    return GOES_ON if words.goes_on else following
