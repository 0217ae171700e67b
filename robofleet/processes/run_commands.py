"""The commands that look at a run afterwards, from the file that it left."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robofleet.processes.refusal import RefusedError, bad_input

if TYPE_CHECKING:
    from robofleet.recording.run import Recording

app = typer.Typer()

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder, or its run.mcap.")]

_SHOWN = 5  # differences


@app.command()
def replay(run: RunFolder) -> None:
    """Let today's controller take what a recorded one took, tick by tick, and compare all that it says.

    Bit for bit where machine and versions are those of the recording, else within 1e-9. Exit 1 where anything is
    different, or could not be compared.

    robofleet replay runs/20260101T120000Z-platoon
    """
    from robofleet.processes.controller import compile_kernels  # noqa: PLC0415
    from robofleet.processes.replay import replay as replayed  # noqa: PLC0415
    from robofleet.recording.reading import RecordingError, read  # noqa: PLC0415

    began_ns = stopwatch_ns()
    with bad_input():
        try:
            recording = read(run)
            compile_kernels(recording.config)
            tolerance = 0.0
            verdict = replayed(recording, tolerance)
        except RecordingError as error:
            raise RefusedError(str(error)) from error
    for line in verdict.lines(_SHOWN):
        print(line)
    if not verdict.equal:
        raise typer.Exit(1)
