"""Finds which of a user's functions numba cannot compile."""

import inspect
import linecache
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from robofleet.control.flow_settings import FlowError
from robofleet.control.prediction import Plant
from robofleet.core.kernels import INFINITE, snapshot

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
    import numba  # noqa: PLC0415 - as in ``blame``

    numbas_own = str(Path(numba.__file__).parent)
    found = [(file, int(line)) for file, line in _PLACE.findall(text)]
    if (outermost := getattr(error, "loc", None)) is not None and outermost.line is not None:
        found.append((outermost.filename, outermost.line))
    yield from ((file, line) for file, line in found if not file.startswith(numbas_own))


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


_OF_STATE_AND_INPUT = ("f", "f_x", "f_u", "fastest_rate")

Suspect = tuple[str, Callable[..., Any] | None, int]  # name, function (None: not given), how many vectors it takes


def plant_functions(plant: Plant) -> list[Suspect]:
    """Return the functions of a plant that take vectors alone."""
    both: list[Suspect] = [(f"plant.{name}", getattr(plant, name), 2) for name in _OF_STATE_AND_INPUT]
    return [*both, ("plant.h", plant.h, 1), ("plant.h_x", plant.h_x, 1)]


def blame(error: Exception, functions: Iterable[Suspect]) -> FlowError:
    """Return what to say of a model that failed with ``error``: the first of its functions that fails alone."""
    import numba  # noqa: PLC0415 - it takes a second to load, and most who import the law compile no model

    vector, omitted, returned = numba.float64[::1], numba.types.Omitted, []
    for name, function, count in functions:
        if function is None:
            continue
        try:
            alone, _ = snapshot(function, INFINITE)
            defaults = [parameter.default for parameter in inspect.signature(alone.py_func).parameters.values()][count:]
            alone.compile((*(vector,) * count, *map(omitted, defaults)))
        except Exception as found:  # noqa: BLE001 - numba raises what it likes, not its own errors alone
            return FlowError(f"{name}: {complaint(found, function)}")
        returned.append(f"{name} returns {alone.nopython_signatures[0].return_type}")
    last = complaint(error, blame).partition(": ")[2]
    return FlowError(f"plant: numba cannot compile its functions together ({', '.join(returned)}): {last}")
