"""The parameters of the Newton-Raphson flow, and what is wrong or unwise in them."""

import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robofleet.control.prediction import Plant
from robofleet.core.arrays import Array
from robofleet.core.errors import RobofleetError

Integrator = Literal["exact", "euler"]
Limits = tuple[float, ...]

WISE_ALPHA_T = 3.0  # the double integrator needs alpha T > 1, the bicycle about 1.6
UNSTABLE_EULER = 2.0  # alpha * step


class FlowError(RobofleetError, ValueError):
    """Raised where the flow cannot use a setting, a plant, a state or a prediction. The message names it."""


@dataclass(frozen=True)
class FlowSettings:
    """Parameters of the law.

    Attributes:
        alpha: Speed-up [1/s].
        horizon: Prediction horizon T [s].
        step: Control step [s].
        integrator: How the flow is stepped: by its exact solution, or by the paper's forward Euler.
        predictor: How the plant is predicted.
        prediction_steps: Steps of a prediction. None: from the fastest eigenvalue of f_x, anew at every update.
        lower: Least u (m). The flow's own state stays inside (no wind-up).
        upper: Greatest u (m).
        delay: Time from the measurement of x until u acts [s].
        offset_free: Whether a constant disturbance is estimated and predicted with.
        max_condition: Greatest condition number of dg/du with rows and columns scaled to 1. Above it the update is
            refused.
    """

    alpha: float
    horizon: float
    step: float
    integrator: Integrator = "exact"
    predictor: Literal["rk4", "euler"] = "rk4"
    prediction_steps: int | None = None
    lower: Limits | None = None
    upper: Limits | None = None
    delay: float = 0.0
    offset_free: bool = False
    max_condition: float = 1e6


def warnings_of(plant: Plant, settings: FlowSettings, u0: Array) -> list[str]:
    """Return what is unwise; FlowError with the first thing that is wrong."""
    for fault in _faults(plant, settings):
        raise FlowError(fault)
    check_shapes(plant, np.ones(plant.n), u0)
    found = []
    alpha_t, alpha_step = settings.alpha * settings.horizon, settings.alpha * settings.step
    if alpha_t < WISE_ALPHA_T:
        found.append(
            f"alpha * horizon is {alpha_t:.3g}, less than {WISE_ALPHA_T:g}: the loop may be unstable (T_alpha); "
            f"an alpha of {WISE_ALPHA_T / settings.horizon:.3g} 1/s or more is safe for common plants"
        )
    if settings.integrator == "euler" and alpha_step > 1.0:
        found.append(f"alpha * step is {alpha_step:.3g}, more than 1: forward Euler rings; integrator exact does not")
    return found


def check_shapes(plant: Plant, x: Array, u: Array) -> None:
    """Call the plant's functions as plain Python at one point; FlowError names the one of a wrong shape."""
    n, m = plant.n, plant.m
    calls: dict[str, tuple[Callable[..., Any] | None, tuple[Array, ...], tuple[int, ...]]] = {
        "f": (plant.f, (x, u), (n,)),
        "h": (plant.h, (x,), (m,)),
        "f_x": (plant.f_x, (x, u), (n, n)),
        "f_u": (plant.f_u, (x, u), (n, m)),
        "h_x": (plant.h_x, (x,), (m, n)),
    }
    for name, (function, arguments, expected) in calls.items():
        check_shape(f"plant.{name}", function, arguments, expected)


def check_shape(
    name: str, function: Callable[..., Any] | None, arguments: tuple[Array, ...], expected: tuple[int, ...]
) -> None:
    """Call one function; FlowError if its array has another shape. None, or undefined at this point: no complaint."""
    if function is None:
        return
    if not inspect.isfunction(getattr(function, "py_func", function)):
        raise FlowError(f"{name}: expected a Python function, got {function!r}")
    try:
        with np.errstate(all="ignore"):
            got = np.shape(function(*(a.copy() for a in arguments)))
    except ArithmeticError:
        return
    except Exception as error:
        raised = f"{type(error).__name__}: {error}"
        raise FlowError(f"{name}: fails for arrays of {[len(a) for a in arguments]} numbers: {raised}") from error
    if got != expected:
        raise FlowError(f"{name}: expected an array of shape {expected}, got {got}")


def vector(name: str, value: ArrayLike, size: int) -> Array:
    """Return a fresh array (size,); FlowError names the argument."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise FlowError(f"{name}: expected {size} numbers, got {value!r}") from None
    if array.shape != (size,):
        raise FlowError(f"{name}: expected shape ({size},), got {array.shape}")
    return array


def _faults(plant: Plant, s: FlowSettings) -> Iterator[str]:
    for name in ("n", "m"):
        if not isinstance(getattr(plant, name), int) or getattr(plant, name) < 1:
            yield f"plant.{name}: expected a whole number of at least 1, got {getattr(plant, name)!r}"
    if (plant.f_x is None) != (plant.f_u is None):
        yield "plant.f_x and plant.f_u: give both or neither"
    for name in ("alpha", "horizon", "step", "max_condition"):
        value = getattr(s, name)
        if not _is_number(value) or not 0.0 < value < math.inf:
            yield f"{name}: expected a finite number above 0, got {value!r}"
    if not _is_number(s.delay) or not 0.0 <= s.delay < math.inf:
        yield f"delay: expected a finite number of at least 0 s, got {s.delay!r}"
    steps = s.prediction_steps
    if steps is not None and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
        yield f"prediction_steps: expected a whole number of at least 1 or None, got {steps!r}"
    for name, allowed in (("integrator", ("exact", "euler")), ("predictor", ("rk4", "euler"))):
        if getattr(s, name) not in allowed:
            yield f"{name}: expected {' or '.join(allowed)}, got {getattr(s, name)!r}"
    yield from _limit_faults(plant.m, s)
    if s.integrator == "euler" and s.alpha * s.step >= UNSTABLE_EULER:
        yield (
            f"alpha * step is {s.alpha * s.step:.3g}: forward Euler diverges from {UNSTABLE_EULER:g} on; "
            f"take a step below {UNSTABLE_EULER / s.alpha:.3g} s, or integrator exact"
        )


def _limit_faults(m: int, s: FlowSettings) -> Iterator[str]:
    for name in ("lower", "upper"):
        limits = getattr(s, name)
        if limits is not None and (len(limits) != m or not all(_is_number(v) and not math.isnan(v) for v in limits)):
            yield f"{name}: expected {m} numbers, one an input, got {limits!r}"
    for k, (low, high) in enumerate(zip(s.lower or (), s.upper or (), strict=False)):
        if low > high:
            yield f"lower[{k}] is above upper[{k}]: {low:g} > {high:g}"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
