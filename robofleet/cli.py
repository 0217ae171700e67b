"""The operator's commands. Exit 0: completed; 1: ended by a fault or by the operator; 2: bad input."""

import json
import shlex
import sys
from contextlib import ExitStack, contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robofleet.clock import utc_now
from robofleet.experiments import trials
from robofleet.files import write_text
from robofleet.processes import commands, run_commands
from robofleet.processes.log_lines import never_raise
from robofleet.processes.outlet import unhindered
from robofleet.processes.refusal import (
    LAB_MODULES,
    WEB_PACKAGES,
    RefusedError,
    bad_input,
    how_to_install,
    need_extra,
    new_folder,
)
from robofleet.valid_json import dumps

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robofleet.config.tree import Config

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Drive a platoon of differential-drive robots under an overhead camera.",
    epilog="First: robofleet check configs/platoon.yaml, then: robofleet run configs/platoon.yaml. "
    "Each command's --help has examples. Exit 0: completed; 1: ended by a fault or by you; 2: bad input.",
)

for _afterwards in run_commands.app.registered_commands:
    _afterwards.rich_help_panel = "A run afterwards, from the file that it left"
app.add_typer(trials.app)
app.add_typer(run_commands.app)
app.add_typer(commands.app)

ConfigFile = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The configuration; configs/README.md lists every key.")
]
Overrides = Annotated[
    list[str],
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key, e.g. controller.alpha=30. Repeatable."),
]


@app.command()
@unhindered()
def run(
    config: ConfigFile,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="One process on a simulated clock: fast and repeatable.")
    ] = False,
    duration: Annotated[float | None, typer.Option(metavar="S", help="Seconds; default: run.duration_s.")] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="Default: run.seed.")] = None,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    faults: Annotated[Path | None, typer.Option(metavar="FILE", help="Timed faults of simulated robots.")] = None,
    reset: Annotated[bool, typer.Option("--reset", help="Clear the latches that an earlier run left.")] = False,
    takeover: Annotated[bool, typer.Option("--takeover", help="Take robots that another controller has.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: runs/<UTC time>-<config name>.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Open the operator's page; its address is printed.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No live view.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Drive the platoon: start, arm, run, stop; then a table, and DIR/summary.json.

    $ robofleet run configs/platoon.yaml

    $ robofleet run configs/platoon.yaml --lockstep --set groups.0.track=centre

    Ctrl-C ends it, twice is the emergency stop; from another terminal: robofleet stop, hold, resume, status.
    """
    changes = [*overrides]
    if duration is not None:
        changes.append(f"run.duration_s={duration}")
    if seed is not None:
        changes.append(f"run.seed={seed}")
    folder = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{config.stem}"
    with ExitStack() as held:
        with bad_input():
            if web:
                _refuse_no_page(lockstep=lockstep)
            tree = _checked(config, changes, faults, lockstep=lockstep)
            if not lockstep:
                _refuse_unattended(tree)
                tree = _settled(tree)
                held.enter_context(_claimed(tree, folder))
            new_folder(folder)
        how = {} if lockstep else {"reset": reset, "take_over": takeover, "web": web}
        with bad_input():
            summary = _summary(tree, config.stem, folder, lockstep=lockstep, quiet=quiet, **how)
    try:
        write_text(folder / "summary.json", dumps(summary, indent=1) + "\n")
    except OSError as error:
        print(f"{folder / 'summary.json'}: {error.strerror}: here is the summary all the same", file=sys.stderr)
        as_json = True
    if as_json:
        print(dumps(summary))
    else:
        from rich.console import Console  # noqa: PLC0415

        from robofleet.recording.tables import summary_table  # noqa: PLC0415

        Console().print(summary_table(summary))
        print(f"{folder / 'summary.json'}")
    _report(folder, summary, quiet=as_json)
    if summary["outcome"] != "completed":
        print(f"{summary['outcome']}: {summary['cause']}", file=sys.stderr)
        raise typer.Exit(1)


@app.command()
def check(config: ConfigFile, overrides: Overrides = []) -> None:  # noqa: B006 - typer copies it
    """Refuse what cannot work, before a wheel turns; exit 0 and a table of what was proved.

    $ robofleet check configs/platoon.yaml --set groups.0.path_rate=0.06
    """
    with bad_input():
        tree = _checked(config, overrides, None, lockstep=False)
    from rich.box import SIMPLE_HEAD  # noqa: PLC0415
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    from robofleet.config.yamlfile import printable  # noqa: PLC0415
    from robofleet.processes.check import proofs  # noqa: PLC0415

    proved = Text(printable(f"{config} can run. What was proved:"), "italic")  # a name is no markup
    table = Table(title=proved, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for column in ("value", "limit", "used"):
        table.add_column(column, justify="right", no_wrap=True)
    for row in proofs(tree):
        table.add_row(*map(Text, row))
    Console().print(table)
    print("Next:", shlex.join(["robofleet", "run", str(config), *(f"--set={change}" for change in overrides)]))


@app.command()
def schema(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Default: standard output.")] = None,
) -> None:
    """The configuration's JSON schema: with it an editor completes keys and marks mistakes.

    $ robofleet schema --out schema.json

    The first line of a configuration beside it is then:

    # yaml-language-server: $schema=schema.json
    """
    from robofleet.config import schema as schemas  # noqa: PLC0415

    text = json.dumps(schemas.schema(), indent=1)
    if out is None:
        print(text)
        return
    with bad_input():
        try:
            out.write_text(text + "\n")
        except OSError as error:
            raise RefusedError(f"--out: {out} cannot be written: {error.strerror}: name another file") from error
    print(out)


def main() -> None:
    """Run a command; one whose packages are not installed says which extra has them."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a folder's name may be no text
    never_raise()
    try:
        app()
    except ModuleNotFoundError as error:
        if (package := (error.name or "").partition(".")[0]) not in LAB_MODULES:
            raise
        print(f"this needs {package}: {how_to_install('lab')}", file=sys.stderr)
        raise SystemExit(2) from error


def _report(folder: Path, summary: dict[str, Any], *, quiet: bool) -> None:
    """Write the run's report; where that fails, the run and its summary are there all the same."""
    from robofleet.recording import after  # noqa: PLC0415
    from robofleet.recording.bounds import failures  # noqa: PLC0415
    from robofleet.recording.reading import RecordingError  # noqa: PLC0415

    try:
        page, _ = after.report(folder)
    except (OSError, RecordingError) as error:
        print(f"there is no report: {error}", file=sys.stderr)
    else:
        if not quiet:
            print(page)
    for line in failures(summary):
        print(f"bound not met: {line}", file=sys.stderr)


def _checked(config: Path, overrides: list[str], faults: Path | None, *, lockstep: bool) -> "Config":
    from robofleet.processes.check import load_checked  # noqa: PLC0415

    return load_checked(config, overrides, faults, lockstep=lockstep)


def _refuse_no_page(*, lockstep: bool) -> None:
    if lockstep:
        raise RefusedError("--web: a lockstep run is over before anybody has looked: leave --web or --lockstep out")
    need_extra("web", *WEB_PACKAGES)


def _refuse_unattended(tree: "Config") -> None:
    if tree.run.attended and not sys.stdin.isatty():
        raise RefusedError("run.attended: stdin is no terminal: start the run in one, or set it to false")


@contextmanager
def _claimed(tree: "Config", folder: Path) -> "Iterator[None]":
    """Let the run be reached by others, and refuse a second one on the same arena."""
    from robofleet.comms.endpoint import check_free  # noqa: PLC0415
    from robofleet.comms.private_folder import PlaceError  # noqa: PLC0415
    from robofleet.processes.arena_file import ArenaBusyError, claimed  # noqa: PLC0415

    with ExitStack() as held:
        try:
            held.enter_context(claimed(tree, folder))
            check_free(tree)
        except (ArenaBusyError, PlaceError) as error:
            raise RefusedError(str(error)) from error
        yield


def _settled(tree: "Config") -> "Config":
    """Choose where the processes meet; what is in use is refused."""
    from robofleet.comms.endpoint import settled  # noqa: PLC0415
    from robofleet.comms.private_folder import PlaceError  # noqa: PLC0415

    try:
        return settled(tree, listen=True)
    except PlaceError as error:
        raise RefusedError(str(error)) from error


def _summary(tree: "Config", name: str, folder: Path, *, lockstep: bool, quiet: bool, **how: bool) -> dict[str, Any]:
    from robofleet.processes import run as runs  # noqa: PLC0415

    try:
        if lockstep:
            return runs.in_lockstep(tree, name, folder, quiet=quiet)
        return runs.in_real_time(tree, name, folder, quiet=quiet, **how)
    except OSError as error:
        print(f"{folder}: {error.strerror}: make room, or name another folder with --out", file=sys.stderr)
        raise typer.Exit(1) from error
