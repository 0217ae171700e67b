"""What the supervisor says, drawn for the live view: the checks while arming, a hold, an emergency stop."""

from rich.box import HEAVY
from rich.panel import Panel
from rich.text import Text

from robofleet.bus.messages import RunState
from robofleet.operator.terminal.on_the_way import WAYS
from robofleet.operator.terminal.terminal import Terminal
from robofleet.recording.causes import named
from robofleet.recording.state_words import GOES_ON, StateWords
from robofleet.runs.console import ENDING
from robofleet.safety.supervisor import Event, Phase

_KEYS = (("e", "emergency stop"), ("h", "hold"), ("r", "resume"), ("q", "end the run"))
_FIRST_KEYS = (("e", "emergency stop"), ("a", "arm"), ("s", "start"), ("q", "end the run"))
WAITING = {
    "waiting": "everything is there: start it with key s, on the operator's page or by `robofleet start`",
    "armed": "every check is passed: start it with key s, on the operator's page or by `robofleet start`",
}
ENDS = {
    "stopping": "the robots come to rest",
    ENDING: "the processes end, and the recording is completed",
    "summary": "the summary is made",
}
ENDED = ("completed", "stopped", "fault")  # phases: of the last picture
UNDER_WAY = {named(Phase, phase): f"every robot drives {way.each}" for phase, way in WAYS.items()}


def banner(state: RunState, words: StateWords, *, by_key: bool, way: Phase | None = None) -> Panel | None:
    """Return what must be seen: why the fleet stands, and what to do.

    ``way``: to the start or to the park, where that is held.
    """
    cause = words.advice
    if words.goes_on:
        return _panel("HOLD", cause, GOES_ON, "yellow")
    if state.phase == Phase.HOLD:
        goes_on = "the run goes on" if way is None else f"the robots drive on {WAYS[way].all}"
        how = f"press r and {goes_on}; q ends the run" if by_key else "`robofleet resume` goes on; Ctrl-C ends the run"
        requested = state.cause == Event.HOLD_REQUESTED  # then there is nothing to mend
        what = f"{how[0].upper()}{how[1:]}" if requested else f"Look, mend it, then {how}"
        return _panel("HOLD", cause, f"{words.standing} {what}.", "yellow")
    if state.phase == Phase.ESTOP:
        silent = ", ".join(words.silent)
        what = f"NOT acknowledged by {silent}" if silent else "Every robot has latched its gate."
        return _panel("EMERGENCY STOP", cause, what, "red")
    if state.phase == Phase.FAULT:
        return _panel("FAULT", cause, "Every robot stands.", "red")
    return None


def keys(terminal: Terminal, phase: str) -> Text:
    text = Text()
    for line in [*terminal.addresses.values()]:  # a thread may add one
        text.append(f"\n{line}\n", "cyan")
    if terminal.present:
        text.append("\n")
        for key, does in _keys(phase):
            text.append(f" {key} ", "bold red reverse" if key == "e" else "reverse").append(f" {does}   ")
    if terminal.note:
        text.append(f"\n\n{terminal.note}", "red" if terminal.note.startswith("refused") else "green")
    return text


def _keys(phase: str) -> tuple[tuple[str, str], ...]:
    if phase in (*ENDED, *ENDS, "emergency stop"):  # from the rest on nothing is left that a key could do
        return _KEYS[:1] if phase == "stopping" else ()
    return _FIRST_KEYS if phase in WAITING else _KEYS


def _panel(title: str, cause: str, what: str, colour: str) -> Panel:
    text = Text(cause, f"bold {colour}").append(f"\n{what}", "default not bold")
    return Panel(
        text, title=f"[bold]{title}[/]", title_align="left", border_style=colour, box=HEAVY, padding=(1, 2), width=78
    )
