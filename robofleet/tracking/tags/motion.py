"""How tags move from image to image: kernels over a tracker's arrays.

Of N tags: ``centre`` [m; world, x + iy], ``psi`` [rad], ``velocity`` in the tag's frame, forward + i left [m/s],
``omega`` [rad/s], ``row`` of the image in which it was [px] and ``measured_ns``. ``line_ns`` (2,): the image's middle
row, and a rolling shutter's time from row to row [ns].
"""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Complex, Indices
from robofleet.core.kernels import kernel


@kernel
def predict(
    index: Indices, exposure_ns: int, line_ns: Array, centre: Complex, psi: Array, velocity: Complex, omega: Array,
    row: Array, measured_ns: Indices,
) -> tuple[Complex, Array, Complex]:  # fmt: skip
    """Return centre, heading and velocity [m/s; world] of the tags ``index`` (M,), each on the arc of its last motion,
    when the row in which it was is exposed."""
    position, heading, way = (
        np.empty(len(index), np.complex128),
        np.empty(len(index)),
        np.empty(len(index), np.complex128),
    )
    for m in range(len(index)):
        i = index[m]
        t = (exposure_ns + _after_ns(row[i], line_ns) - measured_ns[i]) * 1e-9
        turn = omega[i] * t
        position[m] = centre[i] + velocity[i] * t * _chord(turn) * _turned(psi[i])
        heading[m] = psi[i] + turn
        way[m] = velocity[i] * _turned(heading[m])
    return position, heading, way


@kernel
def measure(
    index: Indices, exposure_ns: int, line_ns: Array, moving: NDArray[np.bool_], new_centre: Complex, new_psi: Array,
    new_row: Array, centre: Complex, psi: Array, velocity: Complex, omega: Array, row: Array, measured_ns: Indices,
) -> None:  # fmt: skip
    """Take new poses (M,) of the tags ``index``, and those of them that are ``moving`` (N,) have moved by that."""
    for m in range(len(index)):
        i = index[m]
        instant_ns = exposure_ns + _after_ns(new_row[m], line_ns)
        velocity[i], omega[i] = 0.0, 0.0
        if moving[i]:
            t = max((instant_ns - measured_ns[i]) * 1e-9, 1e-6)
            turn = _wrapped(new_psi[m] - psi[i])
            velocity[i] = (new_centre[m] - centre[i]) / _turned(psi[i]) / (t * _chord(turn))
            omega[i] = turn / t
        centre[i], psi[i], row[i], measured_ns[i] = new_centre[m], _wrapped(new_psi[m]), new_row[m], instant_ns


@kernel
def _after_ns(row: float, line_ns: Array) -> int:
    """Return how long after the middle row a row is exposed."""
    after_ns: int = round((row - line_ns[0]) * line_ns[1])
    return after_ns


@kernel
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def _turned(angle: float) -> complex:
    return complex(math.cos(angle), math.sin(angle))


@kernel
def _chord(turn: float) -> complex:
    """Return an arc's chord over its length: (e^(i turn) - 1) / (i turn), which is 1 where it does not turn."""
    half = 0.5 * turn
    return _turned(half) * (math.sin(half) / half if half != 0.0 else 1.0)


KERNELS = (predict, measure)  # that are called from Python
