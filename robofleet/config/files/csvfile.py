"""Reads a CSV file of numbers as a configuration's rows: every number with its line and column."""

import math
from pathlib import Path

from robofleet.config.files.yamlfile import Mistake, Node, Position, Source
from robofleet.core.files import read_named

_LARGEST_BYTES = 1 << 20
_LONGEST_NUMBER = 100  # [characters]


def read_table(file: Path, source: Source, path: str, columns: tuple[str, ...]) -> tuple[Node | None, list[Mistake]]:
    """Read a file whose first line names its ``columns``: a list of rows at ``path`` (None: none), and its faults.

    Empty lines count for nothing.

    Raises:
        FileNotFoundError: there is no such file.
    """
    begin = Position(source, 1, 1, "")
    try:
        text = read_named(file, _LARGEST_BYTES).decode("utf-8-sig")
    except FileNotFoundError:
        raise
    except UnicodeDecodeError:
        return None, [Mistake(begin, "is not UTF-8 text: save the file as UTF-8")]
    except (OSError, ValueError) as error:
        return None, [Mistake(begin, f"cannot be read: {getattr(error, 'strerror', None) or error}")]
    head, *lines = text.splitlines() or [""]
    if [name.strip() for name in head.split(",")] != list(columns):
        return None, [Mistake(begin, f"the first line must be {','.join(columns)}, not {head[:60]!r}")]
    rows: list[Node] = []
    for number, line in enumerate(lines, start=2):
        if line.strip():
            where = f"{path}.{len(rows)}"
            row, fault = _row(line, Position(source, number, 1, where), columns)
            if fault is not None:
                return None, [fault]
            rows.append(row)
    return Node(rows, begin_at := Position(source, 1, 1, path), begin_at), []


def _row(line: str, position: Position, columns: tuple[str, ...]) -> tuple[Node, Mistake | None]:
    """Return one line's numbers, and what is wrong with it."""
    cells, numbers, column = line.split(","), [], 1
    row = Node([], position, position)
    if len(cells) != len(columns):
        return row, Mistake(position, f"must have {len(columns)} numbers ({','.join(columns)}), has {len(cells)}")
    for k, cell in enumerate(cells):
        at = Position(position.source, position.line, column + len(cell) - len(cell.lstrip()), f"{position.path}.{k}")
        try:
            value = float(cell[:_LONGEST_NUMBER])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            return row, Mistake(at, f"{columns[k]} must be a finite number, not {cell.strip()[:40]!r}")
        numbers.append(Node(value, at, at))
        column += len(cell) + 1
    return Node(list(numbers), position, position), None
