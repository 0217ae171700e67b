"""When recorded images were exposed: a CSV with a header.

Of a video: ``exposure_ns`` or ``exposure_s``, and one line a frame. Of a folder: ``file,exposure_ns`` or
``file,exposure_s``, and one line an image. A stamp is a mid-exposure, on any clock.
"""

import csv
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from robofleet.core.clock import S
from robofleet.tracking.sources import CameraError

_UNITS = {"exposure_ns": 1, "exposure_s": S}
_LAST_NS = 2**63


class Stamp(NamedTuple):
    """When an image was exposed."""

    file: str  # its name in the folder; empty for a frame of a video
    exposure_ns: int
    where: str  # this was read


def read_stamps(file: Path, *, named: bool) -> list[Stamp]:
    """Return the lines of a CSV, at least one, ``named`` with the images' files; CameraError."""
    lines = _lines(file)
    headers = {f"file,{name}" if named else name: unit for name, unit in _UNITS.items()}
    header = ",".join(cell.strip() for cell in lines[0]) if lines else ""
    if header not in headers:
        raise CameraError(f"{file}:1: is {header!r}, must be {' or '.join(map(repr, headers))}")
    if len(lines) == 1:
        raise CameraError(f"{file}:2: there is no line with a stamp")
    stamps = []
    for number, cells in enumerate(lines[1:], 2):
        where = f"{file}:{number}"
        if len(cells) != 1 + named:
            raise CameraError(f"{where}: {len(cells)} columns, must be {1 + named}")
        name = cells[0].strip() if named else ""
        stamps.append(Stamp(name, _nanoseconds(cells[-1], headers[header], where), where))
    return stamps


def _lines(file: Path) -> list[list[str]]:
    try:
        return list(csv.reader(file.read_text(encoding="utf-8-sig").splitlines(), strict=True))
    except OSError as error:
        raise CameraError(f"{file}: {error.strerror}") from error
    except (ValueError, csv.Error) as error:
        raise CameraError(f"{file}: is not a CSV file: {error}") from error


def _nanoseconds(text: str, unit: int, where: str) -> int:
    """Return a stamp exactly: a float has no room for today's nanoseconds."""
    try:
        exposure_ns = Decimal(text.strip()) * unit
        if abs(exposure_ns) < _LAST_NS:
            return round(exposure_ns)
    except ArithmeticError:  # Decimal's errors are
        pass
    raise CameraError(f"{where}: {text!r} is not a time")
