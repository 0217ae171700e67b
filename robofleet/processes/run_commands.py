"""The commands that look at a run afterwards, from the file that it left."""

import errno
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import typer

from robofleet.clock import S, stopwatch_ns
from robofleet.config.yamlfile import printable
from robofleet.processes.refusal import RefusedError, bad_input

app = typer.Typer()
_NO_ROOM = errno.ENOSPC, errno.EDQUOT, errno.EFBIG

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder, or its run.mcap.")]


@app.command()
def replay(run: RunFolder) -> None:
    """Let today's controller take what a recorded one took, tick by tick, and compare all that it says.

    Bit for bit where machine and versions are those of the recording, else within 1e-9. Exit 1 where anything is
    different, or could not be compared.

    $ robofleet replay runs/20260102T030405Z-platoon
    """
    from robofleet.processes import replay as replaying  # noqa: PLC0415
    from robofleet.processes.controller import compile_kernels  # noqa: PLC0415
    from robofleet.recording.reading import read  # noqa: PLC0415

    times_ns = [stopwatch_ns()]
    with _readable():
        recording = read(run)
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


@app.command()
def repair(run: RunFolder) -> None:
    """Mend the recording of a run that was killed: all that was written stays, and gets its index.

    $ robofleet repair runs/20260102T030405Z-platoon
    """
    from robofleet.recording.repair import repair as mend  # noqa: PLC0415

    with _readable():
        try:
            done = mend(run)
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise RefusedError(f"{error.filename}: cannot be written: {error.strerror}") from error
            print(printable(f"{run}: {error.strerror}: make room; the recording is as it was"), file=sys.stderr)
            raise typer.Exit(1) from error
    there = f"{done.messages} messages over {done.span_ns / S:.1f} s"
    if done.trouble is None:
        print(printable(f"{done.file}: needs no repair: {there}"))
        return
    lost = f"; {done.lost} bytes behind them are lost" if done.lost else ""
    print(printable(f"{done.file}: mended: it {done.trouble}; there are {there}{lost}"))
    if done.kept is not None:
        print(printable(f"The damaged file is kept: {done.kept}"))


@app.command()
def report(
    run: RunFolder,
    other: Annotated[Path | None, typer.Argument(metavar="RUN", help="Another one, to set beside it.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Of two: default RUN/compare-<other>.html.")] = None,
) -> None:
    """Write RUN/report.html and RUN/metrics.csv; of two runs, a page with both side by side.

    Exit 1 if the run did not meet one of its bounds.

    $ robofleet report runs/20260102T030405Z-platoon
    """
    with _keeping_garbage(), _readable():
        from robofleet.recording import after  # noqa: PLC0415

        if out is not None and other is None:
            raise RefusedError("--out: one run's report stands in its folder; name two runs to compare them")
        if out is not None and os.path.lexists(out) and (out.is_symlink() or not out.is_file()):
            raise RefusedError(f"--out: {out} is there already and no file: name another one")
        try:
            page, missed = after.report(run) if other is None else after.compare(run, other, out)
        except OSError as error:
            raise RefusedError(f"{error.filename}: cannot be written: {error.strerror}") from error
    print(printable(str(page)))
    for line in missed:
        print(f"bound not met: {line}", file=sys.stderr)
    if missed:
        raise typer.Exit(1)


@contextmanager
def _keeping_garbage() -> Iterator[None]:
    """Collect no garbage: it takes a fifth of the time to find that there is hardly any."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextmanager
def _readable() -> Iterator[None]:
    """Refuse a recording that cannot be read."""
    from robofleet.recording.reading import RecordingError  # noqa: PLC0415

    with bad_input():
        try:
            yield
        except RecordingError as error:
            raise RefusedError(printable(str(error))) from error
