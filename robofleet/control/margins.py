"""How much delay, lag and wrong input gain a sampled loop bears that its controller does not know of.

The loop is linearised about its reference: the plant is x' = A x + B u, the controller c+ = F c + G x, u = E c+. Once
a control step h the controller is given the state x (n,), and its input acts a time D later and is held for h. D, h and
the lag may be any times: between two instants the plant is integrated exactly, so that only rounding is left beside
the linearisation. The loop is stable while the spectral radius of the map over one step, of the state, the inputs
under way and the controller's own state, is below one (Astrom, Wittenmark: Computer-Controlled Systems, 3.2). Modes
that no input reaches and that keep their value, for example a constant disturbance, lie on the circle and count as
stable.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robofleet.core.arrays import Array

_ON_THE_CIRCLE = 1e-6  # how far rounding and differences move a mode that keeps its value
_DIFFERENCE = 1e-5
_SCAN = 1.2  # a margin is sought in steps of this ratio, so that an island of stability beyond it does not count
_EXACT = 1e-5  # relative width at which bisection ends
MOST_DELAY, MOST_LAG = 100, 1000  # control steps that a margin is sought up to: each of a delay is a state
_MOST_GAIN = 100.0


@dataclass(frozen=True)
class Margins:
    """How much a loop bears beyond what its controller knows, each alone.

    A delay is sought up to ``MOST_DELAY`` control steps, a lag up to ``MOST_LAG``, a gain up to a hundredfold; beyond,
    it is infinite.

    Attributes:
        spectral_radius: Of one control step, with nothing unknown.
        delay: Delay of the input [s].
        lag: Time constant of a first-order lag of the input [s]; it adds to the known one.
        gain: Relative errors of the input's gain: the least, at most 0, and the greatest, at least 0. For a robot this
            is the error of both wheels' radius.
    """

    spectral_radius: float
    delay: float
    lag: float
    gain: tuple[float, float]


@dataclass(frozen=True)
class SampledLoop:
    """A linear plant in continuous time and a linear controller in discrete time.

    Attributes:
        A: df/dx (n, n) [1/s].
        B: df/du (n, m).
        F: What the controller's state (k, k) does to itself in a step.
        G: What the measured state does to it (k, n).
        E: The input that comes of its new state (m, k).
        step: Control step h [s].
        delay: Time D from the measurement of x until u acts, as the controller knows it [s].
        lag: Time constant with which the input follows, as the controller knows it [s].
    """

    A: Array
    B: Array
    F: Array
    G: Array
    E: Array
    step: float
    delay: float = 0.0
    lag: float = 0.0

    def spectral_radius(self, delay: float = 0.0, lag: float = 0.0, gain: float = 0.0) -> float:
        """Return the spectral radius of one control step with an unknown delay [s], lag [s] and relative gain error."""
        return float(np.abs(np.linalg.eigvals(self.step_matrix(delay, lag, gain))).max())

    def step_matrix(self, delay: float = 0.0, lag: float = 0.0, gain: float = 0.0) -> Array:
        """Return the map of (state, lagged input, inputs under way from oldest to newest, controller) over a step."""
        whole, part = divmod(self.delay + delay, self.step)
        under_way, m, k = int(whole) + 1, len(self.E), len(self.F)
        motion = Motion(self.A, (1.0 + gain) * self.B, self.lag + lag)
        n = motion.states
        oldest, inputs, control = n, slice(n, n + under_way * m), slice(n + under_way * m, n + under_way * m + k)
        now = np.eye(n + under_way * m + k)
        controlled = self.F @ now[control] + self.G @ now[: len(self.A)]
        sent = np.concatenate([now[inputs], self.E @ controlled])  # the newest may act in this step already
        moved = motion.after(now[:n], now[oldest : oldest + m], part)
        moved = motion.after(moved, sent[m : 2 * m], self.step - part)
        return np.concatenate([moved, sent[m:], controlled])

    def margins(self) -> Margins:
        """How much the loop bears; nothing where it is unstable by itself."""
        radius = self.spectral_radius()
        if not _stable(radius):
            return Margins(radius, 0.0, 0.0, (0.0, 0.0))
        return Margins(
            radius,
            _least(lambda d: self.spectral_radius(delay=d), self.step / 4.0, MOST_DELAY * self.step),
            _least(lambda t: self.spectral_radius(lag=t), self.step / 4.0, MOST_LAG * self.step),
            (
                -min(1.0, _least(lambda g: self.spectral_radius(gain=-g), 1e-3, 1.0)),
                _least(lambda g: self.spectral_radius(gain=g), 1e-3, _MOST_GAIN),
            ),
        )


class Motion:
    """How a linear plant whose input follows with a lag moves while the input is held."""

    def __init__(self, A: Array, B: Array, lag: float) -> None:
        """A (n, n), B (n, m); lag [s], 0: the input follows at once, and the plant has no state for it."""
        n, m = B.shape
        self.states = n + m if lag > 0.0 else n
        self._rate = np.zeros((self.states + m, self.states + m))
        self._rate[:n, :n], self._rate[:n, n : n + m] = A, B
        if lag > 0.0:
            self._rate[n : n + m, n : n + m], self._rate[n : n + m, n + m :] = -np.eye(m) / lag, np.eye(m) / lag

    def after(self, state: Array, held: Array, duration: float) -> Array:
        """Return the state (n, or n + m with the lagged input; ...) after ``duration`` [s] of one input (m, ...)."""
        both: Array = _exponential(self._rate * duration)[: self.states]
        return both[:, : self.states] @ state + both[:, self.states :] @ held


def slopes(function: Callable[[Array], Array], at: Array) -> Array:
    """Return the Jacobian (m, n) of a function at a point (n,) by central differences, right to about 1e-9."""
    columns = []
    for k in range(len(at)):
        moved, step = np.array([at, at]), _DIFFERENCE * (1.0 + abs(at[k]))
        moved[:, k] += (step, -step)
        columns.append((function(moved[0]) - function(moved[1])) / (moved[0, k] - moved[1, k]))
    return np.stack(columns, axis=1)


def _stable(radius: float) -> bool:
    return radius < 1.0 + _ON_THE_CIRCLE


def _least(radius: Callable[[float], float], first: float, last: float) -> float:
    """Return the least value above 0 at which the spectral radius reaches one; infinite: none up to ``last``."""
    stable, unstable = 0.0, first
    while _stable(radius(unstable)):
        if unstable >= last:
            return math.inf
        stable, unstable = unstable, min(last, max(_SCAN * unstable, unstable + first))
    while unstable - stable > _EXACT * unstable:
        middle = (stable + unstable) / 2.0
        if _stable(radius(middle)):
            stable = middle
        else:
            unstable = middle
    return unstable


def _exponential(a: Array) -> Array:
    """Return exp(a) (k, k): the series of a part of it that is small, squared again and again."""
    halvings = max(0, math.ceil(math.log2(max(float(np.abs(a).sum(axis=1).max()), 1e-300)))) + 1
    part = a / 2.0**halvings
    term = total = np.eye(len(a))
    for order in range(1, 15):
        term = term @ part / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total
