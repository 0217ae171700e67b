"""A self-contained HTML page of what was measured: a verdict, figures, tables, and plots as inline SVG.

It is read on a screen, on a phone and on paper; nothing is fetched from elsewhere.
"""

import base64
import io
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from robofleet.core.figures import COLOURS, FAINT, INK, QUIET, STYLE
from robofleet.core.files import write_text

_TEMPLATES = Environment(  # whatever a run's files say is text to them, never HTML
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_LOOK = {"ink": INK, "quiet": QUIET, "faint": FAINT, "link": COLOURS[0], "good": COLOURS[2], "bad": COLOURS[1]}
_NARROW_SCREEN_COLUMNS = 3
_PRECISION = re.compile(r"(?<=\.\d\d)\d+")  # a hundredth of a point is finer than any screen
_TAG = re.compile(r"<[^>]*>")
_NAMES = re.compile(r' id="(?!C\d)[\w.]+_\d+"')  # nobody refers to them, and every plot has the same
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


class Marked(NamedTuple):
    """A cell, or a line of a tile, that says whether something is good; None: neither."""

    text: str
    good: bool | None


class Tile(NamedTuple):
    """A figure to be seen at a glance."""

    label: str
    value: str
    unit: str
    note: Marked


class Picture(NamedTuple):
    """A small photograph with its line."""

    jpeg: bytes
    note: Marked

    @property
    def base64(self) -> str:
        return base64.b64encode(self.jpeg).decode()


class Page:
    """Collects a page from top to bottom; ``write`` makes the file."""

    def __init__(self, title: str, subtitle: str) -> None:
        """Begin a page; the subtitle says of when and where it is."""
        self._title, self._subtitle = title, subtitle
        self._blocks: list[dict[str, object]] = []
        self._sections: list[str] = []

    def _add(self, kind: str, **parts: object) -> None:
        self._blocks.append({"kind": kind, **parts})

    def verdict(self, text: str, *, good: bool | None, detail: str = "") -> None:
        """Add the sentence that says whether the result is good; with details it is their headline."""
        self._add("verdict", text=text, good=good, detail=detail)

    def section(self, title: str, text: str = "") -> None:
        self._sections.append(title)
        self._add("section", number=len(self._sections), title=title)
        if text:
            self.note(text)

    def note(self, text: str) -> None:
        self._add("note", text=text)

    def tiles(self, tiles: Iterable[Tile]) -> None:
        self._add("tiles", tiles=list(tiles))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]], *, whole: bool = False) -> None:
        """Add a table; floats show four digits.

        A ``whole`` one is as wide as the page. On a narrow screen it is not moved to the side: its rows become cards.
        """
        shown = [[_cell(cell) for cell in row] for row in rows]
        self._add("table", head=head, rows=shown, whole=whole, cards=whole and len(head) > _NARROW_SCREEN_COLUMNS)

    def pictures(self, pictures: Iterable[Picture]) -> None:
        self._add("pictures", pictures=list(pictures))

    def figure(
        self, figure: Figure, caption: str, *, title: str = "", legend: Iterable[tuple[str, str]] = (),
        long: bool = False, files: Callable[[], Iterable[tuple[str, str]]] = tuple,
    ) -> None:  # fmt: skip
        """Add a plot, with its legend's (label, colour); make it inside ``with mpl.rc_context(STYLE):``.

        A long one does not shrink to a narrow screen: it is moved to the side there. ``files``, called when the plot
        is drawn, returns (kind, address) of files that have it too.
        """
        buffer = io.StringIO()
        with mpl.rc_context({**STYLE, "svg.fonttype": "none"}):
            figure.savefig(buffer, format="svg", metadata=_NO_METADATA, transparent=True)
        _, _, rest = buffer.getvalue().partition("<svg")
        svg = _NAMES.sub("", _TAG.sub(lambda tag: _PRECISION.sub("", tag[0]), rest))  # what is written stays as it is
        self._add(
            "figure", svg=Markup(svg), caption=caption, title=title, legend=list(legend), long=long, files=list(files())
        )

    def listing(self, text: str, folded: str = "") -> None:
        """Add text as it is, folded away under a line where one is given."""
        self._add("listing", text=text, folded=folded)

    def write(self, file: Path) -> None:
        """Write the page; OSError if it cannot be."""
        page = _TEMPLATES.get_template("page.html").render(
            title=self._title, subtitle=self._subtitle, sections=self._sections, blocks=self._blocks, **_LOOK
        )
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, page + "\n")


def _cell(cell: object) -> Marked:
    if isinstance(cell, Marked):
        return cell
    return Marked(f"{cell:.4g}" if isinstance(cell, float) else "-" if cell is None else str(cell), None)
