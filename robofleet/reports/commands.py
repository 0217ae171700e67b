"""The commands that look at a run afterwards, from the file that it left."""

import errno
import gc
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import typer

from robofleet.config import groups
from robofleet.config.files.yamlfile import printable
from robofleet.config.tree import Config
from robofleet.core.clock import S, stopwatch_ns
from robofleet.core.files import write_bytes
from robofleet.core.plugins import PluginError
from robofleet.core.refusal import RefusedError, how_to_install, new_file, new_place
from robofleet.nodes.controller import compile_kernels
from robofleet.recording.reading import Imports, RecordingError, about, file_of, imported, read
from robofleet.recording.repair import repair as mend
from robofleet.reports import after
from robofleet.reports import junit as xml
from robofleet.reports.bounds import complaints
from robofleet.reports.layouts.layouts import VIEWERS
from robofleet.runs import replay as replaying
from robofleet.runs.folder import chosen

_NO_ROOM = errno.ENOSPC, errno.EDQUOT, errno.EFBIG

Modules = Annotated[
    Path | None,
    typer.Option(
        "--behaviours", metavar="DIR", help="Folder of your own behaviours; without it their measures are left out."
    ),
]
ReplayedModules = Annotated[
    Path | None,
    typer.Option("--behaviours", metavar="DIR", help="Folder of your own behaviours, and of policies that were moved."),
]
RunFolder = Annotated[
    Path | None, typer.Argument(metavar="RUN", help="A run's folder or its run.mcap. Default: the newest in runs/.")
]


def replay(run: RunFolder = None, behaviours: ReplayedModules = None) -> None:
    """Compute a recorded run's commands again, and compare.

    It gives the recorded inputs to the installed controller. Commands must be equal to the bit on the same computer
    with the same versions, else within 1e-9. Exit code 1: a command differs, or could not be compared. Your own
    behaviours are imported only from the folder that you name.

    $ robofleet replay runs/20260102T030405Z-platoon

    $ robofleet replay runs/20260102T030405Z-swirl --behaviours configs
    """
    run = chosen(run)
    times_ns = [stopwatch_ns()]
    with readable():
        recording = read(run, partial(needed, run, behaviours))
        recording.config = load_behaviours(run, recording.config, behaviours)
        times_ns.append(stopwatch_ns())
        compile_kernels(recording.config)
        times_ns.append(stopwatch_ns())
        verdict = replaying.replay(recording, replaying.tolerance(recording))
    times_ns.append(stopwatch_ns())
    reading_s, loading_s, driving_s = ((after - before) / S for before, after in pairwise(times_ns))
    lasted_s, took_s = verdict.ticks * recording.config.controller.tick_s, reading_s + driving_s
    speed = f"{lasted_s:.1f} s in {took_s:.2f} s, {lasted_s / took_s:.0f} x real time; kernels in {loading_s:.1f} s"
    print("\n".join(verdict.lines()), f"({speed})")
    if recording.trouble is not None:
        print(printable(f"{run}: {recording.trouble}: it was replayed as far as it goes"), file=sys.stderr)
    if not verdict.equal:
        raise typer.Exit(1)


def load_behaviours(run: Path, config: "Config", folder: Path | None) -> "Config":
    """Load the recording's behaviours, and the files that they name; RefusedError where one is not here.

    Returns the configuration with the files where they are now: in the user's folder where they are gone.
    """
    try:
        config = config if folder is None else groups.relocated(config, folder)
        for group, behaviour in zip(config.groups, groups.behaviours(config), strict=True):
            for refusal in behaviour.refusals():
                raise RefusedError(printable(f"{run}: group {group.title}: {refusal.key}: {refusal.message}"))
    except PluginError as error:
        raise RefusedError(f"{run}: {error}") from error
    return config


def repair(run: RunFolder = None) -> None:
    """Complete the recording of a run that was killed.

    It keeps everything that was written. Other programs can then read the file.

    $ robofleet repair runs/20260102T030405Z-platoon
    """
    run = chosen(run)
    with readable():
        try:
            done = mend(run)
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise RefusedError(f"{error.filename}: cannot be written: {error.strerror}") from error
            print(printable(f"{run}: {error.strerror}: make room; the recording is as it was"), file=sys.stderr)
            raise typer.Exit(1) from error
    extent = f"{done.messages} messages over {done.span_ns / S:.1f} s"
    if done.trouble is None:
        print(printable(f"{done.file}: needs no repair: {extent}"))
        return
    lost = f"; {done.lost} bytes after them are lost" if done.lost else ""
    print(printable(f"{done.file}: mended: it {done.trouble}; there are {extent}{lost}"))
    if done.kept is not None:
        print(printable(f"The damaged file is kept: {done.kept}"))


def report(
    run: RunFolder = None,
    other: Annotated[Path | None, typer.Argument(metavar="RUN", help="A second run to compare with.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File of the comparison. Default: RUN/compare-<other>.html.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Also write each figure into this folder, as SVG and PDF.")
    ] = None,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the results of run.bounds as JUnit XML, for CI.")
    ] = None,
    behaviours: Modules = None,
) -> None:
    """Write the report of a run, or compare two runs.

    It writes RUN/report.html and RUN/metrics.csv; for two runs, a page with both. Exit code 1: the run did not meet a
    limit in its run.bounds.

    $ robofleet report

    $ robofleet report runs/20260102T030405Z-platoon

    $ robofleet report runs/20260102T030405Z-platoon --figures paper/figures --junit bounds.xml
    """
    run = chosen(run)
    with _without_garbage_collection(), readable():
        _refuse_misplaced(other, out, figures, junit)
        try:
            with importing(behaviours) as imports:
                if other is None:
                    page, lines = _made(run, figures, junit, imports)
                else:
                    page, lines = after.compare(run, other, out, imports), []
        except OSError as error:
            raise RefusedError(f"{error.filename}: cannot be written: {error.strerror}") from error
    print(printable(str(page)))
    for line in lines:
        print(line, file=sys.stderr)
    if lines:
        raise typer.Exit(1)


def layout(
    viewer: Annotated[str, typer.Argument(metavar="VIEWER", help="foxglove, lichtblick, plotjuggler or rerun.")],
    run: RunFolder = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File of the layout. Default: in the run's folder.")
    ] = None,
    behaviours: Modules = None,
) -> None:
    """Write a viewer's layout for a recorded run.

    It arranges poses, wheels, latency and the groups' own figures, robot by robot.

    $ robofleet layout foxglove runs/20260102T030405Z-platoon
    """
    with readable():
        if viewer not in VIEWERS:
            raise RefusedError(f"VIEWER: {viewer!r} is not known: take one of {', '.join(VIEWERS)}")
        run = chosen(run)
        layout_kind, file = VIEWERS[viewer], file_of(run)
        try:
            with importing(behaviours) as imports:
                written = layout_kind.make(about(run, imports), file)
        except ModuleNotFoundError as error:
            if not (error.name or "").startswith("rerun"):
                raise
            raise RefusedError(f"rerun: its package is missing, or too old: {how_to_install('rerun')}") from error
        target = out or file.with_name(layout_kind.file)
        try:
            write_bytes(target, written)
        except OSError as error:
            raise RefusedError(
                f"{target}: cannot be written: {error.strerror}: name another file with --out"
            ) from error
    print(printable(str(target)))
    for line in layout_kind.opening:
        print("Next:", printable(line.format(run=shlex.quote(str(file)), layout=shlex.quote(str(target)))))


def _refuse_misplaced(other: Path | None, out: Path | None, figures: Path | None, junit: Path | None) -> None:
    if out is not None and other is None:
        raise RefusedError("--out: one run's report stands in its folder; name two runs to compare them")
    if out is not None and os.path.lexists(out) and (out.is_symlink() or not out.is_file()):
        raise RefusedError(f"--out: {out} exists already and is not a file: name another one")
    for option, value in (("--figures", figures), ("--junit", junit)):
        if value is not None and other is not None:
            raise RefusedError(f"{option}: it is made of one run: name one run")
    if figures is not None:
        new_place("--figures", figures)
    if junit is not None:
        new_file("--junit", junit)


def _made(run: Path, figures: Path | None, junit: Path | None, imports: "Imports") -> tuple[Path, list[str]]:
    """Write a run's report; returns the page, and a line for every bound that was not met."""
    made = after.report(run, figures, imports)
    if junit is not None:
        xml.write(made.summary, [] if made.trouble is None else [f"{run}: {made.trouble}"], junit)
    return made.page, complaints(made.summary)


@contextmanager
def importing(folder: Path | None) -> Iterator["Imports"]:
    """Yield what imports a behaviour whose module stands in the user's folder; any other is told of at the end.

    RefusedError where a module in that folder cannot be used.
    """
    left_out: set[str] = set()

    def imports(name: str) -> bool:
        imported = _imported(folder, name)
        if not imported:
            left_out.add(name)
        return imported

    yield imports
    for name in sorted(left_out):
        print(printable(_left_out(folder, name, "'s own measures are left out")), file=sys.stderr)


def needed(run: Path, folder: Path | None, name: str) -> bool:
    """Import a behaviour from the user's folder; RefusedError where its module is not there."""
    if not _imported(folder, name):
        raise RefusedError(printable(f"{run}: {_left_out(folder, name, ' cannot be replayed')}"))
    return True


def _imported(folder: Path | None, name: str) -> bool:
    """Import a behaviour whose module stands in the user's folder; False: it does not."""
    try:
        return imported(folder, name)
    except PluginError as error:
        raise RefusedError(f"--behaviours: {error}") from error


def _left_out(folder: Path | None, name: str, effect: str) -> str:
    module, _, kind = name.partition(":")
    mend = f"add `--behaviours DIR`, the folder of {module}" if folder is None else f"{module} is not in {folder}"
    return f"{kind}{effect}: {mend}"


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Collect no garbage: it takes a fifth of the time to find that there is hardly any."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextmanager
def readable() -> Iterator[None]:
    try:
        yield
    except RecordingError as error:
        raise RefusedError(printable(str(error))) from error
