"""Least squares where the light is not what the fit expects: soft shadows and their edges, glare, partial covers.

A tag's square is cut into blocks. Each block has a brightness and a contrast of its own, random effects of a variance
that the residuals give; and a weight by Student's t-distribution: a block through which an edge of light goes leaves
more than the others, and counts less.
"""

from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array

_LIGHT = [0, 3]  # the coefficients of brightness and contrast
_FREEDOM = 4.0  # degrees, of Student's distribution
_ROUNDS = 5
_MEDIAN = 0.455  # of a chi-square of one degree
_FEWEST = 6.0  # pixels in a block


class Solution(NamedTuple):
    """Least squares of P coefficients."""

    values: Array  # (P,)
    covariance: Array  # (P, P)
    robust: Array  # (P, P) the same by how much the blocks differ, whatever the noise's correlation is


def solve(blocks: Array) -> Solution:
    """Solve the products (B, P + 1, P + 1) of B blocks, of P coefficients and what is left of the grey; the first
    coefficient is 1."""
    blocks = blocks[blocks[:, 0, 0] >= _FEWEST]
    n, count = blocks.shape[1] - 1, blocks[:, 0, 0]
    weight = np.ones(len(blocks))
    light = np.zeros(2)  # variances of brightness and contrast over that of a pixel
    to_light = blocks[:, :, _LIGHT]
    within = to_light[:, _LIGHT, :]
    values = np.zeros(n)
    for _ in range(_ROUNDS):
        gain = np.linalg.inv(np.diag(1.0 / np.maximum(light, 1e-9)) + within)
        known = blocks - to_light @ gain @ to_light.transpose(0, 2, 1)
        total = np.einsum("b,bij->ij", weight, known)
        scale = np.sqrt(np.maximum(np.diag(total)[:n], 1e-12))
        inverse = np.linalg.inv(total[:n, :n] / np.outer(scale, scale) + 1e-9 * np.eye(n)) / np.outer(scale, scale)
        values = inverse @ total[:n, n]
        step = np.append(-values, 1.0)
        squares = np.einsum("i,bij,j->b", step, blocks, step)
        mean = blocks[:, 0] @ step / count
        spread = np.maximum(squares - count * mean**2, 1e-3) / (count - 1.0)
        variance = float(np.median(spread))
        between = max(float(np.median(mean**2)) / _MEDIAN - variance / float(np.median(count)), 0.0) / variance
        light = np.array([between, between])
        left = np.einsum("i,bij,j->b", step, known, step) / count
        weight = (_FREEDOM + 1.0) / (_FREEDOM + left / variance) * _FREEDOM / (_FREEDOM + 1.0) * 1.25
        weight = np.minimum(weight, 1.0)
    score = known[:, :n] @ step * weight[:, None]
    robust = inverse @ (score.T @ score) @ inverse * len(blocks) / (len(blocks) - 4.0)
    return Solution(values, variance * inverse, robust)
