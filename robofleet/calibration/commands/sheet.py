"""Draw tags and calibration boards to print.

$ robofleet sheet tags --ids 1-4,10 --side-mm 70 --paper a4 --out tags.pdf

$ robofleet sheet floor configs/lab.yaml --out floor.pdf

$ robofleet sheet board --squares 11x8 --paper a2 --out board.pdf

Sheets are PDF or SVG, true to scale. Print at 100 % ("actual size"), and check both rulers on the sheet. An SVG has one
page: several pages become NAME-1.svg, NAME-2.svg.
"""

import math
import shlex
from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration import floor_sheet
from robofleet.calibration.commands.shared import count as columns_and_rows
from robofleet.calibration.sheets import PAPERS, board_page, tag_pages, write
from robofleet.calibration.store import CalibrationError
from robofleet.config.load import load_config
from robofleet.core.settings import FAMILIES, LAST_TAG, FamilyName, is_family

PaperName = Annotated[str, typer.Option("--paper", metavar="SIZE", help=f"{', '.join(PAPERS)}.")]
_SIDE = "Side of the black square, in mm; for Standard41h12, of the white square in it."
OutFile = Annotated[Path, typer.Option("--out", metavar="FILE", help="FILE.pdf or FILE.svg.")]


def tags(
    ids: Annotated[str, typer.Option("--ids", metavar="IDS", help="The tags' numbers, for example 1-4,10.")],
    out: OutFile,
    side_mm: Annotated[float, typer.Option("--side-mm", metavar="MM", help=_SIDE)] = 70.0,
    paper: PaperName = "a4",
    family: Annotated[
        str, typer.Option("--family", metavar="NAME", help=f"{', '.join(FAMILIES)}; as tracker.family.")
    ] = "36h11",
) -> None:
    """Draw AprilTags for robots, to cut out.

    The right side of a print is the robot's front.

    $ robofleet sheet tags --ids 1-4,10 --side-mm 70 --out tags.pdf
    """
    _check(paper, out, {"--side-mm": side_mm})
    if not is_family(family):
        raise CalibrationError(f"--family {family}: must be {', '.join(FAMILIES)}")
    named = "" if family == "36h11" else f" --family {family}"
    command = f"tags --ids {ids} --side-mm {side_mm:g} --paper {paper.lower()}{named}"
    for file in write(tag_pages(parse_ids(ids, family), side_mm, paper.lower(), _command(command, out), family), out):
        print(file)


def floor(
    config: Annotated[
        Path,
        typer.Argument(metavar="CONFIG", help="The configuration (YAML), with arena, paths and floor tags."),
    ],
    out: OutFile,
    overrides: Annotated[
        list[str], typer.Option("--set", metavar="KEY=VALUE", help="Change a key of CONFIG. Repeatable.")
    ] = [],  # noqa: B006 - typer copies it
    count: Annotated[int, typer.Option("--count", metavar="N", help="Number of tags, 4 to 8.")] = floor_sheet.MOST,
    side_mm: Annotated[float, typer.Option("--side-mm", metavar="MM", help=_SIDE)] = 100.0,
    first_id: Annotated[
        int,
        typer.Option(
            "--first-id", metavar="N", min=0, max=LAST_TAG, help="First number; robots' numbers are left out."
        ),
    ] = 500,
    paper: PaperName = "a4",
) -> None:
    """Draw tags for the floor, and a sheet for their survey.

    The sheet shows where the tags lie, and what to measure.

    $ robofleet sheet floor configs/lab.yaml --out floor.pdf

    If CONFIG has tracker.floor_tags, these are drawn again. --count, --side-mm and --first-id are for new tags.
    """
    _check(paper, out, {"--side-mm": side_mm})
    tree = load_config(config, overrides)
    tags = floor_sheet.planned(tree, count, side_mm, first_id)
    changes = [f"--set {shlex.quote(change)}" for change in overrides]
    new = [] if tags.surveyed else [f"--count {count} --side-mm {side_mm:g} --first-id {first_id}"]
    command = " ".join(["floor", shlex.quote(config.name), *changes, *new, f"--paper {paper.lower()}"])
    for file in write(floor_sheet.pages(tree, tags, paper.lower(), _command(command, out)), out):
        print(file)
    if not tags.surveyed:
        print("Lay them, measure them as the first sheet says, and write survey.yaml:", *tags.survey(), sep="\n")
        print(f"Then: robofleet calibrate arena CAMERA survey.yaml --live {shlex.quote(str(config))}")


def board(
    out: OutFile,
    squares: Annotated[
        str | None, typer.Option("--squares", metavar="COLUMNSxROWS", help="Squares. Default: 11x8, or what fits.")
    ] = None,
    square_mm: Annotated[float, typer.Option("--square-mm", metavar="MM", help="Side of a square, in mm.")] = 40.0,
    marker_mm: Annotated[
        float, typer.Option("--marker-mm", metavar="MM", help="Side of a marker in a square, in mm.")
    ] = 30.0,
    paper: PaperName = "a3",
) -> None:
    """Draw a board for measuring a camera's lens.

    It is for `robofleet calibrate intrinsics`. Glue it to something flat and stiff.

    $ robofleet sheet board --paper a3 --out board.pdf
    """
    _check(paper, out, {"--square-mm": square_mm, "--marker-mm": marker_mm})
    if marker_mm >= square_mm:
        raise CalibrationError(f"--marker-mm {marker_mm:g}: must be smaller than its square of {square_mm:g} mm")
    named = "" if squares is None else f"--squares {squares} "
    command = f"board {named}--square-mm {square_mm:g} --marker-mm {marker_mm:g} --paper {paper.lower()}"
    requested = None if squares is None else columns_and_rows(squares, "--squares")
    page, (columns, rows) = board_page(requested, square_mm, marker_mm, paper.lower(), _command(command, out))
    print(*write([page], out))
    print(
        f"robofleet calibrate intrinsics --squares {columns}x{rows} --square-mm {square_mm:g} --marker-mm {marker_mm:g}"
    )


def parse_ids(text: str, family: FamilyName = "36h11") -> list[int]:
    """Return the ids of a list of numbers and ranges; CalibrationError for what is none of the family, or twice."""
    ids: list[int] = []
    greatest = FAMILIES[family].ids - 1
    for part in text.split(","):
        ends = part.strip().split("-")
        if len(ends) > 2 or not all(end.strip().isdecimal() for end in ends):
            raise CalibrationError(f"--ids {text}: {part.strip()!r} is neither an id nor a range; write it as 1-4,10")
        first, last = int(ends[0]), int(ends[-1])
        if last > greatest or first > last:
            raise CalibrationError(f"--ids {text}: {part.strip()!r} is not in 0-{greatest}, or goes backwards")
        ids += range(first, last + 1)
    twice = sorted({tag for tag in ids if ids.count(tag) > 1})
    if twice:
        raise CalibrationError(f"--ids {text}: {twice[0]} is there twice, and two equal tags cannot be told apart")
    return ids


def _check(paper: str, out: Path, lengths: dict[str, float]) -> None:
    if paper.lower() not in PAPERS:
        raise CalibrationError(f"--paper {paper}: must be {', '.join(PAPERS)}")
    if out.suffix.lower() not in (".pdf", ".svg"):
        raise CalibrationError(f"--out {out}: must end in .pdf or .svg")
    for option, length in lengths.items():
        if not (math.isfinite(length) and length >= 5.0):
            raise CalibrationError(f"{option} {length:g}: must be 5 mm or more")


def _command(rest: str, out: Path) -> str:
    return f"robofleet sheet {rest} --out {shlex.quote(out.name)}"
