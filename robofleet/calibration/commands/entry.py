"""``robofleet calibrate`` and ``robofleet sheet``: their packages are loaded when one of them is called.

Both are groups of commands. They stand in the command line as commands that pass their arguments on, since a group's
commands must be loaded to be listed, and every ``robofleet`` command would wait for OpenCV.
"""

import sys
from importlib import import_module
from typing import Annotated

import typer

_PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
_PANEL = "A laboratory, once"

app = typer.Typer()
Arguments = Annotated[list[str] | None, typer.Argument(metavar="COMMAND ...", help="See robofleet NAME --help.")]


@app.command(context_settings=_PASSED_ON, add_help_option=False, rich_help_panel=_PANEL)
def calibrate(ctx: typer.Context, arguments: Arguments = None) -> None:
    """Measure a laboratory: intrinsics, arena, offsets, latency, verify.

    $ robofleet calibrate arena ceiling survey.yaml --live configs/lab.yaml
    """
    hand_over("measure", f"robofleet {ctx.info_name}", arguments or [])


@app.command(context_settings=_PASSED_ON, add_help_option=False, rich_help_panel=_PANEL)
def sheet(ctx: typer.Context, arguments: Arguments = None) -> None:
    """Draw sheets to print, true to scale: tags, floor, board.

    $ robofleet sheet tags --ids 1-4 --side-mm 70 --out tags.pdf
    """
    hand_over("sheet", f"robofleet {ctx.info_name}", arguments or [])


def hand_over(program: str, name: str, arguments: list[str]) -> None:
    """Run a command of a program, ``measure`` or ``sheet``; bad input ends with exit code 2 and one line a fault."""
    commands = import_module(f"robofleet.calibration.commands.{program}").app

    from robofleet.calibration.store import CalibrationError  # noqa: PLC0415
    from robofleet.config.load import ConfigError  # noqa: PLC0415

    try:
        code = typer.main.get_command(commands).main(arguments, prog_name=name, standalone_mode=False)
    except (CalibrationError, ConfigError) as refused:
        for fault in refused.faults:
            print(fault, file=sys.stderr)
        raise typer.Exit(2) from refused
    raise typer.Exit(code or 0)
