"""What numba says of a function that it cannot compile, in one line: which, where, and why."""

import linecache
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba

_NUMBA = str(Path(numba.__file__).parent)
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_PLACE = re.compile(r"(?:\bat|Raised from) (\S.*?) \((\d+)\)\s*$", re.MULTILINE)
_WANTED = re.compile(r">>> (.+)")
_REASON = re.compile(r"raised a specific error:\s*\w+: (.+)")
_NOT_A_CAUSE = ("Failed in nopython mode", "During:", "File ")


def complaint(error: BaseException, function: Callable[..., Any]) -> str:
    """Return why numba's ``error`` came of ``function``: its name, the file and line, the source and the cause."""
    text = _COLOUR.sub("", str(error))
    plain = getattr(function, "py_func", function)
    file, line = next(_places(text, error), (plain.__code__.co_filename, plain.__code__.co_firstlineno))
    source = linecache.getline(file, line).strip()
    shown = f" `{source}`" if source else ""
    return f"numba cannot compile {plain.__qualname__}: {file}:{line}:{shown}: {_cause(text)}"


def _places(text: str, error: BaseException) -> Iterator[tuple[str, int]]:
    """Where it was, the innermost place first; numba's own code is left out."""
    found = [(file, int(line)) for file, line in _PLACE.findall(text)]
    if (outermost := getattr(error, "loc", None)) is not None and outermost.line is not None:
        found.append((outermost.filename, outermost.line))
    yield from ((file, line) for file, line in found if not file.startswith(_NUMBA))


def _cause(text: str) -> str:
    reasons = [reason for reason in _REASON.findall(text) if not reason.startswith("Poison")]
    if wanted := _WANTED.findall(text):
        call = wanted[-1].strip()
        if call.startswith("_"):  # of numba's own
            return reasons[-1] if reasons else f"it knows no {call}"
        return f"it knows no {call}" + (f": {reasons[-1]}" if reasons else "")
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith(_NOT_A_CAUSE)), text.strip())
    return _PLACE.sub("", first).removesuffix("Raised from None").strip(" .")
