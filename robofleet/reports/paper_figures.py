"""A report's plots as files for a paper: SVG and PDF, with the legend that the page shows beside a plot."""

import io
import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import quote

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from robofleet.core.figures import STYLE
from robofleet.core.files import replaced

Legend = list[tuple[str, str]]  # label, colour

_METADATA: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # the same every time
_STYLE: Any = {**STYLE, "pdf.fonttype": 42}  # publishers refuse Type 3 fonts
_A_ROW = 6  # labels
_PAD_INCH = 0.03


class FigureFiles:
    """The files of a run's figures in ``folder``; ``page`` is the page that links them."""

    def __init__(self, folder: Path, page: Path) -> None:
        self._folder, self._page = folder, page

    def write(self, title: str, figure: Figure, legend: Legend) -> list[tuple[str, str]]:
        """Write a plot, which is given its legend; returns (kind, address) of each file. OSError if it cannot be."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if legend:
            _add_legend(figure, legend)
        name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
        return [(kind.upper(), self._address(self._save(figure, name, kind))) for kind in _METADATA]

    def _save(self, figure: Figure, name: str, kind: str) -> Path:
        buffer, file = io.BytesIO(), self._folder / f"{name}.{kind}"
        with mpl.rc_context(_STYLE):
            figure.savefig(
                buffer, format=kind, metadata=_METADATA[kind], bbox_inches="tight", pad_inches=_PAD_INCH, dpi=300
            )
        with replaced(file) as stream:
            left = buffer.getbuffer()
            while left:
                left = left[stream.write(left) :]
        return file

    def _address(self, file: Path) -> str:
        return quote(os.path.relpath(file.resolve(), self._page.parent.resolve()))


def _add_legend(figure: Figure, legend: Legend) -> None:
    dots = [Line2D([], [], ls="none", marker="o", color=colour, label=label) for label, colour in legend]
    left = figure.axes[0].get_position().x0
    figure.legend(
        handles=dots, loc="lower left", bbox_to_anchor=(left, 1.0), ncols=min(len(dots), _A_ROW),
        borderaxespad=0.2, handletextpad=0.1, columnspacing=1.2, fontsize=8,
    )  # fmt: skip
