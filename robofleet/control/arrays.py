"""How the flow's functions are compiled, and what they do with small arrays without allocating."""

from collections.abc import Callable
from typing import Any

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import INFINITE, infinite_kernel

cached = infinite_kernel


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a part of a model; a division by zero is an infinity, which is then reported."""
    import numba  # noqa: PLC0415 - it takes a second to load, and a process that only reads a configuration has none

    return numba.njit(**INFINITE)(function)


@cached
def finite(a: Array) -> bool:
    """Return whether every number of an array (k,) is finite."""
    total = 0.0
    for value in a:
        total += value * 0.0
    return total == 0.0


@cached
def all_finite(a: Array) -> bool:
    """Return whether every number of a matrix is finite."""
    total = 0.0
    for row in range(len(a)):
        total += 0.0 if finite(a[row]) else 1.0
    return total == 0.0


@cached
def copy(to: Array, source: Array) -> None:
    """Write ``source`` (k,) over ``to``; without the checks of ``to[:] = source``, whose messages compile slowly."""
    for i in range(len(to)):
        to[i] = source[i]


@cached
def first_not_finite(a: Array) -> int:
    """Return the index of the first number that is not finite, -1 if there is none."""
    for k in range(len(a)):
        if not np.isfinite(a[k]):
            return k
    return -1


@cached
def invert(a: Array, scratch: Array) -> float:
    """Invert ``a`` (m, m) in place and return its condition number, infinite where it is singular.

    Rows and columns are scaled to size 1 first, so that the condition number does not depend on the units. It is
    the one of the norm of the largest sum of a column. ``scratch`` (3 m,) is overwritten.
    """
    m = len(a)
    row, column, order = scratch[:m], scratch[m : 2 * m], scratch[2 * m :]
    if not (_scale(a, row) and _scale(a.T, column)):
        return np.inf
    before = _norm(a)
    if not _gauss_jordan(a, order):
        return np.inf
    condition = before * _norm(a)
    for i in range(m):
        for j in range(m):
            a[i, j] /= column[i] * row[j]
    return condition


@cached
def _scale(a: Array, size: Array) -> bool:
    """Divide each row by the size of its largest number; False where a row is zero."""
    for i in range(len(a)):
        size[i] = 0.0
        for j in range(len(a)):
            size[i] = max(size[i], abs(a[i, j]))
        if size[i] == 0.0:
            return False
        for j in range(len(a)):
            a[i, j] /= size[i]
    return True


@cached
def _norm(a: Array) -> float:
    largest = 0.0
    for j in range(len(a)):
        total = 0.0
        for i in range(len(a)):
            total += abs(a[i, j])
        largest = max(largest, total)
    return largest


@cached
def _gauss_jordan(a: Array, order: Array) -> bool:
    """Invert in place with row pivoting; False where a pivot is zero."""
    m = len(a)
    for k in range(m):
        pivot = k
        for i in range(k + 1, m):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        order[k] = pivot
        if a[pivot, k] == 0.0:
            return False
        for j in range(m):
            a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
        scale = 1.0 / a[k, k]
        a[k, k] = 1.0
        for j in range(m):
            a[k, j] *= scale
        for i in range(m):
            if i != k:
                factor = a[i, k]
                a[i, k] = 0.0
                for j in range(m):
                    a[i, j] -= factor * a[k, j]
    for k in range(m - 1, -1, -1):
        pivot = int(order[k])
        for i in range(m):
            a[i, k], a[i, pivot] = a[i, pivot], a[i, k]
    return True
