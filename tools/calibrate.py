"""Measures what a laboratory needs once: the camera's lens, its place, each robot's tag, its delay and lag.

    .venv/bin/python tools/calibrate.py intrinsics|arena|offsets|latency|verify --help

Exit 0: measured, and good enough to use; 2: refused, one line for each reason. Nothing is written then.
"""

import sys

import typer

from robofleet.calibration.commands.intrinsics import intrinsics
from robofleet.calibration.commands.place import arena, verify
from robofleet.calibration.commands.robots import latency, offsets
from robofleet.calibration.store import CalibrationError
from robofleet.config.load import ConfigError

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)
for command in (intrinsics, arena, offsets, latency, verify):
    app.command()(command)


def main() -> None:
    """Run a command; bad input ends here."""
    try:
        app()
    except (CalibrationError, ConfigError) as refused:
        for fault in refused.faults:
            print(fault, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
