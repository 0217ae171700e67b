"""The commands that look at a run afterwards, from the file that it left."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder, or its run.mcap.")]
