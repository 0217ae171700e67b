"""What the supervisor says, drawn for the live view: the checks while arming, a hold, an emergency stop."""

from rich.box import HEAVY
from rich.console import Group
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.text import Text

from robofleet.bus.messages import BusyMachine, RunState
from robofleet.core.compiling import Progress
from robofleet.operator.terminal.terminal import Terminal
from robofleet.recording import busy_machine
from robofleet.recording.causes import driven_out
from robofleet.safety.arming import Stage
from robofleet.safety.supervisor import Event, Phase

_NAMED = 3  # robots in a line
_STAGES = {
    Stage.CHECKS: "does every robot answer, is it seen, and is it at rest?",
    Stage.DRILL: "trying the emergency stop",
    Stage.WIGGLE: "trying the wheels",
    Stage.DONE: "every check is passed",
}
_KEYS = (("e", "emergency stop"), ("h", "hold"), ("r", "resume"), ("q", "end the run"))
_FIRST_KEYS = (("e", "emergency stop"), ("a", "arm"), ("s", "start"), ("q", "end the run"))
WAITING = {
    "waiting": "everything is there: start it with key s, on the operator's page or by `robofleet start`",
    "armed": "every check is passed: start it with key s, on the operator's page or by `robofleet start`",
}
UNDER_WAY = {
    "positioning": "every robot drives to its start",
    "parking": "every robot drives to where it is parked",
}
_GOES_ON = {
    Phase.POSITIONING: "the robots drive on to their start",
    Phase.PARKING: "the robots drive on to where they are parked",
}


def arming(state: RunState, robots: tuple[str, ...]) -> str:
    """Return what is checked now."""
    doing = next((words for stage, words in _STAGES.items() if stage == state.stage), "another check")
    tried = [robot for robot, row_state in zip(robots, state.robots, strict=False) if row_state.stroke]
    if not tried:
        return doing
    more = f" and {len(tried) - _NAMED} more" if len(tried) > _NAMED else ""
    return f"{doing} of {', '.join(tried[:_NAMED])}{more}"


def who_stands(state: RunState, robots: tuple[str, ...]) -> str:
    """Return who stands in a held run."""
    out = [robot for row, robot in enumerate(robots) if driven_out(state, row)]
    return f"{out[0]} is driven out at a crawl, all others stand." if out else "Every robot stands."


def banner(
    state: RunState, busy: BusyMachine | None, robots: tuple[str, ...], *, by_key: bool, way: Phase | None = None
) -> Panel | None:
    """Return what must be seen: why the fleet stands, and what to do.

    ``busy``: what is known of the machine's load; ``way``: to the start or to the park, where that is held.
    """
    cause = busy_machine.told(state, busy, robots)
    if busy_machine.goes_on(state, busy):
        return _panel(
            "HOLD", cause, "Every robot stands. Everything is simulated: the run goes on by itself.", "yellow"
        )
    if state.phase == Phase.HOLD:
        goes_on = "the run goes on" if way is None else _GOES_ON[way]
        how = f"press r and {goes_on}; q ends the run" if by_key else "`robofleet resume` goes on; Ctrl-C ends the run"
        requested = state.cause == Event.HOLD_REQUESTED  # then there is nothing to mend
        what = f"{how[0].upper()}{how[1:]}" if requested else f"Look, mend it, then {how}"
        return _panel("HOLD", cause, f"{who_stands(state, robots)} {what}.", "yellow")
    if state.phase == Phase.ESTOP:
        silent = [robot for robot, row_state in zip(robots, state.robots, strict=False) if not row_state.acknowledged]
        what = f"NOT acknowledged by {', '.join(silent)}" if silent else "Every robot has latched its gate."
        return _panel("EMERGENCY STOP", cause, what, "red")
    if state.phase == Phase.FAULT:
        return _panel("FAULT", cause, "Every robot stands.", "red")
    return None


def compiling_line(progress: Progress) -> Group:
    """Return what is compiled, how far it is, and for how long still."""
    return Group(Text(progress.words(), "cyan"), ProgressBar(1.0, progress.share, width=50))


def keys(terminal: Terminal, phase: str) -> Text:
    """Return the keys, and what was answered to the last one."""
    text = Text()
    for line in [*terminal.addresses.values()]:  # a thread may add one
        text.append(f"\n{line}\n", "cyan")
    if terminal.present:
        text.append("\n")
        for key, does in _FIRST_KEYS if phase in WAITING else _KEYS:
            text.append(f" {key} ", "bold red reverse" if key == "e" else "reverse").append(f" {does}   ")
    if terminal.note:
        text.append(f"\n\n{terminal.note}", "red" if terminal.note.startswith("refused") else "green")
    return text


def _panel(title: str, cause: str, what: str, colour: str) -> Panel:
    text = Text(cause, f"bold {colour}").append(f"\n{what}", "default not bold")
    return Panel(
        text, title=f"[bold]{title}[/]", title_align="left", border_style=colour, box=HEAVY, padding=(1, 2), width=78
    )
