"""The run's state in words for the page: where it is, what it checks, and what the operator can do now."""

from collections.abc import Sequence

from robofleet.bus.messages import BusyMachine, RunState
from robofleet.bus.observer import RobotObserved
from robofleet.config.tree import Config
from robofleet.operator.terminal.live_state import arming, who_stands
from robofleet.recording.busy_machine import goes_on
from robofleet.recording.causes import named
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
_GOES_ON = "Every robot stands. Everything is simulated: the run goes on by itself."
_UNDER_WAY = {
    Phase.POSITIONING: ("The robots drive to their start by themselves", "Then the run begins."),
    Phase.PARKING: ("The robots drive to where they are parked by themselves", "Then the run ends."),
}
_HELD = {
    Phase.POSITIONING: "Every robot stands on its way to its start. Look, mend what is wrong, then resume; or stop.",
    Phase.PARKING: "Every robot stands on its way to the park. Look, mend what is wrong, then resume; or stop.",
}
ENDED = (Phase.IDLE, Phase.FAULT, Phase.ESTOP)  # nothing moves, and nothing will by itself


def phase_name(state: RunState | None) -> str:
    """Return a run's phase; ``starting`` while the supervisor has not spoken."""
    return "starting" if state is None else phase_word(state.phase)


def phase_word(phase: int) -> str:
    """Return a phase as the page knows it."""
    return named(Phase, phase)


def stage(state: RunState | None, robots: tuple[str, ...]) -> str | None:
    """Return what is checked now, while the fleet is being armed."""
    return arming(state, robots) if state is not None and state.phase == Phase.ARMED else None


def what_next(
    state: RunState | None, busy: BusyMachine | None, observed: Sequence[RobotObserved], config: Config,
    way: Phase | None, how_far: str,
) -> str:  # fmt: skip
    """Return what the operator can do now; ``way``: that the robots are on, ``how_far`` they are."""
    if state is None:
        return "Wait: the processes are starting."
    robots = config.ids
    if state.phase == Phase.ESTOP:
        silent = [robot for robot, row_state in zip(robots, state.robots, strict=False) if not row_state.acknowledged]
        if silent:
            return f"NOT acknowledged by {', '.join(silent)}: stop them by hand."
    latched = [
        robot for robot, (status, _) in zip(robots, observed, strict=True) if status is not None and status.latch
    ]
    if config.run.start == "auto" and state.phase in ENDED:
        by_itself = "This run starts and ends by itself."
        return by_itself if state.phase == Phase.IDLE else "Every robot stands and this run ends: look at the robots."
    if state.phase == Phase.IDLE and latched:
        return f"The gate of {', '.join(latched)} is latched: look at the robots, then reset."
    words = next((words for phase, words in _NEXT.items() if phase == state.phase), "")
    if way is not None and state.phase == way:
        goes, then = _UNDER_WAY[way]
        words = f"{how_far[:1].upper()}{how_far[1:] or goes}. {then}"
    elif way is not None and state.phase == Phase.HOLD:
        words = _HELD[way]
    elif state.phase == Phase.HOLD:
        words = f"{who_stands(state, robots)} {words}"
    if state.phase == Phase.ARMED and state.stage == Stage.DONE:
        words = "Every check is passed: start the run, or stop."
    return _GOES_ON if goes_on(state, busy) else words
