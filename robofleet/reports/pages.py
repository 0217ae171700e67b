"""A self-contained HTML page of what was measured: a verdict, figures, tables, and plots as inline SVG.

It is read on a screen, on a phone and on paper; nothing is fetched from elsewhere.
"""

import base64
import html
import io
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from robofleet.core.figures import COLOURS, FAINT, INK, QUIET, STYLE
from robofleet.core.files import write_text

GOOD, BAD = COLOURS[2], COLOURS[1]

_SIDE_BY_SIDE = 3  # columns that a narrow screen shows
_PRECISION = re.compile(r"(?<=\.\d\d)\d+")  # a hundredth of a point is finer than any screen
_TAG = re.compile(r"<[^>]*>")
_NAMES = re.compile(r' id="(?!C\d)[\w.]+_\d+"')  # nobody refers to them, and every plot has the same
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))
_CSS = f"""
:root {{ color-scheme: light dark; --paper: #fff; --ink: {INK}; --quiet: #666; --faint: {FAINT}; --wash: #f6f6f6;
  --edge: {QUIET}; --link: {COLOURS[0]}; --good: #2f6b39; --good-edge: {GOOD}; --good-wash: #f0f6f1;
  --bad: #a53f28; --bad-edge: {BAD}; --bad-wash: #fbf1ee; --plot: none }}
* {{ box-sizing: border-box }}
body {{ font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 60rem;
  margin: 2rem auto 4rem; padding: 0 max(1rem, env(safe-area-inset-right)) 0 max(1rem, env(safe-area-inset-left)) }}
h1 {{ font-size: 1.9rem; line-height: 1.2; margin: 0 }} h3 {{ font-size: 1rem; margin: 0 }}
h1, p, figcaption, summary {{ overflow-wrap: anywhere }}
h2 {{ font-size: 1.25rem; margin: 2.6rem 0 .4rem; padding-top: .8rem; border-top: 1px solid var(--faint) }}
.when, .note {{ color: var(--quiet); margin: .2rem 0 }}
a {{ color: var(--link) }} .files a {{ margin-right: .6rem }}
nav {{ display: flex; flex-wrap: wrap; gap: .25rem 1.1rem; margin: 0 0 1.5rem; font-size: .9rem }}
nav a {{ text-decoration: none }}
figure {{ margin: 1.4rem 0 }} figcaption {{ color: var(--quiet); font-size: .9rem; max-width: 46rem }}
.plot {{ overflow-x: auto }} .plot svg {{ display: block; width: 100%; height: auto }}
.plot svg, .legend i {{ filter: var(--plot) }} .plot.long svg {{ min-width: 36rem }}
.plot svg text {{ font-family: system-ui, sans-serif !important }}
.legend {{ display: flex; flex-wrap: wrap; gap: 0 1rem; font-size: .85rem }}
.legend i {{ display: inline-block; width: .7rem; height: .7rem; border-radius: 50%; margin-right: .3rem }}
.wide {{ overflow-x: auto }} table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6rem 0 }}
th, td {{ text-align: left; padding: .25rem 1.2rem .25rem 0; border-bottom: 1px solid var(--faint);
  vertical-align: top }}
.whole table {{ width: 100% }}
.pictures {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(9rem, 1fr)); gap: .7rem; margin: 1rem 0 }}
.pictures figure {{ margin: 0 }} .pictures img {{ display: block; width: 100%; border-bottom: 4px solid var(--faint) }}
.pictures .good img {{ border-color: var(--good-edge) }} .pictures .bad img {{ border-color: var(--bad-edge) }}
.pictures .bad figcaption {{ color: var(--bad) }}
th {{ font-weight: 600 }} td {{ white-space: nowrap }} td:last-child {{ white-space: normal; min-width: 7rem }}
.verdict {{ padding: .8rem 1.1rem; border-left: 6px solid var(--edge); margin: 1.2rem 0; background: var(--wash);
  white-space: pre-line }}
.verdict strong {{ font-size: 1.25rem }}
.verdict.good {{ border-color: var(--good-edge); background: var(--good-wash) }}
.verdict.bad {{ border-color: var(--bad-edge); background: var(--bad-wash) }}
.tiles {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(10.5rem, 1fr)); gap: .7rem; margin: 1.2rem 0 }}
.tile {{ border: 1px solid var(--faint); border-top: 4px solid var(--faint); border-radius: 4px; padding: .5rem .8rem }}
.tile.good {{ border-top-color: var(--good-edge) }}
.tile.bad {{ border-top-color: var(--bad-edge); background: var(--bad-wash) }}
.tile b {{ display: block; font-size: 1.5rem; line-height: 1.3; font-weight: 600; font-variant-numeric: tabular-nums }}
.tile b small {{ font-size: .9rem; font-weight: 400 }}
.tile span {{ display: block; font-size: .82rem; color: var(--quiet) }}
.tile span.good, td.good {{ color: var(--good) }} .tile span.bad, td.bad {{ color: var(--bad); font-weight: 600 }}
pre {{ overflow-x: auto; background: var(--wash); padding: .8rem 1rem; font-size: .82rem; line-height: 1.45 }}
summary {{ cursor: pointer; color: var(--link) }}
:focus-visible {{ outline: 3px solid var(--link); outline-offset: 2px }}
@media (max-width: 40rem) {{
  body {{ margin-top: 1rem }} h1 {{ font-size: 1.5rem }}
  .tiles {{ grid-template-columns: repeat(2, minmax(0, 1fr)) }} .tile b {{ font-size: 1.25rem }}
  th, td {{ padding-right: .8rem }} td {{ white-space: normal; min-width: 4rem }}
  .cards tr {{ display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); padding: .4rem 0;
    border-bottom: 1px solid var(--faint) }}
  .cards tr:first-child {{ display: none }}
  .cards td {{ border: 0; min-width: 0; padding-bottom: 0; overflow-wrap: anywhere }}
  .cards td:last-child {{ min-width: 0 }} .cards td:empty {{ display: none }}
  .cards td::before {{ content: attr(data-head); display: block; color: var(--quiet); font-size: .75rem }}
}}
@media (max-width: 40rem), (pointer: coarse) {{ /* fingers */
  nav a, .files a {{ display: inline-flex; align-items: center; min-width: 44px; min-height: 44px }}
  summary {{ padding: .7rem 0 }}
}}
@media screen and (prefers-color-scheme: dark) {{ /* a plot is inverted, and its hues are turned back */
  :root {{ --paper: #1f1f1f; --ink: #dedede; --quiet: #b4b4b4; --faint: #444; --wash: #2a2a2a; --edge: #8a8a8a;
    --link: #84bdec; --good: #86cf92; --good-edge: #5ba366; --good-wash: #22301f; --bad: #f2a08e; --bad-edge: #e8806a;
    --bad-wash: #3a2420; --plot: invert(.88) hue-rotate(180deg) }}
}}
@media print {{
  body {{ font-size: 11px; max-width: none; margin: 0 }} nav {{ display: none }} h2 {{ break-after: avoid }}
  figure, tr, .tiles, .verdict {{ break-inside: avoid }}
  .plot.long svg {{ min-width: 0 }} * {{ print-color-adjust: exact }}
}}
"""


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


class Page:
    """Collects a page from top to bottom; ``write`` makes the file."""

    def __init__(self, title: str, subtitle: str) -> None:
        """Begin a page; the subtitle says of when and where it is."""
        self._title, self._subtitle = title, subtitle
        self._parts: list[str] = []
        self._sections: list[str] = []

    def verdict(self, text: str, *, good: bool | None, detail: str = "") -> None:
        """Add the sentence that says whether the result is good; with details it is their headline."""
        shown = f"<strong>{_text(text)}</strong>\n{_text(detail)}" if detail else _text(text)
        self._parts.append(f'<p class="verdict{_class(good)}">{shown}</p>')

    def section(self, title: str, text: str = "") -> None:
        """Begin a section."""
        self._sections.append(title)
        self._parts.append(f'<h2 id="s{len(self._sections)}">{_text(title)}</h2>')
        if text:
            self.note(text)

    def note(self, text: str) -> None:
        """Add a sentence."""
        self._parts.append(f"<p>{_text(text)}</p>")

    def tiles(self, tiles: Iterable[Tile]) -> None:
        """Add figures to be seen at a glance."""
        shown = (
            f'<div class="tile{_class(note.good)}"><span>{_text(label)}</span><b>{_text(value)} '
            f'<small>{_text(unit)}</small></b><span class="{_class(note.good)}">{_text(note.text)}</span></div>'
            for label, value, unit, note in tiles
        )
        self._parts.append(f'<div class="tiles">{"".join(shown)}</div>')

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]], *, whole: bool = False) -> None:
        """Add a table; floats show four digits.

        A ``whole`` one is as wide as the page. On a narrow screen it is not moved to the side: its rows become cards.
        """
        cards = whole and len(head) > _SIDE_BY_SIDE
        heads = head if cards else repeat("")
        lines = ["".join(map(_head, head))] + ["".join(map(_cell, row, heads)) for row in rows]
        kind = "wide" + whole * " whole" + cards * " cards"
        self._parts.append(
            f'<div class="{kind}" tabindex="0"><table>'
            + "".join(f"<tr>{line}</tr>" for line in lines)
            + "</table></div>"
        )

    def pictures(self, pictures: Iterable[Picture]) -> None:
        """Add small photographs side by side."""
        shown = (
            f'<figure class="{_class(note.good)}"><img alt="{_text(note.text)}" '
            f'src="data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}">'
            f"<figcaption>{_text(note.text)}</figcaption></figure>"
            for jpeg, note in pictures
        )
        self._parts.append(f'<div class="pictures">{"".join(shown)}</div>')

    def figure(
        self,
        figure: Figure,
        caption: str,
        *,
        title: str = "",
        legend: Iterable[tuple[str, str]] = (),
        long: bool = False,
        files: Callable[[], Iterable[tuple[str, str]]] = tuple,
    ) -> None:
        """Add a plot, with its legend's (label, colour); make it inside ``with mpl.rc_context(STYLE):``.

        A long one does not shrink to a narrow screen: it is moved to the side there. ``files``, called when the plot
        is drawn, returns (kind, address) of files that have it too.
        """
        buffer = io.StringIO()
        with mpl.rc_context({**STYLE, "svg.fonttype": "none"}):
            figure.savefig(buffer, format="svg", metadata=_NO_METADATA, transparent=True)
        _, start, rest = buffer.getvalue().partition("<svg")
        svg = _NAMES.sub("", _TAG.sub(lambda tag: _PRECISION.sub("", tag[0]), rest))  # what is written stays as it is
        svg = f'{start} role="img" aria-label="{_text(title or caption)}"{svg}'
        chips = "".join(f'<span><i style="background:{colour}"></i>{_text(label)}</span>' for label, colour in legend)
        head = f"<h3>{_text(title)}</h3>" if title else ""
        head += f'<div class="legend">{chips}</div>' if chips else ""
        plot = f'<div class="plot long" tabindex="0">{svg}</div>' if long else f'<div class="plot">{svg}</div>'
        links = " ".join(f'<a href="{_text(address)}" download>{_text(kind)}</a>' for kind, address in files())
        text = _text(caption) + (f'<br><span class="files">This figure as a file: {links}</span>' if links else "")
        self._parts.append(f"<figure>{head}{plot}<figcaption>{text}</figcaption></figure>")

    def listing(self, text: str, folded: str = "") -> None:
        """Add text as it is, folded away under a line where one is given."""
        listing = f'<pre tabindex="0">{_text(text)}</pre>'
        self._parts.append(f"<details><summary>{_text(folded)}</summary>{listing}</details>" if folded else listing)

    def write(self, file: Path) -> None:
        """Write the page; OSError if it cannot be."""
        title = _text(self._title)
        head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
        links = "".join(f'<a href="#s{k}">{_text(name)}</a>' for k, name in enumerate(self._sections, 1))
        top = f'<h1>{title}</h1><p class="when">{_text(self._subtitle)}</p>'
        body = f'<nav aria-label="Sections">{links}</nav><main>{top}' + "\n".join(self._parts) + "</main>"
        head += f"<style>{_CSS}</style>"
        page = f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, page)


def _head(cell: str) -> str:
    return f'<th scope="col">{_text(cell)}</th>' if cell else "<td></td>"


def _cell(cell: object, head: str = "") -> str:
    label = f' data-head="{_text(head)}"' if head else ""
    if isinstance(cell, Marked):
        return f'<td class="{_class(cell.good)}"{label}>{_text(cell.text)}</td>'
    return f"<td{label}>{_text(f'{cell:.4g}' if isinstance(cell, float) else '-' if cell is None else str(cell))}</td>"


def _class(good: bool | None) -> str:
    return "" if good is None else " good" if good else " bad"


def _text(text: str) -> str:
    return html.escape(text)
