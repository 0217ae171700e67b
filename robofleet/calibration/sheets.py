"""Sheets to print, true to scale: AprilTags to cut out, and ChArUco boards, as drawings of lines and outlines alone."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from robofleet.calibration.store import CalibrationError
from robofleet.core.figures import INK, QUIET
from robofleet.core.settings import FAMILIES, FamilyName
from robofleet.tracking.tags.families import pattern

# Width and height, upright [mm].
PAPERS: dict[str, tuple[float, float]] = {
    "a4": (210.0, 297.0), "a3": (297.0, 420.0), "a2": (420.0, 594.0), "a1": (594.0, 841.0), "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4), "legal": (215.9, 355.6), "tabloid": (279.4, 431.8),
}  # fmt: skip
MARKER_CELLS = 7  # of a board's marker
LARGEST_BOARD = (11, 8)  # squares of a board that the paper alone decides

# Millimetres.
MARGIN = 8.0  # which printers leave white, but for the ticks of the ruler
LEFT, FOOT = 12.0, 28.0  # with the rulers and the text
RIM = 3.5  # of a tag's piece of paper, for its label, beyond a white cell all around
BOARD_RIM = 5.0
HAIR, LABEL_PT = 0.15, 6.0


Point = tuple[float, float]
Segments = Sequence[Sequence[float]]  # x, y, x, y each


class Page:
    """A sheet of paper; millimetres from its lower left corner, y up."""

    def __init__(self, size: tuple[float, float]) -> None:
        self.width, self.height = size
        self.figure = Figure(figsize=(self.width / 25.4, self.height / 25.4))
        self._to_paper = Affine2D().scale(1.0 / 25.4) + self.figure.dpi_scale_trans

    def fill(self, outline: Outline, x: float, y: float, scale: float, name: str | None = None) -> None:
        """Blacken an outline with its origin at x, y."""
        placed = Affine2D().scale(scale).translate(x, y).transform_path(outline)
        self._add(PathPatch(placed, facecolor="black", linewidth=0, transform=self._to_paper, snap=False, gid=name))

    def lines(self, segments: Segments, origin: Point = (0.0, 0.0), quarters: int = 0, name: str | None = None) -> None:
        """Draw hairlines from x, y to x, y, turned about the origin by quarters counter-clockwise."""
        path = Outline(np.reshape(segments, (-1, 2)), [Outline.MOVETO, Outline.LINETO] * len(segments))
        placed = Affine2D().rotate_deg(90 * quarters).translate(*origin).transform_path(path)
        style: dict[str, Any] = {"edgecolor": "black", "linewidth": HAIR * 72 / 25.4, "capstyle": "butt", "fill": False}
        self._add(PathPatch(placed, **style, transform=self._to_paper, snap=False, gid=name))

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        self.figure.text(x / self.width, y / self.height, text, **{"fontsize": LABEL_PT, "color": INK, **style})

    def _add(self, artist: Artist) -> None:
        self.figure.add_artist(artist, clip=False)


def outline(black: NDArray[Any]) -> Outline:
    """Return the edge of the black cells (rows, columns) as one path [cells; y up from the lower left corner].

    Cells drawn one by one would show hairlines between them.
    """
    framed, rows = np.pad(np.asarray(black, dtype=bool), 1), len(black)
    ends: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for row, column in np.argwhere(framed).tolist():
        x, y = column - 1, rows + 1 - row  # its upper left corner
        around = (framed[row, column - 1], framed[row + 1, column], framed[row, column + 1], framed[row - 1, column])
        corners = ((x, y), (x, y - 1), (x + 1, y - 1), (x + 1, y), (x, y))
        for k, taken in enumerate(around):  # left, below, right, above: black on the left of each edge
            if not taken:
                ends.setdefault(corners[k], []).append(corners[k + 1])
    vertices: list[tuple[int, int]] = []
    codes: list[Any] = []
    while ends:
        first = point = next(iter(ends))
        codes.append(Outline.MOVETO)
        while True:
            vertices.append(point)
            following = ends[point].pop()
            if not ends[point]:
                del ends[point]
            point = following
            if point == first:
                break
            codes.append(Outline.LINETO)
        vertices.append(first)
        codes.append(Outline.CLOSEPOLY)
    return Outline(np.array(vertices, dtype=np.float64), codes)


def piece_side(side: float, family: FamilyName = "36h11") -> float:
    """Return the side of the piece of paper of a tag with that side [mm]."""
    return side * (FAMILIES[family].cells + 2) / FAMILIES[family].square + 2.0 * RIM


def tag_pages(ids: Sequence[int], side: float, paper: str, command: str, family: FamilyName = "36h11") -> list[Page]:
    square, piece = FAMILIES[family].square, piece_side(side, family)
    size, columns, rows = _grid(piece, paper)
    if columns * rows == 0:
        raise CalibrationError(f"--side-mm {side:g}: with its white rim {piece:.4g} mm wide, too large for {paper}")
    pages = []
    for start in range(0, len(ids), columns * rows):
        page = Page(size)
        foot(page, command, f"AprilTag {family}, {FAMILIES[family].named} {side:g} mm")
        left = (page.width + LEFT - MARGIN - columns * piece) / 2.0
        top = page.height - MARGIN
        for k, tag in enumerate(ids[start : start + columns * rows]):
            x, y = left + k % columns * piece, top - (k // columns + 1) * piece
            _piece(page, x, y, piece, tag, f"id {tag}   {side:g} mm")
            inset = (piece - side * FAMILIES[family].whole) / 2.0
            page.fill(outline(~pattern(tag, family)), x + inset, y + inset, side / square, f"tag-{tag}")
        pages.append(page)
    return pages


def board_page(
    squares: tuple[int, int] | None, square: float, marker: float, paper: str, command: str
) -> tuple[Page, tuple[int, int]]:
    """Return a sheet with a ChArUco board (DICT_5X5_250, white squares of ``square`` mm) and its columns, rows."""
    upright = squares is not None and squares[1] > squares[0]
    size = PAPERS[paper] if upright else PAPERS[paper][::-1]
    room = (size[0] - LEFT - MARGIN - 2 * BOARD_RIM, size[1] - FOOT - MARGIN - 2 * BOARD_RIM)
    fit = [int(space / square + 1e-9) for space in room]
    columns, rows = squares or (min(fit[0], LARGEST_BOARD[0]), min(fit[1], LARGEST_BOARD[1]))
    if columns > fit[0] or rows > fit[1]:
        needs = f"{columns} x {rows} squares of {square:g} mm"
        raise CalibrationError(f"--paper {paper}: too small for {needs}; {fit[0]} x {fit[1]} fit")
    if min(columns, rows) < 3:
        raise CalibrationError(f"{columns} x {rows} squares of {square:g} mm: a board needs 3 x 3 or more")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    if columns * rows // 2 > len(dictionary.bytesList):
        raise CalibrationError(f"--squares {columns}x{rows}: needs more than {len(dictionary.bytesList)} markers")
    page = Page(size)
    named = f"--squares {columns}x{rows} --square-mm {square:g} --marker-mm {marker:g}"
    foot(page, command, f"robofleet calibrate intrinsics {named}   (ChArUco, DICT_5X5_250)")
    x = (page.width + LEFT - MARGIN - columns * square) / 2.0
    y = (page.height + FOOT - MARGIN - rows * square) / 2.0
    chess = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    page.fill(outline(chess), x, y, square, "chessboard")
    board = cv2.aruco.CharucoBoard((columns, rows), square, marker, dictionary)
    for tag, corners in zip(np.ravel(board.getIds()).tolist(), np.asarray(board.getObjPoints()), strict=True):
        across, down = corners[3, :2].tolist()  # its lower left corner, from the board's upper left one
        black = dictionary.generateImageMarker(tag, MARKER_CELLS) == 0
        page.fill(outline(black), x + across, y + rows * square - down, marker / MARKER_CELLS, f"marker-{tag}")
    return page, (columns, rows)


def _grid(piece: float, paper: str) -> tuple[tuple[float, float], int, int]:
    """Return the paper, upright or across, that takes more pieces, and in how many columns and rows."""
    choices = []
    for size in (PAPERS[paper], PAPERS[paper][::-1]):
        columns, rows = (int(room / piece + 1e-9) for room in (size[0] - LEFT - MARGIN, size[1] - FOOT - MARGIN))
        choices.append((size, columns, rows))
    return max(choices, key=lambda choice: choice[1] * choice[2])  # the first, upright, if both take as many


def _piece(page: Page, x: float, y: float, side: float, tag: int, label: str) -> None:
    """Draw where to cut, the middle of each side, what it is, and which way the robot looks."""
    segments = []
    for at_x in (x, x + side):
        for at_y in (y, y + side):
            segments += [[at_x - 2, at_y, at_x + 2, at_y], [at_x, at_y - 2, at_x, at_y + 2]]
    middle_x, middle_y, tick = x + side / 2, y + side / 2, 1.2
    segments += [[middle_x, y, middle_x, y + tick], [middle_x, y + side, middle_x, y + side - tick]]
    segments += [[x, middle_y, x + tick, middle_y]]
    page.lines(segments)
    points = min(LABEL_PT, 0.15 * side)  # so that it ends before the middle
    page.text(x + RIM, y + RIM / 2, label, va="center_baseline", fontsize=points)
    arrow = Outline([(0.0, -1.2), (1.8, 0.0), (0.0, 1.2), (0.0, -1.2)], closed=True)
    page.fill(arrow, x + side - 2.4, middle_y, 1.0, f"forward-{tag}")
    turned: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "bottom", "color": QUIET, "fontsize": points}
    page.text(x + side - RIM / 2, middle_y + 2.0, "forward", **turned)


def foot(page: Page, command: str, what: str) -> None:
    """Draw a ruler in each direction, for printers stretch one more than the other, and write how to print."""
    across, up = (50 * int(room / 50) for room in (page.width - LEFT - MARGIN, page.height - FOOT - MARGIN))
    ticks = [[mm, 0.0, mm, 3.0 if mm % 50 == 0 else 2.0 if mm % 10 == 0 else 1.0] for mm in range(across + up)]
    y = FOOT - 7.0
    page.lines([[0, 0, across, 0], *ticks[: across + 1]], (LEFT, y), name="ruler-across")
    page.lines([[0, 0, up, 0], *ticks[: up + 1]], (MARGIN, FOOT), quarters=1, name="ruler-up")
    for mm in range(0, across + 1, 50):
        page.text(LEFT + mm, y - 1.0, f"{mm} mm", ha="center", va="top", color=QUIET)
    for mm in range(0, up + 1, 50):
        page.text(MARGIN + 1.0, FOOT + mm, f"{mm} mm", rotation=90, va="center", color=QUIET)
    check = f"Print at 100 % (actual size), and check that the rulers are {across} mm and {up} mm."
    page.text(LEFT, 13.0, check, fontsize=8)
    page.text(LEFT, 9.3, what)
    page.text(LEFT, 6.3, command, color=QUIET, family="monospace", fontsize=5)


def write(pages: Sequence[Page], out: Path) -> list[Path]:
    several = len(pages) > 1 and out.suffix.lower() == ".svg"
    files = [out.with_stem(f"{out.stem}-{k + 1}") for k in range(len(pages))] if several else [out]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context({"pdf.fonttype": 42, "savefig.bbox": "standard"}):
            data = [_svg(page) for page in pages] if out.suffix.lower() == ".svg" else [_pdf(pages)]
        for file, content in zip(files, data, strict=True):
            file.write_bytes(content)
    except OSError as error:
        raise CalibrationError(f"--out {out}: {error.strerror}") from error
    return files


def _svg(page: Page) -> bytes:
    buffer = io.BytesIO()
    page.figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _pdf(pages: Sequence[Page]) -> bytes:
    buffer = io.BytesIO()
    with PdfPages(buffer, metadata={"CreationDate": None}) as document:
        for page in pages:
            document.savefig(page.figure)
    return buffer.getvalue()
