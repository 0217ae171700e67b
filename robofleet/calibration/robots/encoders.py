"""What a robot's encoders count of its wheels' angles, against the angles of its model's wheels.

Each shot begins at a count of its own. In it a Kalman filter of each wheel carries along by how much the counted angle
differs from the model's: so each residual is the part of a counted angle that nothing before it explains. Its noise is
the rounding to whole counts, and that of the time stamp; the wander is that of a wheel against its command.
"""

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

_WHOLE_COUNTS = 0.02  # of a count
_FINE = 1e-3  # count of an encoder whose counts cannot be seen [rad]
_NOBODY = np.zeros((0, 2), dtype=np.bool_)


def counts(angles: Array) -> float:
    """Return one count of an encoder [rad], whose angles (E, 2) are whole counts; 0: they are not."""
    steps = np.abs(np.diff(angles, axis=0)).ravel()
    steps = steps[steps > 1e-9]
    if not len(steps):
        return 0.0
    numbers = np.round(steps / steps.min())
    count = float(steps @ numbers / (numbers @ numbers))
    return count if np.abs(steps - count * numbers).max() < _WHOLE_COUNTS * count else 0.0


class Encoders:
    """The encoders' angles (E, 2) [rad] of one recording at instants (E,) [s]; E = 0: the robot has none."""

    def __init__(self, at_s: Array, angles: Array, shot: NDArray[np.int64]) -> None:
        self.at_s, self.angles, self.shot = at_s, angles, shot
        self._variance = (counts(angles) or _FINE) ** 2 / 12.0
        self._begins = np.diff(shot, prepend=-1) != 0
        self.kept = np.ones(angles.shape, dtype=np.bool_)  # angles that are no outliers

    def residuals(
        self, turned: Array, scales: Array, stamp_s: float, wander: float, chosen: NDArray[np.bool_]
    ) -> tuple[Array, float]:
        """Return the whitened residuals (E, 2) of ``chosen`` instants (E,), 0 where there is none, and their
        log-determinant.

        Args:
            turned: The angles (E, 2) of the model's wheels [rad].
            scales: What each encoder counts of its wheel's angle (2,).
            stamp_s: Standard deviation of a time stamp [s].
            wander: Standard deviation of a wheel's angle against its command, after 1 rad [rad^0.5].
            chosen: Which instants (E,).
        """
        return self._filtered(turned, scales, stamp_s, wander, chosen, self.kept, np.inf, _NOBODY)

    def outliers(self, turned: Array, scales: Array, stamp_s: float, wander: float, gate: float) -> NDArray[np.bool_]:
        """Return which angles (E, 2) are further than so many standard deviations from what those before say."""
        found, everything = np.zeros(self.angles.shape, dtype=np.bool_), np.ones(self.angles.shape, dtype=np.bool_)
        self._filtered(turned, scales, stamp_s, wander, everything[:, 0], everything, gate, found)
        return found

    def _filtered(
        self, turned: Array, scales: Array, stamp_s: float, wander: float, chosen: NDArray[np.bool_],
        kept: NDArray[np.bool_], gate: float, outliers: NDArray[np.bool_],
    ) -> tuple[Array, float]:  # fmt: skip
        residuals = np.zeros(self.angles.shape)
        log_determinant = _filter(
            turned * scales, self.at_s, self.angles, self._variance, stamp_s, wander, self._begins, chosen,
            kept, residuals, gate, outliers,
        )  # fmt: skip
        return residuals, float(log_determinant)


@kernel
def _filter(  # type: ignore[no-untyped-def]
    expected, at_s, angles, variance, stamp_s, wander, begins, chosen, kept, residuals, gate, outliers
):
    """Carry along by how much each wheel's counted angle differs from the expected one; fill in whitened residuals.

    At ``begins``, and after what is not ``kept`` or an outlier, it begins anew: what was missed is not made up for. A
    wheel that stands in reality and in the model says nothing.
    """
    total = 0.0
    for side in range(angles.shape[1]):
        known, off, P = False, 0.0, 0.0
        for k in range(len(angles)):
            step = rate = 0.0
            if k > 0:
                step = abs(expected[k, side] - expected[k - 1, side])
                rate = step / max(at_s[k] - at_s[k - 1], 1e-9)
            R = variance + (rate * stamp_s) ** 2
            e = angles[k, side] - expected[k, side]
            if begins[k] or not known or not kept[k, side]:
                known, off, P = True, e, R
                continue
            if step == 0.0 and angles[k, side] == angles[k - 1, side]:
                continue
            P += wander * wander * step
            S = P + R
            w = (e - off) / np.sqrt(S)
            if abs(w) > gate:
                outliers[k, side] = True
                off, P = e, R
                continue
            if chosen[k]:
                residuals[k, side] = w
                total += 0.5 * np.log(S)
            off += P / S * (e - off)
            P -= P / S * P
    return total
