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
    with bad_input():
        verdict = _replayed(_read(run))
    for difference in verdict.differences[:_SHOWN]:
        print(difference)
    if len(verdict.differences) > _SHOWN:
        print(f"and {len(verdict.differences) - _SHOWN} more differences")
