"""The command line: one table of commands.

Exit 0: completed; 1: ended by a fault or the operator, or results lost; 2: bad input.

A command's module is imported when the command is called. The list of commands needs their first lines alone, which
are read from their source.
"""

import ast
import faulthandler
import gc
import sys
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from importlib.metadata import version as installed_version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from robofleet.core.log_lines import never_raise
from robofleet.core.refusal import LAB_MODULES, RefusedError, bad_input, how_to_install
from robofleet.operator import usage
from robofleet.operator.terminal.plain_terminal import silence_libraries, speak_its_language

_COLLECT_AFTER_OBJECTS = 50_000  # loading libraries makes hundreds of thousands, and hardly any garbage
_RUNNING = "A running arena, from any terminal"
_AFTERWARDS = "A run afterwards, from the file that it left"
_PROCESSES = "One process of a run, by itself"
_LABORATORY = "A laboratory, once"
_HOSTS = "Robots with computers of their own"


class Row(NamedTuple):
    """A command: its name, and where it is. A module without a function holds the app of a group of commands."""

    name: str
    module: str
    function: str = ""
    panel: str | None = None
    parser: str = ""  # a class of the module that reads its arguments


COMMANDS = (
    Row("run", "operator.run_command", "run", parser="RunCommand"),
    Row("go", "operator.run_command", "go"),
    Row("check", "operator.run_command", "check"),
    Row("init", "operator.config_commands", "init"),
    Row("schema", "operator.config_commands", "schema"),
    Row("docs", "operator.docs_command", "docs"),
    Row("doctor", "doctor.command", "doctor"),
    Row("paper", "experiments.trials", "paper"),
    Row("storm", "studies.commands", "storm"),
    Row("sweep", "studies.commands", "sweep"),
    Row("robotarium", "gateways.robotarium.command", "robotarium"),
    *(Row(name, "operator.commands", name, _RUNNING) for name in ("stop", "arm", "start", "hold", "resume", "park")),
    *(Row(name, "operator.commands", name, _RUNNING) for name in ("reset", "status", "hosts", "web")),
    Row("ros2", "gateways.ros2.command", "ros2", _RUNNING),
    Row("foxglove", "gateways.viewers.command", "foxglove", _RUNNING),
    Row("rerun", "gateways.viewers.command", "rerun", _RUNNING),
    Row("teleop", "gateways.gamepad.command", "teleop", _RUNNING),
    *(Row(name, "reports.commands", name, _AFTERWARDS) for name in ("replay", "repair", "report", "layout")),
    *(Row(name, "operator.commands", name, _PROCESSES) for name in ("supervisor", "recorder", "twins", "controller")),
    *(Row(name, "operator.commands", name, _PROCESSES) for name in ("tracker", "driver", "router")),
    Row("keys", "hosts.keys_commands", panel=_HOSTS),
    Row("join", "hosts.join_command", "join", _HOSTS),
    Row("calibrate", "calibration.commands.measure", panel=_LABORATORY),
    Row("sheet", "calibration.commands.sheet", panel=_LABORATORY),
)


class _Unloaded(TyperCommand):
    """A command of the table, whose module is not imported yet: it has what the list of commands shows."""

    def __init__(self, row: Row) -> None:
        super().__init__(row.name, rich_help_panel=row.panel)
        self._row = row

    @property
    def help(self) -> str:
        """The docstring of its function, or of its module, as the source has it."""
        spec = find_spec(f"robofleet.{self._row.module}")
        assert spec is not None
        assert spec.origin is not None
        tree: Any = ast.parse(Path(spec.origin).read_bytes())
        if self._row.function:
            tree = next(node for node in tree.body if getattr(node, "name", "") == self._row.function)
        return ast.get_docstring(tree) or ""

    @help.setter  # noqa: A003 - click calls it so
    def help(self, text: str | None) -> None:
        """Take nothing: it stands in the source."""

    @cached_property
    def loaded(self) -> Any:
        """The command itself."""
        module = import_module(f"robofleet.{self._row.module}")
        if not self._row.function:
            group = get_group(module.app)
            group.name = self.name
            return group
        function: Callable[..., None] = getattr(module, self._row.function)
        app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
        app.command(self.name, cls=getattr(module, self._row.parser, TyperCommand))(function)
        return get_command(app)


class _Commands(TyperGroup):
    """The commands of the table."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": {row.name: _Unloaded(row) for row in COMMANDS}})

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is called, and import it; its help and completion do without packages of ``lab``."""
        name, command, rest = super().resolve_command(ctx, args)
        if not isinstance(command, _Unloaded):
            return name, command, rest
        try:
            return name, command.loaded, rest
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in LAB_MODULES or not (
                ctx.resilient_parsing or "--help" in rest
            ):
                raise
            command.epilog = f"Its options are listed where they can be used: {how_to_install('lab')}"
            return name, command, ["--help"]

    def invoke(self, ctx: Any) -> Any:
        """Run it; bad input, and a package that is not installed, end with exit code 2 and one line a fault."""
        with bad_input():
            try:
                return super().invoke(ctx)
            except ModuleNotFoundError as error:
                if (package := (error.name or "").partition(".")[0]) not in LAB_MODULES:
                    raise
                raise RefusedError(f"this needs {package}: {how_to_install('lab')}") from error


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Drive fleets of differential-drive robots under overhead cameras.",
    epilog="First: robofleet check configs/platoon.yaml, then: robofleet run configs/platoon.yaml. "
    "Each command's --help has examples. Exit 0: completed; 1: ended by a fault or by you, or results were lost; "
    "2: bad input.",
)


def _version(requested: bool) -> None:
    if requested:
        print(f"robofleet {installed_version('robofleet')}")
        raise typer.Exit


@app.callback()
def every_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version, and exit.")
    ] = False,
) -> None:
    """Take what stands before a command."""


def main(*before: str) -> None:
    """Run a command.

    ``before``: words that stand before those of the command line.
    """
    gc.set_threshold(_COLLECT_AFTER_OBJECTS)
    if sys.__stderr__ is not None:
        faulthandler.enable(sys.__stderr__)  # a driver's or a camera's library that crashes is named, with its line
    speak_its_language()
    silence_libraries()
    never_raise()
    try:
        raise SystemExit(app([*before, *sys.argv[1:]], prog_name="robofleet", standalone_mode=False))
    except usage.UsageError as error:
        usage.show(error)
        raise SystemExit(2) from error
    except typer.Abort as error:
        raise SystemExit(1) from error
