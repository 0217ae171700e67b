"""The operator's commands. Exit 0: completed; 1: ended by a fault or the operator, or results lost; 2: bad input."""

import faulthandler
import gc
import json
import shlex
import sys
from contextlib import ExitStack, contextmanager
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from robofleet.calibration.commands import entry as laboratory
from robofleet.core.clock import utc_now
from robofleet.core.log_lines import never_raise
from robofleet.core.refusal import (
    LAB_MODULES,
    WEB_PACKAGES,
    RefusedError,
    bad_input,
    how_to_install,
    need_extra,
    new_file,
    new_folder,
    unkept,
)
from robofleet.doctor import command as doctoring
from robofleet.experiments import trials
from robofleet.gateways.gamepad import command as gamepad
from robofleet.gateways.robotarium import command as gateway
from robofleet.gateways.ros2 import command as ros2
from robofleet.gateways.viewers import address as viewers
from robofleet.gateways.viewers import command as viewers_command
from robofleet.hosts import join_command, keys_commands
from robofleet.operator import commands, going, run_commands, usage
from robofleet.operator.ending import Ending
from robofleet.operator.page.certificate import page_keys
from robofleet.operator.page.page_address import LOOPBACK, listening
from robofleet.operator.terminal.outlet import unhindered
from robofleet.operator.terminal.plain_terminal import as_shown, silence_libraries, speak_its_language
from robofleet.studies import commands as studies

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robofleet.config.tree import Config
    from robofleet.operator.run import Result
    from robofleet.runs.page_process import PageWanted

_COLLECT_AFTER = 50_000  # objects: loading libraries makes hundreds of thousands, and hardly any garbage

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Drive fleets of differential-drive robots under overhead cameras.",
    epilog="First: robofleet check configs/platoon.yaml, then: robofleet run configs/platoon.yaml. "
    "Each command's --help has examples. Exit 0: completed; 1: ended by a fault or by you, or results were lost; "
    "2: bad input.",
)

for _afterwards in run_commands.app.registered_commands:
    _afterwards.rich_help_panel = "A run afterwards, from the file that it left"
app.add_typer(doctoring.app)
app.add_typer(trials.app)
app.add_typer(studies.app)
app.add_typer(gateway.app)
app.add_typer(ros2.app)
app.add_typer(viewers_command.app)
app.add_typer(gamepad.app)
app.add_typer(run_commands.app)
app.add_typer(commands.app)
app.add_typer(keys_commands.app)
app.add_typer(join_command.app)
app.add_typer(laboratory.app)


def _version(asked: bool) -> None:
    if asked:
        print(f"robofleet {installed_version('robofleet')}")
        raise typer.Exit


ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="The configuration; configs/keys lists every key.")]
Overrides = Annotated[
    list[str],
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key, e.g. controller.alpha=30. Repeatable."),
]


class _RunCommand(TyperCommand):
    """``run``, whose options --foxglove and --rerun may stand without a value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Add the values that were left out."""
        return super().parse_args(ctx, viewers.completed(args))


@app.command(cls=_RunCommand)
@unhindered()
def run(
    config: ConfigFile,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="One process on a simulated clock: fast and repeatable.")
    ] = False,
    duration: Annotated[float | None, typer.Option(metavar="S", help="Seconds; default: run.duration_s.")] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="Default: run.seed.")] = None,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    faults: Annotated[Path | None, typer.Option(metavar="FILE", help="Timed faults: configs/faults.")] = None,
    reset: Annotated[bool, typer.Option("--reset", help="Clear the latches that an earlier run left.")] = False,
    takeover: Annotated[
        bool, typer.Option("--takeover", help="Take over robots that another controller holds.")
    ] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: runs/<UTC time>-<config name>.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Open the operator's page in your browser.")] = False,
    web_host: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Open it at this address of the machine, for a phone too: by TLS, with a QR code."
        ),
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the page's address.")] = False,
    foxglove: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:PORT]",
            help=f"Show it in Foxglove or Lichtblick; default: {viewers.DEFAULTS[viewers.FOXGLOVE]}.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(metavar="[HOST:PORT]", help=f"Show it in rerun; default: {viewers.DEFAULTS[viewers.RERUN]}."),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit 1 also where a bound of run.bounds is not met.")
    ] = False,
    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="The bounds as JUnit XML, for a CI.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No live view.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Drive the groups of a configuration: start, arm, run, stop; then a table, and DIR/summary.json.

    $ robofleet run configs/platoon.yaml

    $ robofleet run configs/platoon.yaml --lockstep --set groups.0.settings.track=centre

    $ robofleet run configs/platoon.yaml --lockstep --strict --junit bounds.xml

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
            page = _page(web, web_host, browser=not no_browser, lockstep=lockstep)
            tree = _checked(config, changes, faults, lockstep=lockstep)
            if page is not None:
                page_keys(tree.arena.name, page.host, "--web-host")
            served = {viewers.FOXGLOVE: foxglove, viewers.RERUN: rerun}
            shown = {viewer: at for viewer, at in served.items() if at is not None}
            _refuse_viewers(shown, tree, lockstep=lockstep)
            if strict and not tree.run.bounds.model_dump(exclude_none=True):
                raise RefusedError(f"--strict: {config} has no bounds: write run.bounds, or leave --strict out")
            if junit is not None:
                new_file("--junit", junit)
            if not lockstep:
                _refuse_unattended(tree)
                _refuse_forgetful(tree)
                tree = _settled(tree)
                held.enter_context(_claimed(tree, folder))
            new_folder(folder)
        how = {} if lockstep else {"reset": reset, "take_over": takeover, "web": page, "viewers": shown}
        with bad_input():
            result = _result(tree, config.stem, folder, lockstep=lockstep, quiet=quiet, **how)
    ending = Ending(tree, folder, result, as_json=as_json)
    ending.tell()
    if junit is not None:
        ending.write_junit(junit)
    if ending.bad(strict=strict):
        raise typer.Exit(1)


@app.command()
def go(
    config: ConfigFile,
    goals: Annotated[list[str], typer.Argument(metavar="ROBOT=X,Y,DEG...", help="Poses in metres and degrees.")],
    lockstep: Annotated[bool, typer.Option("--lockstep", help="In simulation, on a simulated clock.")] = False,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: runs/<UTC time>-<config name>.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Open the operator's page in your browser.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No live view.")] = False,
) -> None:
    """Let robots go to poses by themselves, round each other; all others stand. It ends when they are there.

    $ robofleet go configs/platoon.yaml r1=0.5,0.2,90 r2=-0.5,0.2,0 --lockstep
    """
    with bad_input():
        changes = [*overrides, *going.overrides(goals)]
    run(config, lockstep=lockstep, overrides=changes, out=out, web=web, quiet=quiet)


@app.command()
def check(config: ConfigFile, overrides: Overrides = []) -> None:  # noqa: B006 - typer copies it
    """Refuse what cannot work, before a wheel turns; exit 0 and a table of what was proved.

    $ robofleet check configs/platoon.yaml --set groups.0.settings.path_rate=0.06
    """
    with bad_input():
        tree = _checked(config, overrides, None, lockstep=False)
    from rich.console import Console  # noqa: PLC0415

    from robofleet.config.yamlfile import printable  # noqa: PLC0415
    from robofleet.reports.tables import proofs_table  # noqa: PLC0415
    from robofleet.runs.check import proofs  # noqa: PLC0415
    from robofleet.runs.check_starts import warnings  # noqa: PLC0415

    console = Console()
    rows = [tuple(as_shown(cell, console.encoding) for cell in row) for row in proofs(tree)]
    console.print(proofs_table(printable(f"{config} can run. What was proved:"), rows))
    for warning in warnings(tree):
        print(f"May take long: {warning}")
    print("Next:", shlex.join(["robofleet", "run", str(config), *(f"--set={change}" for change in overrides)]))


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new folder, or an empty one.")],
) -> None:
    """Write a laboratory's starting files: arena, robots, path, camera, and the schema that editors read.

    $ robofleet init lab
    """
    from robofleet.config.starting import write_starting_files  # noqa: PLC0415

    with bad_input():
        new_folder(folder, "DIR")
        try:
            files = write_starting_files(folder)
        except OSError as error:
            raise RefusedError(f"DIR: {folder} cannot be written: {error.strerror}: name another folder") from error
    for file in files:
        print(f"{file}: {_first_comment(file)}")
    hello = shlex.quote(str(folder / "examples" / "hello.py"))
    print(f"{folder / 'examples'}: Scripts that drive the robots of script.yaml. Start with: python {hello}")
    print("Next:", shlex.join(["robofleet", "run", str(folder / "platoon.yaml"), "--web"]))


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


@app.callback()
def every_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version, and exit.")
    ] = False,
) -> None:
    """Take what stands before a command."""


def main(*before: str) -> None:
    """Run a command; one whose packages are not installed says which extra has them.

    ``before``: words that stand before those of the command line.
    """
    gc.set_threshold(_COLLECT_AFTER)
    if sys.__stderr__ is not None:
        faulthandler.enable(sys.__stderr__)  # a driver's or a camera's library that crashes is named, with its line
    speak_its_language()
    silence_libraries()
    never_raise()
    try:
        raise SystemExit(app([*before, *sys.argv[1:]], standalone_mode=False))
    except usage.UsageError as error:
        usage.show(error)
        raise SystemExit(2) from error
    except typer.Abort as error:
        raise SystemExit(1) from error
    except ModuleNotFoundError as error:
        if (package := (error.name or "").partition(".")[0]) not in LAB_MODULES:
            raise
        print(f"this needs {package}: {how_to_install('lab')}", file=sys.stderr)
        raise SystemExit(2) from error


def _first_comment(file: Path) -> str:
    """Return the first sentence of a configuration about itself; the line before it is the editors'."""
    words = " ".join(line.removeprefix("#").strip() for line in file.read_text().splitlines()[1:4])
    return words.partition(". ")[0].rstrip(".") + "."


def _checked(config: Path, overrides: list[str], faults: Path | None, *, lockstep: bool) -> "Config":
    from robofleet.runs.check import load_checked  # noqa: PLC0415

    return load_checked(config, overrides, faults, lockstep=lockstep)


def _page(web: bool, host: str | None, *, browser: bool, lockstep: bool) -> "PageWanted | None":
    """Return how the operator wants the page; None: not at all."""
    from robofleet.runs.page_process import PageWanted  # noqa: PLC0415

    if not web and host is None:
        return None
    option = "--web" if host is None else "--web-host"
    if lockstep:
        raise RefusedError(f"{option}: a lockstep run ends too soon for a page: leave {option} or --lockstep out")
    need_extra("lab", *WEB_PACKAGES)
    if host is not None:
        listening(host, 0, option).close()
    return PageWanted(host or LOOPBACK, browser)


def _refuse_viewers(shown: dict[str, str], tree: "Config", *, lockstep: bool) -> None:
    """Refuse viewers that could not see the run."""
    for viewer, at in shown.items():
        option = viewers.option(viewer)
        if lockstep:
            raise RefusedError(f"{option} needs a run in real time: after --lockstep open its run.mcap")
        viewers_command.need(viewer)
        viewers.Address.read(viewer, at, option).check(tree.arena.name, option)


def _refuse_unattended(tree: "Config") -> None:
    if tree.run.attended and not sys.stdin.isatty():
        raise RefusedError("run.attended: stdin is not a terminal: start the run in one, or set it to false")


def _refuse_forgetful(tree: "Config") -> None:
    """Refuse a run whose drivers could not keep what they must remember."""
    from robofleet.nodes.unit.keeping import FileKeeping  # noqa: PLC0415

    here = tuple(robot for robot in tree.ids if tree.unit_of[robot] not in tree.daemons)
    if tree.drivers.started_by != "systemd":
        try:
            FileKeeping(tree.arena.name).try_place(here)
        except OSError as error:
            raise unkept(error) from error


@contextmanager
def _claimed(tree: "Config", folder: Path) -> "Iterator[None]":
    """Let the run be reached by others, and refuse a second one on the same arena."""
    from robofleet.bus.arena_file import ArenaBusyError, claimed  # noqa: PLC0415
    from robofleet.bus.endpoint import check_router  # noqa: PLC0415
    from robofleet.bus.private_folder import PlaceError  # noqa: PLC0415

    with ExitStack() as held:
        try:
            held.enter_context(claimed(tree, folder))
            check_router(tree)
        except (ArenaBusyError, PlaceError) as error:
            raise RefusedError(str(error)) from error
        yield


def _settled(tree: "Config") -> "Config":
    """Choose where the processes meet; what is in use is refused."""
    from robofleet.bus.endpoint import settled  # noqa: PLC0415
    from robofleet.bus.private_folder import PlaceError  # noqa: PLC0415
    from robofleet.hosts.network import network  # noqa: PLC0415

    network(tree)  # refuses keys that are missing, before anything starts
    try:
        return settled(tree, listen=True)
    except PlaceError as error:
        raise RefusedError(str(error)) from error


def _result(tree: "Config", name: str, folder: Path, *, lockstep: bool, quiet: bool, **how: Any) -> "Result":
    from robofleet.operator import run as runs  # noqa: PLC0415

    try:
        if lockstep:
            return runs.in_lockstep(tree, name, folder, quiet=quiet)
        return runs.in_real_time(tree, name, folder, quiet=quiet, **how)
    except OSError as error:
        print(f"{folder}: {error.strerror}: make room, or name another folder with --out", file=sys.stderr)
        raise typer.Exit(1) from error
