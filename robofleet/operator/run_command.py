"""The commands ``run``, ``go`` and ``check``."""

import math
import re
import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from robofleet.bus.arena_file import claimed
from robofleet.bus.endpoint import check_router, settled
from robofleet.config.files.yamlfile import printable
from robofleet.config.load import Typed
from robofleet.config.tree import Config
from robofleet.core.refusal import WEB_PACKAGES, RefusedError, need_extra, new_file, new_folder, unkept
from robofleet.hosts.network import network
from robofleet.nodes.unit.state_store import FileStateStore
from robofleet.operator import viewer_address as viewers
from robofleet.operator.config_commands import ConfigFile, Overrides
from robofleet.operator.ending import Ending, Result
from robofleet.operator.latches import local_robots, refuse_latched, tell_latched
from robofleet.operator.page.certificate import page_keys
from robofleet.operator.page.page_address import LOOPBACK, listening
from robofleet.operator.run import in_lockstep, in_real_time
from robofleet.operator.terminal.outlet import unhindered
from robofleet.operator.terminal.plain_terminal import as_shown
from robofleet.operator.usage import Command
from robofleet.reports.tables import proofs_table
from robofleet.runs import folder as folders
from robofleet.runs.check import load_checked, proofs, start_warnings
from robofleet.runs.companion import PageWanted
from robofleet.runs.folder import DEFAULT_FOLDER
from robofleet.runs.margins import margin_warnings

_GOAL = re.compile(r"([a-z][a-z0-9_-]*)=([^,=]+),([^,=]+),([^,=]+)")
_PATIENCE_S = 600.0  # a robot crosses any shipped arena in 20 s; many of them wait for each other


def goal_overrides(goals: list[str]) -> list[str]:
    """Return what changes a configuration into one that goes to ``ROBOT=X,Y,DEG``; RefusedError for another text."""
    poses: dict[str, str] = {}
    for text in goals:
        found = _GOAL.fullmatch(text)
        try:
            robot, *numbers = found.groups() if found else ("",)
            x, y, heading = map(float, numbers)
            if not math.isfinite(x + y + heading):
                raise ValueError(text)
        except ValueError:
            raise RefusedError(f"{text}: write ROBOT=X,Y,DEG in metres and degrees, as r1=0.5,0.2,90") from None
        if robot in poses:
            raise RefusedError(f"{text}: {robot} has a goal already: name each robot once")
        poses[robot] = f"{{x_m: {x!r}, y_m: {y!r}, heading_deg: {heading!r}}}"
    where = ", ".join(f"{robot}: {pose}" for robot, pose in poses.items())
    group = f"{{name: go, behaviour: go_to, robots: [{', '.join(poses)}], settings: {{goals: {{{where}}}}}}}"
    return [
        Typed(f"groups=[{group}]", " ".join(goals)),
        f"run.duration_s={_PATIENCE_S}",
        "run.begin=where_they_stand",
        "run.end=where_they_stand",
        "run.bounds={}",
    ]


class RunCommand(Command):
    """``run``, whose options --foxglove and --rerun may stand without a value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, viewers.completed(args))


@unhindered()
def run(
    config: ConfigFile,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep", help="Simulate in one process on a simulated clock: fast, and the same result each time."
        ),
    ] = False,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Length of the run in seconds. Default: run.duration_s of CONFIG.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Seed of all random numbers. Default: run.seed of CONFIG.")
    ] = None,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    faults: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Inject the faults of this file; configs/faults has examples.")
    ] = None,
    reset: Annotated[
        bool, typer.Option("--reset", help="Clear an emergency stop or a fault of an earlier run.")
    ] = False,
    takeover: Annotated[bool, typer.Option("--takeover", help="Take robots over from another controller.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for the results. {DEFAULT_FOLDER}")] = None,
    web: Annotated[bool, typer.Option("--web", help="Open the operator's page in your browser.")] = False,
    web_host: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Serve the page at this address of the computer, also for a phone: encrypted, with a QR code.",
        ),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="With --web: print the page's address, open no browser.")
    ] = False,
    foxglove: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:PORT]",
            help=f"Show the run in Foxglove or Lichtblick. Default: {viewers.DEFAULTS[viewers.FOXGLOVE]}.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(metavar="[HOST:PORT]", help=f"Show the run in rerun. Default: {viewers.DEFAULTS[viewers.RERUN]}."),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 also if a limit in run.bounds is not met.")
    ] = False,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the results of run.bounds as JUnit XML, for CI.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no live view in the terminal.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Drive the robots of a configuration.

    At the end it prints a table and writes a recording, summary.json and report.html into a folder.

    $ robofleet run configs/platoon.yaml

    $ robofleet run configs/platoon.yaml --lockstep --set groups.0.settings.track=centre

    $ robofleet run configs/platoon.yaml --lockstep --strict --junit bounds.xml

    Ctrl-C ends the run; twice is the emergency stop. From any terminal: `robofleet stop`, `hold`, `resume`, `status`.
    Exit code 0: completed. 1: ended by a fault or by you, or results were lost. 2: bad input.
    """
    changes = [*overrides]
    if duration is not None:
        changes.append(f"run.duration_s={duration}")
    if seed is not None:
        changes.append(f"run.seed={seed}")
    folder = out or folders.new(config.stem)
    with ExitStack() as held:
        page = _page(web, web_host, browser=not no_browser, lockstep=lockstep)
        tree = load_checked(config, changes, faults, lockstep=lockstep)
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
            if tree.run.attended and not sys.stdin.isatty():
                raise RefusedError("run.attended: stdin is not a terminal: start the run in one, or set it to false")
            _refuse_forgetful(tree)
            if not reset and tree.run.start == "auto":  # else the operator resets before the start
                typed = sys.argv[1:] if sys.argv[1:2] == ["run"] else ()  # not of a command that calls this one
                refuse_latched(tree, ["robofleet", *typed, "--reset"] if typed else ())
            network(tree)  # refuses keys that are missing, before anything starts
            tree = settled(tree, listen=True)
            held.enter_context(claimed(tree, folder))
            check_router(tree)
        new_folder(folder)
        how = {} if lockstep else {"reset": reset, "take_over": takeover, "web": page, "viewers": shown}
        result = _result(tree, config.stem, folder, lockstep=lockstep, quiet=quiet, **how)
    ending = Ending(tree, folder, result)
    ending.tell(as_json=as_json, quiet=quiet)
    if junit is not None:
        ending.write_junit(junit)
    if not lockstep:
        tell_latched(tree, ask=not (quiet or as_json))
    if ending.bad(strict=strict):
        raise typer.Exit(1)


def go(
    config: ConfigFile,
    goals: Annotated[
        list[str],
        typer.Argument(metavar="ROBOT=X,Y,DEG...", help="A robot and its pose, in metres and degrees. Repeatable."),
    ],
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Simulate on a simulated clock.")] = False,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for the results. {DEFAULT_FOLDER}")] = None,
    web: Annotated[bool, typer.Option("--web", help="Open the operator's page in your browser.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no live view in the terminal.")] = False,
) -> None:
    """Drive robots to given poses, around each other.

    All other robots stand. The run ends when the robots are at their poses.

    $ robofleet go configs/platoon.yaml r1=0.5,0.2,90 r2=-0.5,0.2,0 --lockstep
    """
    changes = [*overrides, *goal_overrides(goals)]
    run(config, lockstep=lockstep, overrides=changes, out=out, web=web, quiet=quiet)


def check(config: ConfigFile, overrides: Overrides = []) -> None:  # noqa: B006 - typer copies it
    """Check a configuration; nothing moves.

    It prints the limits that hold, or every mistake with its line and how to mend it.

    $ robofleet check configs/platoon.yaml --set groups.0.settings.path_rate=0.06
    """
    tree = load_checked(config, overrides, None, lockstep=False)
    console = Console()
    rows = [tuple(as_shown(cell, console.encoding) for cell in row) for row in proofs(tree)]
    console.print(proofs_table(printable(f"{config} can run. These limits hold:"), rows))
    for warning in start_warnings(tree):
        print(f"This may take long: {warning}")
    for warning in margin_warnings(tree):
        print(f"This may not work: {warning}")
    print("Next:", shlex.join(["robofleet", "run", str(config), *(f"--set={change}" for change in overrides)]))


def _page(web: bool, host: str | None, *, browser: bool, lockstep: bool) -> PageWanted | None:
    """Return how the operator wants the page; None: not at all."""
    if not web and host is None:
        return None
    option = "--web" if host is None else "--web-host"
    if lockstep:
        raise RefusedError(f"{option}: a lockstep run ends too soon for a page: leave {option} or --lockstep out")
    need_extra("lab", *WEB_PACKAGES)
    if host is not None:
        listening(host, 0, option).close()
    return PageWanted(host or LOOPBACK, browser)


def _refuse_viewers(shown: dict[str, str], tree: Config, *, lockstep: bool) -> None:
    for viewer, at in shown.items():
        option = viewers.option(viewer)
        if lockstep:
            raise RefusedError(f"{option} needs a run in real time: after --lockstep open its run.mcap")
        viewers.need(viewer)
        viewers.Address.read(viewer, at, option).check(tree.arena.name, option)


def _refuse_forgetful(tree: Config) -> None:
    """Refuse a run whose drivers could not keep what they must remember."""
    try:
        FileStateStore(tree.arena.name).try_place(local_robots(tree))
    except OSError as error:
        raise unkept(error) from error


def _result(tree: Config, name: str, folder: Path, *, lockstep: bool, quiet: bool, **how: Any) -> Result:
    try:
        if lockstep:
            return in_lockstep(tree, name, folder, quiet=quiet)
        return in_real_time(tree, name, folder, quiet=quiet, **how)
    except OSError as error:
        print(f"{folder}: {error.strerror}: make room, or name another folder with --out", file=sys.stderr)
        raise typer.Exit(1) from error
