"""What the commands share."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.clock import utc_now

ReportFile = Annotated[
    Path | None, typer.Option("--report", metavar="FILE", help="Default: runs/<UTC time>-<command>/report.html.")
]


def report_file(asked: Path | None, command: str) -> Path:
    """Return where the page goes."""
    return asked or Path("runs") / f"{utc_now().strftime('%Y%m%dT%H%M%SZ')}-{command}" / "report.html"
