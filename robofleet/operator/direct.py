"""The commands for which an operator is in a hurry: they need no Typer, which takes longer to load than they take.

A command line that has nothing but the command and an arena's name is done by ``run``. Typer reads all others (options,
help, mistakes, a shell's completions), and then calls the same functions. Each of them returns an exit code; bad
input raises BadInputError.
"""

import gc
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from robofleet.core.errors import BadInputError
from robofleet.core.log_lines import never_raise
from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.sentences import wrapped
from robofleet.core.valid_json import dumps
from robofleet.operator.terminal.plain_terminal import speak_its_language

REQUESTS = "arm", "start", "hold", "resume", "park"  # which the supervisor serves
_THEN = {"park": "every robot drives to its place to park; the run ends there"}
_MOST_WORDS = 2  # a command, and an arena
_COLLECT_AFTER_OBJECTS = 50_000  # loading libraries makes many, and hardly any garbage


def run(words: Sequence[str]) -> int | None:
    """Do what a plain command line says, and return the exit code; None where Typer must read it."""
    if not 1 <= len(words) <= _MOST_WORDS or words[0] not in _COMMANDS or words[-1].startswith("-"):
        return None
    gc.set_threshold(_COLLECT_AFTER_OBJECTS)
    speak_its_language()
    never_raise()
    try:
        return _COMMANDS[words[0]](words[1] if len(words) == _MOST_WORDS else None)
    except KeyboardInterrupt:
        print(file=sys.stderr)
        return 1
    except BadInputError as error:
        print(wrapped(str(error), sys.stderr), file=sys.stderr)
        return 2


def stop(arena: str | None) -> int:
    """Ask for the emergency stop of an arena, or of every run of this user."""
    from robofleet.operator import requests  # noqa: PLC0415

    return max(answered(done, what) for done, what in requests.stop_all(arena))


def request(what: str, arena: str | None) -> int:
    from robofleet.operator import requests  # noqa: PLC0415

    done, answer = requests.ask(requests.joined_arena(arena) or requests.chosen(arena), what)
    then = _THEN.get(what)
    return answered(done, f"{answer}: {then}" if done and then else answer)


def reset(named: str | None, changes: Sequence[str] = (), *, confirmed: bool = False) -> int:
    """Clear the latches of an arena: by its run where one is on, else those that its drivers have left here.

    ``named``: the arena, or a configuration of it, which ``changes`` change.
    """
    from robofleet.operator import requests  # noqa: PLC0415

    arena, config = named, None
    if named is not None and named.endswith(CONFIGURATIONS):
        from robofleet.config.load import load_config  # noqa: PLC0415

        config = load_config(Path(named), changes)
        arena = config.arena.name
    try:
        return request("reset", arena)
    except requests.NoRunError:
        from robofleet.operator.latches import reset_stored  # noqa: PLC0415

        return answered(*reset_stored(arena, config, confirmed=confirmed))


def status(arena: str | None, *, as_json: bool = False) -> int:
    from robofleet.operator import requests  # noqa: PLC0415

    try:
        found = requests.status(requests.chosen(arena))
    except requests.UnreachableError as error:
        return answered(False, str(error))
    if as_json:
        print(dumps(found))
    else:
        from rich.console import Console  # noqa: PLC0415

        from robofleet.reports.tables import status_table  # noqa: PLC0415

        Console().print(status_table(found))
        print(wrapped(found["next"] or "", sys.stdout))
    return 0


def answered(done: bool, what: str) -> int:
    """Print what came of a command, and return its exit code."""
    stream = sys.stdout if done else sys.stderr
    print(wrapped(what, stream), file=stream)
    return 0 if done else 1


_COMMANDS: dict[str, Callable[[str | None], int]] = {"stop": stop, "status": status, "reset": reset}
_COMMANDS |= {what: partial(request, what) for what in REQUESTS}
