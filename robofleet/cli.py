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
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import version as installed_version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.main import get_command

from robofleet.core.log_lines import never_raise
from robofleet.core.refusal import LAB_MODULES, RefusedError, bad_input, how_to_install
from robofleet.operator import usage
from robofleet.operator.terminal.plain_terminal import silence_libraries, speak_its_language

_COLLECT_AFTER_OBJECTS = 50_000  # loading libraries makes hundreds of thousands, and hardly any garbage
_NODE = "node"
_PROCESSES = "router", "supervisor", "tracker", "controller", "driver", "recorder", "twins"
_BEGIN = "Begin"
_DRIVE = "Drive"
_RUNNING = "During a run"
_AFTERWARDS = "After a run"
_LABORATORY = "Laboratory"
_PROGRAMS = "Programs"
_COMPUTERS = "Computers"


class Row(NamedTuple):
    """A command: its name, and where it is. A module without a function describes a group of commands."""

    name: str  # "node router": in the group "node"
    module: str
    function: str = ""
    heading: str | None = None  # under which it is listed; None: among more, by its name alone
    parser: str = ""  # a class of the module that reads its arguments


COMMANDS = (
    Row("init", "operator.config_commands", "init", _BEGIN),
    Row("check", "operator.run_command", "check", _BEGIN),
    Row("doctor", "doctor.command", "doctor", _BEGIN),
    Row("docs", "operator.docs_command", "docs", _BEGIN),
    Row("run", "operator.run_command", "run", _DRIVE, "RunCommand"),
    Row("go", "operator.run_command", "go", _DRIVE),
    Row("teleop", "gateways.gamepad.command", "teleop", _DRIVE),
    Row("robotarium", "gateways.robotarium.command", "robotarium", _DRIVE),
    Row("paper", "experiments.trials", "paper", _DRIVE),
    Row("sweep", "studies.commands", "sweep", _DRIVE),
    Row("storm", "studies.commands", "storm", _DRIVE),
    *(Row(name, "operator.commands", name, _RUNNING) for name in ("stop", "reset", "hold", "resume", "park")),
    *(Row(name, "operator.commands", name, _RUNNING) for name in ("status", "web")),
    *(Row(name, "reports.commands", name, _AFTERWARDS) for name in ("report", "replay", "repair")),
    *(Row(name, "gateways.exports.command", name, _AFTERWARDS) for name in ("export", "film")),
    Row("sheet", "calibration.commands.sheet", heading=_LABORATORY),
    *(Row(f"sheet {name}", "calibration.commands.sheet", name) for name in ("tags", "floor", "board")),
    Row("calibrate", "calibration.commands", heading=_LABORATORY),
    Row("calibrate intrinsics", "calibration.commands.intrinsics", "intrinsics"),
    *(Row(f"calibrate {name}", "calibration.commands.place", name) for name in ("arena", "verify")),
    Row("calibrate drive", "calibration.commands.drive", "drive"),
    Row("calibrate projector", "calibration.commands.projector", "projector"),
    *(Row(f"calibrate {name}", "calibration.commands.robots", name) for name in ("offsets", "latency")),
    Row("track", "gateways.videos.command", "track", _LABORATORY),
    Row("ros2", "gateways.ros2.command", "ros2", _PROGRAMS),
    Row("foxglove", "gateways.viewers.command", "foxglove", _PROGRAMS),
    Row("rerun", "gateways.viewers.command", "rerun", _PROGRAMS),
    Row("keys", "hosts.keys_commands", heading=_COMPUTERS),
    *(Row(f"keys {name}", "hosts.keys_commands", name) for name in ("init", "add")),
    Row("keys list", "hosts.keys_commands", "listed"),
    *(Row(f"keys {name}", "hosts.keys_commands", name) for name in ("renew", "revoke", "bundle")),
    Row("join", "hosts.join_command", "join", _COMPUTERS),
    *(Row(name, "operator.commands", name) for name in ("arm", "start", "project", "hosts")),
    *(Row(name, f"calibration.commands.{name}", name) for name in ("identify", "gap")),
    Row("layout", "reports.commands", "layout"),
    Row("schema", "operator.config_commands", "schema"),
    Row(_NODE, "operator.node_commands"),
    *(Row(f"{_NODE} {name}", "operator.node_commands", name) for name in _PROCESSES),
)


def _rows(group: str = "") -> dict[str, Row]:
    """Return the commands of a group by their names in it."""
    split = {row: row.name.rpartition(" ") for row in COMMANDS}
    return {name: row for row, (parent, _, name) in split.items() if parent == group}


def _unloaded(group: str = "") -> dict[str, Any]:
    return {name: _Unloaded(name, row) if row.function else _Group(name, row) for name, row in _rows(group).items()}


@cache
def _docstrings(module: str) -> dict[str, str]:
    """Return the docstrings of a module and of its functions, from its source: it is not imported."""
    spec = find_spec(f"robofleet.{module}")
    assert spec is not None
    assert spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_bytes())
    functions = (node for node in tree.body if isinstance(node, ast.FunctionDef))
    return {"": ast.get_docstring(tree) or ""} | {node.name: ast.get_docstring(node) or "" for node in functions}


class _FromSource:
    """The help of a command whose module is not imported."""

    _row: Row

    @property
    def help(self) -> str:
        """What its source says of it."""
        return _docstrings(self._row.module)[self._row.function]

    @help.setter  # noqa: A003 - click calls it so
    def help(self, text: str | None) -> None:
        """Take nothing: it stands in the source."""


class _Unloaded(_FromSource, usage.Command):  # type: ignore[misc]  # a property in the place of a value
    """A command of the table, whose module is not imported yet: it has what the list of commands shows."""

    def __init__(self, name: str, row: Row) -> None:
        super().__init__(name, rich_help_panel=row.heading)
        self._row = row

    @cached_property
    def loaded(self) -> Any:
        """The command itself."""
        module = import_module(f"robofleet.{self._row.module}")
        function: Callable[..., None] = getattr(module, self._row.function)
        app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
        app.command(self.name, cls=getattr(module, self._row.parser, usage.Command))(function)
        return get_command(app)


class _Lazy(usage.Commands):
    """Commands of the table: the one that is called is imported."""

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


class _Group(_FromSource, _Lazy):  # type: ignore[misc]  # as above
    """A group of commands of the table."""

    def __init__(self, name: str, row: Row) -> None:
        super().__init__(name=name, commands=_unloaded(name), rich_help_panel=row.heading, no_args_is_help=True)
        self._row = row


class _Commands(_Lazy):
    """All commands."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": _unloaded()})

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is called; a process of a run, also by the name that it had at the top once."""
        if args[0] in _PROCESSES:
            if not ctx.resilient_parsing:
                print(f"`robofleet {args[0]}` is now `robofleet {_NODE} {args[0]}`", file=sys.stderr)
            args = [_NODE, *args]
        return super().resolve_command(ctx, args)

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
    help="Drive a fleet of wheeled robots under overhead cameras, real or simulated.",
    epilog="First: `robofleet init lab`, then `robofleet run lab/platoon.yaml --web`. `robofleet COMMAND --help` has "
    "options and examples. Also: --version, --install-completion. Terms: configs/TERMS.md.",
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
