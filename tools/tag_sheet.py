"""Draws sheets to print, as PDF or SVG, true to scale: AprilTags for robots and floor, boards to calibrate a camera.

    .venv/bin/python tools/tag_sheet.py tags --ids 1-4,10 --side-mm 70 --paper a4 --out tags.pdf
    .venv/bin/python tools/tag_sheet.py board --squares 11x8 --paper a2 --out board.pdf

Print at 100 % ("actual size"), and check both rulers. An SVG holds one page: several become NAME-1.svg, NAME-2.svg.
Exit 0: drawn; 2: cannot be drawn, one line says why.
"""

import math
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration.sheets import PAPERS, board_page, tag_pages, write
from robofleet.calibration.store import CalibrationError
from robofleet.config.model import LAST_TAG

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)

PaperName = Annotated[str, typer.Option("--paper", help=", ".join(PAPERS))]
OutFile = Annotated[Path, typer.Option("--out", metavar="FILE", help="FILE.pdf or FILE.svg")]


@app.command()
def tags(
    ids: Annotated[str, typer.Option("--ids", help="As 1-4,10")],
    out: OutFile,
    side_mm: Annotated[float, typer.Option("--side-mm", help="Of the black square")] = 70.0,
    paper: PaperName = "a4",
) -> None:
    """AprilTags 36h11, to cut out. A print's right is its robot's forward."""
    _check(paper, out, {"--side-mm": side_mm})
    command = f"tags --ids {ids} --side-mm {side_mm:g} --paper {paper.lower()}"
    for file in write(tag_pages(parse_ids(ids), side_mm, paper.lower(), _command(command, out)), out):
        print(file)


@app.command()
def board(
    out: OutFile,
    squares: Annotated[str | None, typer.Option("--squares", help="COLUMNSxROWS; default: 11x8, or what fits")] = None,
    square_mm: Annotated[float, typer.Option("--square-mm")] = 40.0,
    marker_mm: Annotated[float, typer.Option("--marker-mm")] = 30.0,
    paper: PaperName = "a3",
) -> None:
    """A ChArUco board for `calibrate.py intrinsics`. Glue it to something flat and stiff."""
    _check(paper, out, {"--square-mm": square_mm, "--marker-mm": marker_mm})
    if marker_mm >= square_mm:
        raise CalibrationError(f"--marker-mm {marker_mm:g}: must be smaller than its square of {square_mm:g} mm")
    named = "" if squares is None else f"--squares {squares} "
    command = f"board {named}--square-mm {square_mm:g} --marker-mm {marker_mm:g} --paper {paper.lower()}"
    asked = None if squares is None else parse_squares(squares)
    page, (columns, rows) = board_page(asked, square_mm, marker_mm, paper.lower(), _command(command, out))
    print(*write([page], out))
    print(f"calibrate.py intrinsics --squares {columns}x{rows} --square-mm {square_mm:g} --marker-mm {marker_mm:g}")


def parse_ids(text: str) -> list[int]:
    """Return the ids of a list of numbers and ranges; CalibrationError for what is none of the family, or twice."""
    ids: list[int] = []
    for part in text.split(","):
        ends = part.strip().split("-")
        if len(ends) > 2 or not all(end.strip().isdecimal() for end in ends):
            raise CalibrationError(f"--ids {text}: {part.strip()!r} is no id and no range; as 1-4,10")
        first, last = int(ends[0]), int(ends[-1])
        if last > LAST_TAG or first > last:
            raise CalibrationError(f"--ids {text}: {part.strip()!r} is not in 0-{LAST_TAG}, or goes backwards")
        ids += range(first, last + 1)
    twice = sorted({tag for tag in ids if ids.count(tag) > 1})
    if twice:
        raise CalibrationError(f"--ids {text}: {twice[0]} stands there twice, and two tags alike cannot be told apart")
    return ids


def parse_squares(text: str) -> tuple[int, int]:
    """Return columns and rows."""
    numbers = text.lower().split("x")
    if len(numbers) != 2 or not all(number.isdecimal() for number in numbers):
        raise CalibrationError(f"--squares {text}: must be COLUMNSxROWS, as 11x8")
    return int(numbers[0]), int(numbers[1])


def _check(paper: str, out: Path, lengths: dict[str, float]) -> None:
    if paper.lower() not in PAPERS:
        raise CalibrationError(f"--paper {paper}: must be {', '.join(PAPERS)}")
    if out.suffix.lower() not in (".pdf", ".svg"):
        raise CalibrationError(f"--out {out}: must end in .pdf or .svg")
    for option, length in lengths.items():
        if not (math.isfinite(length) and length >= 5.0):
            raise CalibrationError(f"{option} {length:g}: must be 5 mm or more")


def _command(rest: str, out: Path) -> str:
    return f"tools/tag_sheet.py {rest} --out {shlex.quote(out.name)}"


def main() -> None:
    """Run a command; bad input ends here."""
    try:
        app()
    except CalibrationError as refused:
        for fault in refused.faults:
            print(fault, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
