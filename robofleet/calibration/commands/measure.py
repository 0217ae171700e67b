"""Measures what a laboratory needs once: the camera's lens, its place, each robot's tag, its delay and lag.

$ robofleet calibrate arena ceiling survey.yaml --live configs/lab.yaml

Exit 0: measured, and good enough to use; 2: refused, one line for each reason. Nothing is written then.
"""

import typer

from robofleet.calibration.commands.intrinsics import intrinsics
from robofleet.calibration.commands.place import arena, verify
from robofleet.calibration.commands.robots import latency, offsets

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)
for command in (intrinsics, arena, offsets, latency, verify):
    app.command()(command)
