"""The command ``robofleet doctor``."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.config.files.names import SHIPPED, guide
from robofleet.config.load import ConfigFile, load_config
from robofleet.core.refusal import RefusedError
from robofleet.core.settings import ROBOTS
from robofleet.core.valid_json import dumps
from robofleet.doctor.asking import ask as answers
from robofleet.doctor.camera_rates import camera_rates
from robofleet.doctor.examination import examine
from robofleet.doctor.findings import Finding, Mark
from robofleet.doctor.needs import Needs
from robofleet.doctor.plan import Wanted, cameras
from robofleet.doctor.plan import findings as plan_findings
from robofleet.doctor.view import show
from robofleet.runs import check_drivers

_IMAGE = "1920x1080"


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
        str,
        typer.Option(
            metavar="r1,r2",
            help="This computer runs only the drivers of these robots of CONFIG. With --plan: how many robots.",
        ),
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
    plan: Annotated[
        bool, typer.Option("--plan", help="Print what to buy for the laboratory of CONFIG and of these options.")
    ] = False,
    arena: Annotated[str, typer.Option(metavar="XxY", help="With --plan: size of the floor in metres.")] = "",
    tag_side_mm: Annotated[
        float | None, typer.Option(metavar="MM", min=1, max=1000, help="With --plan: side of a robot's tag.")
    ] = None,
    image: Annotated[str, typer.Option(metavar="WxH", help="With --plan: pixels of a camera.")] = "",
    ceiling_m: Annotated[
        float | None,
        typer.Option(metavar="M", min=0.2, max=100, help="With --plan: greatest height of a lens."),
    ] = None,
) -> None:
    """Check this computer: what a run needs, how to get it.

    It prints a line for each need: ok, warn or missing, and how to mend it. V4L2 cameras of CONFIG
    give images for two seconds.

    $ robofleet doctor

    $ robofleet doctor configs/lab.yaml --ask all

    $ robofleet doctor --plan --arena 3.2x2.0 --robots 8 --tag-side-mm 70

    Exit code 0: a run would work. 1: something is missing.
    """
    if plan:
        wanted = _wanted(config, overrides, robots, arena, tag_side_mm, image, ceiling_m)
        if (view := cameras(wanted)) is None:
            raise RefusedError(
                "--plan: no 16 cameras see such tags well enough there: take larger tags, more pixels, a higher ceiling"
            )
        _print_plan([*plan_findings(wanted, view)], as_json)
        return
    if arena or tag_side_mm is not None or image or ceiling_m is not None:
        raise RefusedError("--arena, --tag-side-mm, --image, --ceiling-m: they belong to --plan")
    if not all(ask):
        raise RefusedError("--ask: name a serial port, as /dev/ttyUSB0, or all")
    needs = _needs(config, overrides, robots)
    findings = [*examine(needs), *camera_rates(needs), *answers(needs, ask)]
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


def _print_plan(findings: list[Finding], as_json: bool) -> None:
    if as_json:
        print(dumps({"plan": [finding.as_json() for finding in findings]}))
    else:
        show(findings, f"{guide('BUY.md')} explains each line. Next: robofleet init DIR, then edit DIR/lab.yaml.")


def _wanted(
    config: Path | None, overrides: list[str], robots: str, arena: str, tag_side_mm: float | None, image: str,
    ceiling_m: float | None,
) -> Wanted:  # fmt: skip
    """Return the laboratory of a configuration, with what the options change."""
    tree = load_config(config or SHIPPED / "platoon.yaml", overrides)
    if robots and not (robots.isascii() and robots.isdigit() and 1 <= int(robots) <= ROBOTS):
        raise RefusedError(f"--robots {robots}: with --plan write how many, 1 to {ROBOTS}")
    camera = tree.views[0].camera
    size = _pair("--arena", arena, "3.2x2.0", 0.1, 100) if arena else tree.arena.size_m
    pixels = (
        _pair("--image", image or _IMAGE, _IMAGE, 100, 16384)
        if image or config is None
        else (camera.width, camera.height)
    )
    return Wanted(
        arena_m=size,
        robots=int(robots) if robots else len(tree.robots),
        tag_side_m=tag_side_mm / 1e3 if tag_side_mm else tree.tracker.tag_side_m,
        tag_height_m=tree.tracker.tag_height_m,
        body_radius_m=max(robot.vehicle.body_radius_m for robot in tree.robots),
        speed_m_s=max(robot.vehicle.max_speed_m_s for robot in tree.robots),
        image_px=(round(pixels[0]), round(pixels[1])),
        rate_hz=camera.rate_hz,
        ceiling_m=ceiling_m,
    )


def _pair(option: str, text: str, example: str, least: float, most: float) -> tuple[float, float]:
    try:
        first, second = map(float, text.split("x"))
    except ValueError:
        first = second = 0.0
    if not (least <= first <= most and least <= second <= most):
        raise RefusedError(f"{option} {text}: write it as {example}, each {least:g} to {most:g}")
    return first, second
