"""One step of the Newton-Raphson flow for any plant, compiled around the plant's own functions.

Everything that the step reads and writes lies in one array, ``memory``: a call costs what its arguments cost.
"""

from enum import IntEnum
from typing import Any

import numpy as np

from robofleet.control.arrays import cached, compiled, copy, finite, first_not_finite, invert
from robofleet.control.prediction import (
    EULER_CHOICE,
    EULER_LIMIT,
    MAX_STEPS,
    RK4_CHOICE,
    RK4_LIMIT,
    Compiled,
    Plant,
    needed_steps,
    plant_parts,
)
from robofleet.core.arrays import Array
from robofleet.core.kernels import model


class Status(IntEnum):
    """How an update ended; ``FOUND`` holds the number that goes with it."""

    FINE = 0
    STATE = 1  # not finite: element FOUND
    REFERENCE = 2  # not finite: element FOUND
    RATE = 3  # the fastest eigenvalue FOUND [1/s] is not finite, or needs too many steps
    STEPS = 4  # prediction_steps is too small: FOUND needed
    PREDICTION = 5  # not finite in prediction step FOUND
    SINGULAR = 6  # dg/du has condition number FOUND
    DELAY = 7  # the roll-forward over the delay is not finite


class Slot(IntEnum):
    """Numbers at the head of ``memory``."""

    GAIN = 0  # fraction of the way to the fixed point in one step
    HORIZON = 1  # T [s]
    STEP = 2  # control step [s]
    STEPS = 3  # prediction steps; 0: from the fastest eigenvalue
    FEWEST = 4  # the least chosen then
    EULER = 5  # 1: the predictor is forward Euler
    DISTURBANCE_GAIN = 6  # of the filter that estimates w; 0: none
    WHOLE = 7  # delay = WHOLE * step + PART
    PART = 8  # [s]
    CONDITION = 9  # largest condition number of dg/du
    PRIMED = 10  # 1: x of the last update is known
    ERROR = 11  # |r - g| before the update
    FOUND = 12
    USED = 13  # prediction steps of the last update


def layout(n: int, m: int, inputs: int) -> dict[str, slice]:
    """Return where each array lies in ``memory``; ``history`` holds the last ``inputs`` inputs, oldest first."""
    sizes = {"numbers": len(Slot), "u": m, "y": m, "e": m, "lower": m, "upper": m, "dg": m * m, "x": n,
             "before": n, "w": n, "scratch": 3 * m, "history": inputs * m}  # fmt: skip
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


@cached
def _advance(u: Array, e: Array, inverse: Array, memory: Array, lower: Array, upper: Array, history: Array) -> None:
    """Go the way of eq. 14 from u, inside the limits; the history moves on by one input."""
    for k in range(len(history) - 1):
        copy(history[k], history[k + 1])
    for i in range(len(u)):
        change = 0.0
        for j in range(len(u)):
            change += inverse[i, j] * e[j]
        u[i] = min(max(u[i] + memory[Slot.GAIN] * change, lower[i]), upper[i])
    copy(history[-1], u)


def compile_step(plant: Plant, by_hand: bool) -> Any:
    """Return ``step(x, r, memory) -> Status``; compiled at its first call. by_hand: predict by ``plant.fused``."""
    parts = plant_parts(plant)
    predict = _adaptive(parts, compiled(plant.fused) if by_hand and plant.fused else None)
    acting = _acting(parts)
    names = layout(plant.n, plant.m, 0)
    U, Y, E, LOW, HIGH, DG, X, BEFORE, W, SCRATCH = (names[name].start for name in list(names)[1:-1])
    HISTORY, n, m = names["history"].start, plant.n, plant.m

    @compiled
    def step(x: Array, r: Array, memory: Array) -> int:
        u, y, e, dg = memory[U : U + m], memory[Y : Y + m], memory[E : E + m], memory[DG : DG + m * m].reshape(m, m)
        w, history = memory[W : W + n], memory[HISTORY:].reshape(-1, m)
        if not (finite(x) and finite(r)):
            memory[Slot.FOUND] = max(first_not_finite(x), first_not_finite(r))
            return Status.REFERENCE.value if finite(x) else Status.STATE.value
        now = acting(x, history, w, memory[BEFORE : BEFORE + n], memory[X : X + n], memory)
        if not finite(now):
            return Status.DELAY.value
        status: int = predict(now, u, w, y, dg, memory)
        if status != Status.FINE.value:
            return status
        squared = 0.0
        for i in range(m):
            e[i] = r[i] - y[i]
            squared += e[i] * e[i]
        memory[Slot.ERROR] = np.sqrt(squared)
        condition = invert(dg, memory[SCRATCH : SCRATCH + 3 * m])
        if not condition <= memory[Slot.CONDITION]:
            memory[Slot.FOUND] = condition
            return Status.SINGULAR.value
        lower, upper = memory[LOW : LOW + m], memory[HIGH : HIGH + m]
        _advance(u, e, dg, memory, lower, upper, history)
        return Status.FINE.value

    return model(step)


def _adaptive(parts: Compiled, hand: Any) -> Any:
    """Return the prediction with its number of steps chosen, or checked, by the fastest eigenvalue."""
    fastest_rate = parts.fastest_rate
    if hand is None:
        rollouts = parts.predict
    else:

        @compiled
        def rollouts(x: Array, u: Array, w: Array, T: float, steps: int, euler: bool, y: Array, dg: Array) -> int:
            found: int = hand(x, u, T, steps, y, dg)
            return found

    @compiled
    def predict(x: Array, u: Array, w: Array, y: Array, dg: Array, memory: Array) -> int:
        T, fixed, euler = memory[Slot.HORIZON], int(memory[Slot.STEPS]), memory[Slot.EULER] != 0.0
        rate = fastest_rate(x, u)
        memory[Slot.FOUND] = rate
        if not rate < np.inf:
            return Status.RATE.value
        needed = needed_steps(rate, T, EULER_LIMIT if euler else RK4_LIMIT)
        steps = fixed
        if fixed == 0:
            steps = max(needed_steps(rate, T, EULER_CHOICE if euler else RK4_CHOICE), int(memory[Slot.FEWEST]))
        elif needed > fixed:
            memory[Slot.FOUND], memory[Slot.USED] = needed, fixed
            return Status.STEPS.value
        while steps <= MAX_STEPS:
            memory[Slot.USED] = steps
            found = rollouts(x, u, w, T, steps, euler, y, dg)
            if found == 0:
                return Status.FINE.value
            memory[Slot.FOUND] = abs(found)
            if found > 0 or fixed > 0:
                return Status.PREDICTION.value if found > 0 else Status.STEPS.value
            steps = -found  # a faster eigenvalue was met on the way
        memory[Slot.FOUND] = rate
        return Status.RATE.value

    return predict


def _acting(parts: Compiled) -> Any:
    """Return the state at the moment when the new input acts; estimate w (n,) on the way."""
    rollout = parts.rollout

    @compiled
    def through(now: Array, history: Array, oldest: int, w: Array, first: float, step: float, end: float) -> None:
        """Roll through inputs that acted one after the other, from ``oldest`` on, until ``end`` [s]."""
        start, row = 0.0, oldest
        while start < end - 1e-9 * step:
            duration = min(first if row == oldest else step, end - start)
            if duration > 0.0:
                rollout(now, history[row], w, duration, now)
            start += duration
            row += 1

    @compiled
    def acting(x: Array, history: Array, w: Array, before: Array, now: Array, memory: Array) -> Array:
        whole, part, step = int(memory[Slot.WHOLE]), memory[Slot.PART], memory[Slot.STEP]
        oldest = len(history) - whole - 1  # what still acts at the moment of the measurement, for ``part``
        if memory[Slot.DISTURBANCE_GAIN] != 0.0:
            if memory[Slot.PRIMED] != 0.0:
                copy(now, before)
                through(now, history, oldest - 1, w, part, step, step)
                for i in range(len(x)):
                    w[i] += memory[Slot.DISTURBANCE_GAIN] * (x[i] - now[i]) / step
            copy(before, x)
            memory[Slot.PRIMED] = 1.0
        copy(now, x)
        through(now, history, oldest, w, part, step, part + whole * step)
        return now

    return acting
