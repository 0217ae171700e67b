"""Which of a user's functions numba cannot compile, when a model of them cannot be."""

import inspect
from collections.abc import Callable, Iterable
from typing import Any

from robofleet.control.flow_settings import FlowError
from robofleet.control.prediction import Plant
from robofleet.core.kernels import INFINITE, snapshot

_OF_STATE_AND_INPUT = ("f", "f_x", "f_u", "fastest_rate")

Suspect = tuple[str, Callable[..., Any] | None, int]  # name, function (None: not given), how many vectors it takes


def plant_functions(plant: Plant) -> list[Suspect]:
    """Return the functions of a plant that take vectors alone."""
    both: list[Suspect] = [(f"plant.{name}", getattr(plant, name), 2) for name in _OF_STATE_AND_INPUT]
    return [*both, ("plant.h", plant.h, 1), ("plant.h_x", plant.h_x, 1)]


def blame(error: Exception, functions: Iterable[Suspect]) -> FlowError:
    """Return what to say of a model that failed with ``error``: the first of its functions that fails alone."""
    import numba  # noqa: PLC0415 - it takes a second to load, and most who import the law compile no model

    from robofleet.core.kernels.complaint import complaint  # noqa: PLC0415

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
