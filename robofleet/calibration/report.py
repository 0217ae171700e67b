"""A self-contained HTML page of what was measured: tables, sentences, and plots as inline SVG."""

import html
import io
import re
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from robofleet.calibration.store import CalibrationError
from robofleet.clock import utc_now
from robofleet.figures import COLOURS, INK, QUIET, STYLE

_CSS = f"""
body {{ font: 15px/1.5 system-ui, sans-serif; color: {INK}; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }}
h1 {{ font-size: 1.5rem; margin-bottom: 0 }} h2 {{ font-size: 1.1rem; margin-top: 2rem }}
.when {{ color: {QUIET} }} figure {{ margin: 1rem 0 }} figcaption {{ color: {QUIET}; font-size: .9rem }}
svg {{ max-width: 100%; height: auto }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
th, td {{ text-align: left; padding: .2rem 1.2rem .2rem 0; border-bottom: 1px solid #e8e8e8 }} th {{ font-weight: 600 }}
.verdict {{ padding: .6rem 1rem; border-left: 5px solid; margin: 1rem 0; white-space: pre-line }}
.good {{ border-color: {COLOURS[2]}; background: #f0f6f1 }} .bad {{ border-color: {COLOURS[1]}; background: #fbf1ee }}
"""


class Report:
    """Collects a page from top to bottom; ``write`` makes the file."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts: list[str] = []

    def verdict(self, text: str, *, good: bool) -> None:
        """Add the sentence that says whether the result can be used."""
        self._parts.append(f'<p class="verdict {"good" if good else "bad"}">{html.escape(text)}</p>')

    def section(self, title: str, text: str = "") -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(title)}</h2>")
        if text:
            self._parts.append(f"<p>{html.escape(text)}</p>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Add a table; floats show four digits."""
        lines = ["".join(f"<th>{html.escape(cell)}</th>" for cell in head)]
        lines += ["".join(f"<td>{html.escape(_shown(cell))}</td>" for cell in row) for row in rows]
        self._parts.append("<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>")

    def figure(self, figure: Figure, caption: str) -> None:
        """Add a plot; make it inside ``with mpl.rc_context(STYLE):``."""
        buffer = io.StringIO()
        with mpl.rc_context(STYLE):
            figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
        svg = re.sub(r"^.*?(?=<svg)", "", buffer.getvalue(), flags=re.DOTALL)
        self._parts.append(f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>")

    def write(self, file: Path) -> None:
        """Write the page; CalibrationError if it cannot be."""
        when = utc_now().isoformat(timespec="seconds")
        head = f'<meta charset="utf-8"><title>{html.escape(self._title)}</title><style>{_CSS}</style>'
        body = f'<h1>{html.escape(self._title)}</h1><p class="when">{when}</p>' + "\n".join(self._parts)
        page = f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(page, encoding="utf-8")
        except OSError as error:
            raise CalibrationError(f"{file}: cannot be written: {error.strerror}") from error


def _shown(cell: object) -> str:
    return f"{cell:.4g}" if isinstance(cell, float) else "-" if cell is None else str(cell)
