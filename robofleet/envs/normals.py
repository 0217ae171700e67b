"""Normal numbers that streams draw side by side, without a branch or a call, so that vector instructions draw them.

A stream is a xoshiro256+ (Blackman and Vigna, 2018). Two normal numbers are made of one of its numbers by Box and
Muller's transform: 31 bits decide how far they lie from 0, at most 6.7, and 33 in which direction.
"""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.kernels import infinite_kernel

STREAMS = 32

_A, _B, _C, _D = range(0, 4 * STREAMS, STREAMS)  # where the rows of a state begin
_LOW, _HALF, _17, _45, _19 = (np.uint64(n) for n in ((1 << 32) - 1, 32, 17, 45, 19))
_TOP = np.uint64(1 << 63)
_MANTISSA_BITS, _MANTISSA = np.uint64(52), np.uint64((1 << 52) - 1)  # of a float
_BESIDE = np.uint64(0x4330000000000000)  # of 2^52: in its mantissa a whole number is itself
_ROOT, _TO_ROOT = np.uint64(0x3FE6A09E00000000), np.uint64(0x3FF0000000000000 - 0x3FE6A09E00000000)  # of sqrt(1 / 2)


def streams(rng: np.random.Generator) -> NDArray[np.uint64]:
    """Return new streams, as ``draw`` takes them."""
    return rng.integers(0, 1 << 64, 4 * STREAMS, np.uint64)


@infinite_kernel
def draw(state: NDArray[np.uint64], normals: Array) -> None:
    """Draw two numbers from each stream: ``normals`` (2 STREAMS,)."""
    for i in range(STREAMS):
        a, b, c, d = state[_A + i], state[_B + i], state[_C + i], state[_D + i]
        drawn, c, d = a + d, c ^ a, d ^ b
        state[_A + i], state[_B + i] = a ^ d, b ^ c
        state[_C + i], state[_D + i] = c ^ (b << _17), (d << _45) | (d >> _19)
        far = math.sqrt(-2.0 * _log((_real((drawn & ~_TOP) >> _HALF) + 0.5) * 2.0**-31))
        far = -far if drawn & _TOP else far
        r = (_real(drawn & _LOW) - (2.0**31 - 0.5)) * (math.pi * 2.0**-32)  # within a right angle
        z = r * r
        s = 1.0 + z * (-1 / 6 + z * (1 / 120 + z * (-1 / 5040 + z * (1 / 362880 + z * (-1 / 39916800)))))
        c_ = 1.0 + z * (
            -1 / 2 + z * (1 / 24 + z * (-1 / 720 + z * (1 / 40320 + z * (-1 / 3628800 + z * (1 / 479001600)))))
        )
        normals[i], normals[STREAMS + i] = far * r * s, far * c_


@infinite_kernel
def _log(x: float) -> float:
    """Return the natural logarithm of a number that is not tiny, within 1e-9."""
    bits = np.float64(x).view(np.uint64) + _TO_ROOT
    exponent = _real(bits >> _MANTISSA_BITS) - 1023.0
    mantissa = np.uint64((bits & _MANTISSA) + _ROOT).view(np.float64)  # in sqrt(1 / 2) to sqrt(2)
    z = (mantissa - 1.0) / (mantissa + 1.0)
    q = z * z
    series = 1.0 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9))))
    return exponent * math.log(2.0) + 2.0 * z * series


@infinite_kernel
def _real(whole: np.uint64) -> float:
    """Return a whole number below 2^52 as a float: vector instructions cannot convert 64 bits."""
    return np.uint64(whole | _BESIDE).view(np.float64) - 2.0**52
