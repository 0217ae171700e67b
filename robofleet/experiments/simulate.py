"""The closed loop of a bicycle and the Newton-Raphson flow, in one compiled call.

Plant: RK4 with a fixed step. Controller: every ``control_step`` it is given the true state and steps once (the step
of ``control/flow.py``); its input is held between (zero-order hold) and acts a whole number of control steps later.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from robofleet.control.arrays import compiled
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant
from robofleet.control.flow_step import Slot, Status, layout
from robofleet.core.arrays import Array
from robofleet.core.errors import RobofleetError
from robofleet.core.kernels import model
from robofleet.experiments.curves import Reference

_LOST_M = 100.0  # a control error that is never made good
_LOST = -1


class DivergedError(RobofleetError, ValueError):
    """Raised where a loop meets a state, a prediction or a dg/du that it cannot use. The message says when."""


@dataclass(frozen=True)
class Loop:
    """How a drive is simulated [s]; all but the duration are whole multiples of ``plant_step``."""

    duration: float
    control_step: float
    plant_step: float
    computing_delay: float  # from the measurement to the moment when the input acts; multiples of control_step
    reference_lead: float = 0.0  # r(t + delay + T) is taken this much too far ahead


@dataclass(frozen=True)
class Drive:
    """One drive, at the K control instants."""

    t: Array  # (K,) [s]
    states: Array  # (K, 6) before the update
    inputs: Array  # (K, 2) as they act: a_l [m/s^2], delta_f [rad]
    control_error: Array  # (K,) |r - g| before the update [m]
    lateral: Array  # (K,) distance of the centre of gravity from the curve, + to its left [m]
    heading: Array  # (K,) heading minus the tangent at the nearest point [rad]
    along: Array  # (K,) arc length of that point [m]


def drive(
    plant: Plant, settings: FlowSettings, loop: Loop, reference: Reference, speed: float, start: Array | None = None,
    model: Plant | None = None,
) -> Drive:  # fmt: skip
    """Drive along a reference whose point moves at ``speed`` [m/s].

    ``start`` (6,): the first state; default: on the curve at s = 0, along it, at ``speed``. ``model``: what the flow
    takes the plant for; default: what it is.

    Raises:
        ValueError: the reference is too short.
        DivergedError: the loop diverged.
    """
    t: Array = loop.control_step * np.arange(round(loop.duration / loop.control_step), dtype=np.float64)
    r = reference.position(speed * (t + settings.delay + settings.horizon + loop.reference_lead))
    x = np.zeros(plant.n)
    x[:2], x[2], x[4] = reference.positions[0], speed, reference.headings[0]
    flow = NewtonRaphsonFlow(model or plant, settings, np.zeros(plant.m))
    states, inputs, error = _driven(plant, flow, loop, x if start is None else start, r, t)
    lateral, heading, along = reference.errors(states[:, :2], states[:, 4])
    return Drive(t, states, inputs, error, lateral, heading, along)


def _driven(
    plant: Plant, flow: NewtonRaphsonFlow, loop: Loop, start: Array, r: Array, t: Array
) -> tuple[Array, Array, Array]:
    """Return states (K, n), inputs (K, m), control errors (K,) of the closed loop."""
    delay = round(loop.computing_delay / loop.control_step)
    substeps = round(loop.control_step / loop.plant_step)
    states, inputs, error = np.empty((len(t), plant.n)), np.empty((len(t) + delay, plant.m)), np.empty(len(t))
    inputs[:delay] = flow.u
    run = _closed_loop(plant, flow.compiled_step)
    k, status = run(start, r, flow.memory, loop.control_step / substeps, substeps, delay, states, inputs, error)
    if status == _LOST:
        raise DivergedError(f"t = {t[k]:.2f} s: diverged, the control error is {error[k]:.3g} m")
    if status:
        raise DivergedError(f"t = {t[k]:.2f} s: {flow.explain(Status(status), states[k], r[k])}")
    return states, inputs[: len(t)], error


def _closed_loop(plant: Plant, step: Any) -> Any:
    """Return the compiled loop of a plant and its flow's step.

    It ends with (K, 0), or with (k, status of update k), or with (k, _LOST).
    """
    f = compiled(plant.f)
    error_slot, u_from = int(Slot.ERROR), layout(plant.n, plant.m, 0)["u"].start

    @compiled
    def advance(x: Array, u: Array, h: float, moved: Array) -> None:
        """One step of RK4, in place."""
        k1 = f(x, u)
        for i in range(len(x)):
            moved[i] = x[i] + 0.5 * h * k1[i]
        k2 = f(moved, u)
        for i in range(len(x)):
            moved[i] = x[i] + 0.5 * h * k2[i]
        k3 = f(moved, u)
        for i in range(len(x)):
            moved[i] = x[i] + h * k3[i]
        k4 = f(moved, u)
        for i in range(len(x)):
            x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])

    @compiled
    def run(
        start: Array, r: Array, memory: Array, h: float, substeps: int, delay: int,
        states: Array, inputs: Array, error: Array,
    ) -> tuple[int, int]:  # fmt: skip
        x, moved, m = start.copy(), np.empty_like(start), inputs.shape[1]
        for k in range(len(r)):
            states[k] = x
            status = step(x, r[k], memory)
            if status != 0:
                return k, status
            error[k] = memory[error_slot]
            if not error[k] < _LOST_M:
                return k, _LOST
            inputs[k + delay] = memory[u_from : u_from + m]
            u = inputs[k]
            for _ in range(substeps):
                advance(x, u, h, moved)
        return len(r), 0

    return model(run)
