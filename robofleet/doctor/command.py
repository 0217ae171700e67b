"""The command ``robofleet doctor``."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.config.load import ConfigFile
from robofleet.core.refusal import RefusedError
from robofleet.core.valid_json import dumps
from robofleet.doctor.asking import ask as answers
from robofleet.doctor.examination import examine
from robofleet.doctor.findings import Mark
from robofleet.doctor.needs import Needs
from robofleet.doctor.view import show
from robofleet.runs import check_drivers


def doctor(
    config: Annotated[
        Path | None,
        typer.Argument(
            metavar="CONFIG", help="The configuration to be run here; without it, a simulated run.", show_default=False
        ),
    ] = None,
    overrides: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change a key of CONFIG, for example robots.0.driver=create2. Repeatable.",
        ),
    ] = [],  # noqa: B006 - typer copies it
    robots: Annotated[
        str, typer.Option(metavar="r1,r2", help="This computer runs only the drivers of these robots of CONFIG.")
    ] = "",
    ask: Annotated[
        list[str],
        typer.Option(
            metavar="PORT",
            help="Open this serial port and print which robot answers; all: the ports of CONFIG, without CONFIG every "
            "USB port. No wheel moves; opening a port resets an Arduino. Repeatable.",
        ),
    ] = [],  # noqa: B006 - typer copies it
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Check this computer: what a run needs, how to get it.

    It prints a line for each need: ok, warn or missing, and how to mend it.

    $ robofleet doctor

    $ robofleet doctor configs/lab.yaml --ask all

    Exit code 0: a run would work. 1: something is missing.
    """
    if not all(ask):
        raise RefusedError("--ask: name a serial port, as /dev/ttyUSB0, or all")
    needs = _needs(config, overrides, robots)
    findings = [*examine(needs), *answers(needs, ask)]
    missing = sum(finding.mark is Mark.MISSING for finding in findings)
    what = str(config) if config is not None else "A simulated run"
    if as_json:
        listed = [finding.as_json() for finding in findings]
        print(dumps({"config": config and str(config), "works": missing == 0, "findings": listed}))
    elif missing:
        lines = f"{missing} of these lines say{'s' * (missing == 1)} what is missing"
        show(findings, f"{what} would not work here: {lines}.")
    else:
        show(findings, f"{what} would work here." + (f" Next: robofleet check {config}" if config else ""))
    if missing:
        raise typer.Exit(1)


def _needs(config: Path | None, overrides: list[str], robots: str) -> "Needs":
    if config is None:
        if overrides or robots:
            raise RefusedError(f"{'--set' if overrides else '--robots'}: it belongs to a configuration: name one")
        return Needs()
    source = ConfigFile(config, overrides)
    known = [robot.id for robot in source.config.robots]
    names = tuple(dict.fromkeys(name.strip() for name in robots.split(",") if name.strip()))
    for unknown in (name for name in names if name not in known):
        raise RefusedError(f"--robots: there is no robot {unknown!r} in {config} (it has {', '.join(known)})")
    complaints = check_drivers.complaints(source.config)
    source.refuse(c for c in complaints if not c[0].endswith(".driver"))  # a package that is missing is no bad input
    return Needs(source.config, names or None)
