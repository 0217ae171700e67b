"""The commands that look at a run afterwards, from the file that it left."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robofleet.clock import S
from robofleet.processes.refusal import RefusedError, bad_input

app = typer.Typer()

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder, or its run.mcap.")]


@app.command()
def repair(run: RunFolder) -> None:
    """Mend the recording of a run that was killed: all that was written stays, and gets its index.

    robofleet repair runs/20260102T030405Z-platoon
    """
    from robofleet.recording.reading import RecordingError  # noqa: PLC0415
    from robofleet.recording.repair import repair as mend  # noqa: PLC0415

    with bad_input():
        try:
            done = mend(run)
        except RecordingError as error:
            raise RefusedError(str(error)) from error
        except OSError as error:
            print(f"{run}: {error.strerror}: make room; the recording is as it was", file=sys.stderr)
            raise typer.Exit(1) from error
    there = f"{done.messages} messages over {done.span_ns / S:.1f} s"
    if done.trouble is None:
        print(f"{done.file}: needs no repair: {there}")
        return
    lost = f"; {done.lost} bytes behind them are lost" if done.lost else ""
    print(f"{done.file}: mended: it {done.trouble}; there are {there}{lost}")
    if done.kept is not None:
        print(f"The damaged file is kept: {done.kept}")
