"""Least squares where the light is not what the fit expects: soft shadows and their edges, glare, partial covers.

A tag's square is cut into blocks. Each block has a brightness and a contrast of its own, random effects of a variance
that the residuals give; and a weight by Student's t-distribution: a block through which an edge of light goes leaves
more than the others, and counts less.
"""

import numpy as np

from robofleet.core.arrays import Array

_LIGHT = [0, 3]  # the coefficients of brightness and contrast
_FREEDOM = 4.0  # degrees, of Student's distribution
_MOST_WEIGHT = 1.25 * _FREEDOM  # over the same: blocks up to a variance twice that of most have a weight of 1
_ROUNDS = 5
_MEDIAN = 0.455  # of a chi-square of one degree
_FEWEST = 6.0  # pixels in a block
_USED = 4.0  # blocks that the pose explains
_EVEN = 1e-9  # variance of the light of blocks that are lit alike
_LEAST = 1e-9


def solve(blocks: Array) -> tuple[Array, Array]:
    """Solve the products (B, P + 1, P + 1) of B blocks, of P coefficients and what is left of the grey. The first
    coefficient is 1, the fourth the contrast's.

    Return the P values, and their covariance (P, P) by how much the blocks differ: so it holds whatever the noise's
    correlation is; infinite where too few blocks are seen.
    """
    blocks = blocks[blocks[:, 0, 0] >= _FEWEST]
    if len(blocks) <= blocks.shape[1]:
        return np.zeros(blocks.shape[1] - 1), np.full((blocks.shape[1] - 1,) * 2, np.inf)
    n, pixels, weight = blocks.shape[1] - 1, blocks[:, 0, 0], np.ones(len(blocks))
    to_light, spread = blocks[:, :, _LIGHT], _EVEN  # variance of a block's light over a pixel's
    values, inverse, score = np.zeros(n), np.zeros((n, n)), np.zeros((len(blocks), n))
    for _ in range(_ROUNDS):
        gain = np.linalg.inv(np.eye(len(_LIGHT)) / spread + to_light[:, _LIGHT])
        own = blocks - to_light @ gain @ to_light.transpose(0, 2, 1)  # what the light of the block does not explain
        total = (weight[:, None, None] * own).sum(0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(total)[:n], _LEAST))
        inverse = np.linalg.inv(total[:n, :n] * np.outer(scale, scale) + _LEAST * np.eye(n)) * np.outer(scale, scale)
        values = inverse @ total[:n, n]
        left = np.append(-values, 1.0)
        mean, squares, own_squares = blocks[:, 0] @ left / pixels, (blocks @ left) @ left, (own @ left) @ left
        variance = float(np.median(np.maximum(squares - pixels * mean**2, _LEAST) / (pixels - 1.0)))
        between = np.median(mean**2) / _MEDIAN - variance / np.median(pixels)
        spread = max(float(between) / variance, _EVEN)
        weight = np.minimum(_MOST_WEIGHT / (_FREEDOM + own_squares / (pixels * variance)), 1.0)
        score = weight[:, None] * (own[:, :n] @ left)
    return values, inverse @ (score.T @ score) @ inverse * len(blocks) / max(len(blocks) - _USED, 1.0)
