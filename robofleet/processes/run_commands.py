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
    what = "needs no repair" if done.trouble is None else f"mended: it {done.trouble}"
    print(f"{done.file}: {what}")
    print(f"{done.messages} messages over {done.span_ns / S:.1f} s, {done.lost} bytes behind them lost")
    if done.kept is not None:
        print(f"the damaged file is kept: {done.kept}")
