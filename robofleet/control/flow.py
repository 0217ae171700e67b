"""The Newton-Raphson flow: u' = alpha (dg/du)^-1 (r(t+T) - g(x, u))  (eq. 14), for any plant (eqs 8, 9).

With x and r held, the error e = r - g obeys e' = -alpha e along the flow whatever g is. So one control step goes the
fraction ``integrator_gain`` of a Newton step: ``exact`` is the flow's own solution where g is affine in u, and the
paper's forward Euler overshoots for alpha * step > 1 and diverges for 2.

The point of the platoon is the plant f(x, u) = u, h(x) = x: g = x + T u (eq. 30), dg/du = T, so that the flow is
u' = (alpha / T) (r(t+T) - x - T u)  (eq. 31), which :func:`point_update` steps in closed form.

Offset-free (``offset_free``): a constant disturbance w of the state equation leaves an error in the paper's law,
T w for the point. Here w is estimated from what the last step should have done: with Phi(x, u; w) the model's step,
w <- w + c (x - Phi(x_before, u_before; w)) / step, c = 1 - exp(-step / T), and g is predicted with f + w.
- The offset vanishes: at rest w is at rest, so Phi(x_s, u_s; w) = x_s, that is f(x_s, u_s) + w = 0. Then the
  prediction stands still, g = h(x_s) = y_s; and u at rest with dg/du nonsingular means g = r. So y_s = r.
- Stability: on a plant x' = f(x, u) + w that the model knows, x - Phi is step (w - w_estimate) to first order in the
  step, whatever u does: the estimate is a first-order filter with time constant T that the loop does not feed. The
  loop is the paper's, driven by a decaying signal; its region of stability is the same. (An output disturbance from
  the prediction made T ago would put a delay T into the loop.)
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robofleet.control.arrays import all_finite, compiled, copy, finite
from robofleet.control.blame import Suspect, blame, plant_functions
from robofleet.control.flow_settings import (
    FlowError,
    FlowSettings,
    Integrator,
    Limits,
    check_shape,
    vector,
    warnings_of,
)
from robofleet.control.flow_step import Slot, Status, compile_step, layout
from robofleet.control.margins import Margins, SampledLoop, slopes
from robofleet.control.prediction import MAX_STEPS, Plant
from robofleet.control.sensitivity import difference_jacobian
from robofleet.core.arrays import Array
from robofleet.core.errors import UnknownMeaningError
from robofleet.core.kernels import kernel

__all__ = [
    "FlowError", "FlowSettings", "Integrator", "MemorylessFlow", "NewtonRaphsonFlow", "Plant",
    "integrator_gain", "point_update",
]  # fmt: skip


def integrator_gain(alpha: float, step: float, integrator: Integrator) -> float:
    """Return the fraction of the way to the flow's fixed point that u goes in one step.

    With r and x held over the step eq. 31 is linear in u: its exact solution goes 1 - exp(-alpha step) of the way and
    never overshoots; forward Euler, the paper's, goes alpha step, rings above 1 and diverges above 2.
    alpha [1/s], step [s].
    """
    return -math.expm1(-alpha * step) if integrator == "exact" else alpha * step


@kernel
def point_update(u: float, x: float, r: float, horizon: float, gain: float) -> float:
    """Return u after one step of eq. 31, for one coordinate. x, r [m], u [m/s], horizon T [s]; r is r(t+T)."""
    return u + gain * ((r - x) / horizon - u)


class NewtonRaphsonFlow:
    """The controller of one plant.

    Attributes:
        plant: The plant.
        settings: The parameters of the law.
        warnings: What is unwise in them, in plain words.
        memory: State of the compiled step; its layout is internal.
        compiled_step: The compiled step; internal.
    """

    def __init__(
        self, plant: Plant, settings: FlowSettings, u0: ArrayLike, *, suspects: Iterable[Suspect] | None = None
    ) -> None:
        """Check and compile.

        Args:
            plant: State equation and output.
            settings: The parameters of the law.
            u0: The first input (m,).
            suspects: The functions that a complaint may name, where they are not the plant's own.

        Raises:
            FlowError: The message names the argument that is wrong.
        """
        self.plant, self.settings = plant, settings
        u0 = vector("u0", u0, plant.m)
        if not np.isfinite(u0).all():
            raise FlowError(f"u0: expected finite numbers, got {u0.tolist()}")
        self.warnings = warnings_of(plant, settings, u0)
        whole, part = _whole_steps(settings.delay, settings.step)
        self._places = layout(plant.n, plant.m, whole + 2)
        self.memory = np.zeros(self._places["history"].stop)  # of the compiled step, places as in ``layout``
        self._u, self._y = self._view("u"), self._view("y")
        self._history = self._view("history").reshape(-1, plant.m)
        self._x_shape, self._r_shape = (plant.n,), (plant.m,)
        self._fill(whole, part)
        self.applied(u0)
        self._history[:] = self._u
        self.compiled_step = _ready(plant, settings, plant_functions(plant) if suspects is None else suspects)

    @property
    def u(self) -> Array:
        """The input (m,) as last updated or applied."""
        return self._u.copy()

    @property
    def control_error(self) -> float:
        """|r - g| before the last update, in the output's units."""
        return float(self.memory[Slot.ERROR])

    @property
    def prediction(self) -> Array:
        """g (m,) of the last update: the output at t + delay + T if u had been held."""
        return self._y.copy()

    @property
    def prediction_steps(self) -> int:
        """How many prediction steps the last update took."""
        return int(self.memory[Slot.USED])

    @property
    def disturbance(self) -> Array:
        """The estimate of w (n,) in x' = f(x, u) + w."""
        return self._view("w").copy()

    def update(self, x: Array, r: Array) -> Array:
        """Make one control step.

        Args:
            x: The state (n,), measured now.
            r: The reference r(t + delay + T) (m,).

        Returns:
            The input u (m,).

        Raises:
            FlowError: A shape or a number cannot be used. u stays as it was.
        """
        try:
            if x.shape != self._x_shape or r.shape != self._r_shape:
                raise FlowError(self._misshapen(x, r))
            status = self.compiled_step(x, r, self.memory)
        except (AttributeError, TypeError):
            x, r = vector("x", x, self.plant.n), vector("r", r, self.plant.m)
            status = self.compiled_step(x, r, self.memory)
        if status:
            self.memory[Slot.PRIMED] = 0.0
            raise FlowError(self.explain(Status(status), x, r))
        return self._u.copy()

    def applied(self, u: ArrayLike) -> None:
        """Take what the actuators will really do instead of the last input: the flow goes on from there.

        Args:
            u: The applied input (m,).

        Raises:
            FlowError: A shape or a number cannot be used.
        """
        u = vector("u", u, self.plant.m)
        if not np.isfinite(u).all():
            raise FlowError(f"u: expected finite numbers, got {u.tolist()}")
        self._u[:] = u
        self._history[-1] = self._u

    def loop(self, x: ArrayLike, u: ArrayLike) -> SampledLoop:
        """Return the loop of the flow and its plant, linearised about a state at which the flow holds an input.

        The controller is the compiled step itself, by differences, without its limits. The linearisation is that of
        the whole motion where the plant's Jacobians do not change along it: at rest, and where a vehicle drives
        straight. Elsewhere it is that of the instant.

        Args:
            x: The state (n,).
            u: The input (m,) that acts there.

        Returns:
            The loop, whose ``margins`` says what it bears.

        Raises:
            FlowError: A shape or a number cannot be used, or the flow cannot step there.
        """
        plant, s = self.plant, self.settings
        x, u = vector("x", x, plant.n), vector("u", u, plant.m)
        A, B = slopes(lambda at: plant.f(at, u), x), slopes(lambda at: plant.f(x, at), u)
        memory, places = self.memory.copy(), self._places
        memory[places["lower"]], memory[places["upper"]] = -np.inf, np.inf
        memory[places["w"]], memory[places["before"]] = 0.0, x - s.step * plant.f(x, u)
        memory[Slot.PRIMED] = s.offset_free
        memory[places["history"]] = np.tile(u, len(self._history))
        names = [*(["before", "w"] if s.offset_free else []), "history"]
        kept = np.concatenate([np.arange(places[name].start, places[name].stop) for name in names])

        def after(state: Array, measured: Array, reference: Array) -> Array:
            changed: Array = memory.copy()
            changed[kept] = state
            changed[places["u"]] = state[-plant.m :]
            if status := self.compiled_step(measured, reference, changed):
                self.memory[[Slot.FOUND, Slot.USED]] = changed[[Slot.FOUND, Slot.USED]]
                raise FlowError(self.explain(Status(status), measured, reference))
            memory[places["y"]] = changed[places["y"]]
            return np.asarray(changed[kept])

        state = memory[kept]
        after(state, x, np.zeros(plant.m))
        reached = memory[places["y"]].copy()  # the reference with which the flow holds u
        F, G = slopes(lambda c: after(c, x, reached), state), slopes(lambda y: after(state, y, reached), x)
        return SampledLoop(A, B, F, G, np.eye(len(kept))[-plant.m :], s.step, s.delay)

    def margins(self, x: ArrayLike, u: ArrayLike) -> Margins:
        """Return how much delay, lag and wrong input gain the loop bears that the flow does not know of.

        Args:
            x: The state (n,), as in ``loop``.
            u: The input (m,) that acts there.

        Returns:
            The margins, each alone.

        Raises:
            FlowError: As ``loop``.
        """
        return self.loop(x, u).margins()

    def _view(self, name: str) -> Array:
        return self.memory[self._places[name]]

    def _fill(self, whole: int, part: float) -> None:
        s, numbers = self.settings, self.memory
        numbers[Slot.GAIN] = integrator_gain(s.alpha, s.step, s.integrator)
        numbers[Slot.HORIZON], numbers[Slot.STEP] = s.horizon, s.step
        numbers[Slot.STEPS] = s.prediction_steps or 0
        numbers[Slot.FEWEST] = 50 if s.predictor == "euler" else 5
        numbers[Slot.EULER] = s.predictor == "euler"
        numbers[Slot.DISTURBANCE_GAIN] = -math.expm1(-s.step / s.horizon) if s.offset_free else 0.0
        numbers[Slot.WHOLE], numbers[Slot.PART] = whole, part
        numbers[Slot.CONDITION] = s.max_condition
        self._view("lower")[:] = -np.inf if s.lower is None else s.lower
        self._view("upper")[:] = np.inf if s.upper is None else s.upper

    def _misshapen(self, x: Array, r: Array) -> str:
        name, a, n = ("x", x, self.plant.n) if x.shape != self._x_shape else ("r", r, self.plant.m)
        return f"{name}: expected shape ({n},), got {a.shape}"

    def explain(self, status: Status, x: Array, r: Array) -> str:
        """Return in words why a step gave no input.

        Args:
            status: What the compiled step returned.
            x: The state (n,) of that step.
            r: The reference (m,) of that step.

        Returns:
            A line with the numbers that are wrong.
        """
        found, used = float(self.memory[Slot.FOUND]), self.prediction_steps
        at = f"at x = {x.tolist()}, u = {self._u.tolist()}"
        return {
            Status.STATE: f"x[{found:.0f}] is not finite: x = {x.tolist()}",
            Status.REFERENCE: f"r[{found:.0f}] is not finite: r = {r.tolist()}",
            Status.RATE: f"the fastest eigenvalue of f_x, {found:.3g} 1/s, asks for more than {MAX_STEPS} steps {at}",
            Status.STEPS: f"prediction_steps: {used} are too few for the fastest eigenvalue, {found:.0f} needed {at}",
            Status.PREDICTION: f"the prediction is not finite in step {found:.0f} of {used} {at}",
            Status.SINGULAR: f"dg/du is singular or nearly so: condition number {found:.3g}, "
            f"max_condition is {self.settings.max_condition:.3g} {at}",
            Status.DELAY: f"the state rolled forward over the delay is not finite {at}",
            Status.FINE: "",
        }[status]


class MemorylessFlow:
    """The flow on y = g(u) (eqs 1, 2, 6): u' = alpha (dg/du)^-1 (r(t) - g(u)); alpha = 1 is eq. 2.

    It is :class:`NewtonRaphsonFlow` with a prediction that needs neither state nor horizon.
    """

    def __init__(
        self, g: Callable[[Array], Array], m: int, alpha: float, step: float, u0: ArrayLike,
        *, g_u: Callable[[Array], Array] | None = None, integrator: Integrator = "exact",
        lower: Limits | None = None, upper: Limits | None = None,
    ) -> None:  # fmt: skip
        """Check and compile.

        Args:
            g: The plant's output: u (m,) -> y (m,), for numba to compile.
            m: Number of inputs and of outputs.
            alpha: Speed-up [1/s].
            step: Control step [s].
            u0: The first input (m,).
            g_u: dg/du: u (m,) -> (m, m), for numba to compile. None: central differences.
            integrator: How the flow is stepped: by its exact solution, or by forward Euler.
            lower: Least u (m).
            upper: Greatest u (m).

        Raises:
            FlowError: The message names the argument that is wrong.
        """
        settings = FlowSettings(alpha, 1.0, step, integrator, prediction_steps=1, lower=lower, upper=upper)
        for name, function, expected in (("g", g, (m,)), ("g_u", g_u, (m, m))):
            check_shape(name, function, (vector("u0", u0, m),), expected)
        plant = _memoryless_plant(g, m, g_u)
        self._flow = NewtonRaphsonFlow(plant, settings, u0, suspects=(("g", g, 1), ("g_u", g_u, 1)))
        self._no_state = np.zeros(1)

    def update(self, r: Array) -> Array:
        """Make one control step.

        Args:
            r: The reference r(t) (m,).

        Returns:
            The input u (m,).

        Raises:
            FlowError: A shape or a number cannot be used.
        """
        return self._flow.update(self._no_state, r)

    @property
    def control_error(self) -> float:
        """|r - g(u)| before the last update."""
        return self._flow.control_error


def _memoryless_plant(g: Callable[[Array], Array], m: int, g_u: Callable[[Array], Array] | None) -> Plant:
    compiled_g = compiled(g)
    jacobian = difference_jacobian(compiled(lambda u, x: compiled_g(u)))
    if g_u is not None:
        analytic = compiled(g_u)
        jacobian = compiled(lambda u, x: analytic(u))

    def predict(x: Array, u: Array, T: float, steps: int, y: Array, dg: Array) -> int:
        jac = jacobian(u, x)
        copy(y, compiled_g(u))
        for i in range(m):
            copy(dg[i], jac[i])
        return 0 if finite(y) and all_finite(dg) else 1

    return Plant(
        f=lambda x, u: np.zeros(1), h=lambda x: np.zeros(m), n=1, m=m, fastest_rate=lambda x, u: 0.0, fused=predict
    )


def _ready(plant: Plant, settings: FlowSettings, suspects: Iterable[Suspect]) -> Any:
    """Return the compiled step of a plant, called once."""
    by_hand = plant.fused is not None and settings.predictor == "rk4" and not settings.offset_free
    try:
        step = compile_step(plant, by_hand)
    except UnknownMeaningError as error:
        raise FlowError(f"plant: {error}") from error
    if not step.signatures:
        nothing = np.zeros(layout(plant.n, plant.m, 2)["history"].stop)
        try:
            step(np.full(plant.n, np.nan), np.zeros(plant.m), nothing)
        except Exception as error:
            raise blame(error, suspects) from error
        step.disable_compile()
    return step


def _whole_steps(delay: float, step: float) -> tuple[int, float]:
    """Split a delay [s] into whole control steps and a rest [s]."""
    whole = math.floor(delay / step + 1e-9)
    rest = delay - whole * step
    return whole, rest if rest > 1e-9 * step else 0.0
