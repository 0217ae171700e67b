"""A lens fitted to views of a board: robust bundle adjustment, and how certain every parameter is.

Unknown are the lens (P values: focal lengths, centre, distortion) and each view's pose (rotation vector and
translation, board to camera). The poses are eliminated view by view (Schur complement), so that a view is a P x P
matrix of information: what remains when a view is left out, or would come with another one, is a sum. Weights are
Huber's, on the distance of a corner. A weak prior (any lens that could be) keeps undetermined values finite;
what it weighs is far below a pixel's noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from robofleet.calibration.lens.board import BoardView
from robofleet.calibration.lens.projection import Lens, cost
from robofleet.core.arrays import Array
from robofleet.tracking.camera import Lens as Kind

_EVEN, _DECENTRED = ((2, 0.5), (4, 0.25), (6, 0.125), (8, 0.0625)), ((1, 0.05), (3, 0.05))
_BELOW = ((2, 0.3), (4, 0.15), (6, 0.075))  # of a denominator, which must keep far from 0 inside the image
_SHARES = {  # of each coefficient: power of a ray's slope (or angle), and its share's prior at the image's corner
    "pinhole": (*_EVEN[:2], *_DECENTRED[:1] * 2, _EVEN[2], *_BELOW, *_DECENTRED * 2),
    "fisheye": _EVEN,
}
_PRIOR_FOCAL = 0.5  # standard deviation, of the start's
_PRIOR_TILT = 0.015  # [rad]: a camera for a ceiling has no sensor that is tilted on purpose
_PRIOR_CENTRE = 0.1  # of the image's size
_HUBER = 3.0  # [standard deviations of a coordinate]
_FOCAL_STARTS = (0.4, 0.6, 0.9, 1.4, 2.2, 4.0)  # [image widths]
_START_VIEWS = 8  # that choose among them
_STEPS = 60


class Prior(NamedTuple):
    """Any lens that could be: what is known before a view is seen."""

    values: Array  # (P,)
    information: Array  # (P,), the inverse of each value's variance


@dataclass(frozen=True)
class Fit:
    """A lens, the V views' poses, and what is known of both."""

    lens: Lens
    views: tuple[BoardView, ...]
    poses: Array  # (V, 6)
    residuals: tuple[Array, ...]  # V of (M, 2) [px], projected minus found
    roots: Array  # (V, P, P): R of each view's Jacobian by the lens, poses eliminated; R^T R is its information
    rests: Array  # (V, P) [px]: its weighted residuals along R's rows; R^T of them is its pull on the lens
    prior: "Prior"
    noise_px: float  # standard deviation of a coordinate, robust

    @property
    def information(self) -> Array:
        """Return what is known of the lens (P, P), prior included, poses eliminated [1 / px^2 of noise]."""
        prior = self.noise_px**2 * np.diag(self.prior.information)
        return np.asarray(np.einsum("vkp,vkq->pq", self.roots, self.roots) + prior)

    @property
    def covariance(self) -> Array:
        """Return the lens's covariance (P, P): the Jacobian's, with the robust noise."""
        return self.noise_px**2 * inverse(self.information)

    @property
    def typical_px(self) -> Array:
        """Return by how much most of each view's corners miss (V,) [px]."""
        return np.array([typical(r) for r in self.residuals])

    @property
    def surprise(self) -> Array:
        """Return how hard each view (V,) pulls on the lens, against what noise would do: 1 on average.

        A view whose corners fit, but only because the others gave way or its pose did, shows here: the pull's square
        in terms of its covariance, a chi-square over P. One view alone leaves most of a rich lens open, so that its
        information has no inverse that a computer could find. Along the rows of R none is needed: there noise has the
        same variance in all directions, of which the fit has taken the share R S^-1 R^T, with S the information of
        all views.
        """
        surprises = [rest @ unexplained for rest, unexplained in zip(self.rests, self._unexplained(), strict=True)]
        return np.array(surprises) / (self.noise_px**2 * len(self.lens.values))

    @property
    def leaving_out(self) -> Array:
        """Return how the lens (V, P) changes when a view is left out, to first order."""
        known = inverse(self.information)
        return np.array([-known @ R.T @ e for R, e in zip(self.roots, self._unexplained(), strict=True)])

    @property
    def jackknife(self) -> Array:
        """Return the covariance (P, P) that the views tell by leaving out each one: also of errors that they share."""
        changes = self.leaving_out
        count = len(changes)
        centred = changes - changes.mean(axis=0)
        return np.asarray(centred.T @ centred * (count - 1) / count)

    def _unexplained(self) -> list[Array]:
        """Return each view's rests (P,) [px] against the lens of the others: (I - R S^-1 R^T)^-1 of its own."""
        known, identity = inverse(self.information), np.eye(len(self.lens.values))
        return [np.linalg.solve(identity - R @ known @ R.T, e) for R, e in zip(self.roots, self.rests, strict=True)]

    def without(self, left_out: Sequence[int]) -> "Fit":
        kept = [k for k in range(len(self.views)) if k not in left_out]
        return _adjusted(self.lens, tuple(self.views[k] for k in kept), self.poses[kept], self.prior)


def fit(kind: Kind, coefficients: int, size: tuple[int, int], views: Sequence[BoardView]) -> Fit:
    views = tuple(views)
    few, starts = views[:: -(-len(views) // _START_VIEWS)], []
    for scale in _FOCAL_STARTS:
        f = scale * size[0]
        values = np.array([f, f, (size[0] - 1) / 2, (size[1] - 1) / 2, *[0.0] * coefficients])
        lens = Lens(kind, size, values)
        starts.append((sum(cost(lens.project(v.points, lens.pose(v))[0] - v.pixels) for v in few), scale, lens))
    lens = min(starts, key=lambda start: start[:2])[2]
    first = _adjusted(lens, views, np.array([lens.pose(view) for view in views]), _prior(lens, lens.values[0]))
    again = np.array([first.lens.pose(view) for view in views])  # some may have started on the wrong one of two
    return _adjusted(first.lens, views, again, _prior(lens, first.lens.values[0]))


def typical(residuals: Array) -> float:
    """Return the median distance of residuals (N, 2): a few bad corners do not make a bad view."""
    return float(np.median(np.linalg.norm(residuals, axis=1)))


def inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix that may be all but singular: large there, never infinite."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(scale, scale))


def view_information(J_lens: Array, J_pose: Array) -> Array:
    """Return what corners (M, 2, P), (M, 2, 6) tell of the lens when their view's pose is unknown (P, P)."""
    A, B = J_lens.reshape(-1, J_lens.shape[2]), J_pose.reshape(-1, 6)
    return np.asarray(A.T @ A - A.T @ B @ np.linalg.solve(B.T @ B, B.T @ A))


def _prior(start: Lens, focal: float) -> Prior:
    """Return what any lens could be, about one without distortion; ``focal``: its length, roughly [px]."""
    width, height = start.size
    corner = float(np.hypot(width, height)) / 2 / focal
    shares = [share * corner**-power for power, share in _SHARES[start.kind]]
    sigma = [*[_PRIOR_FOCAL * focal] * 2, _PRIOR_CENTRE * width, _PRIOR_CENTRE * height, *shares, *[_PRIOR_TILT] * 2]
    return Prior(start.values, np.array(sigma[: len(start.values)]) ** -2.0)


class _Blocks(NamedTuple):
    lens: Array  # (P, P)
    both: Array  # (P, 6)
    pose: Array  # (6, 6)
    pull_lens: Array  # (P,): minus half the gradient
    pull_pose: Array  # (6,)


def _adjusted(lens: Lens, views: tuple[BoardView, ...], poses: Array, prior: Prior) -> Fit:
    """Return the fit that Levenberg and Marquardt's steps end at; weights and noise follow the residuals."""
    damping = 1e-3
    residuals = _residuals(lens, views, poses)
    for _ in range(_STEPS):
        noise = _noise(residuals)
        weights = [_weights(r, noise) for r in residuals]
        blocks = [_blocks(lens, *parts) for parts in zip(views, poses, residuals, weights, strict=True)]
        known = noise**2 * prior.information
        before = _weighted(residuals, weights) + float(known @ (lens.values - prior.values) ** 2)
        while damping < 1e12:
            step, steps = _step(blocks, known, known * (prior.values - lens.values), damping)
            tried = replace(lens, values=lens.values + step)
            moved = _residuals(tried, views, poses + steps)
            after = _weighted(moved, weights) + float(known @ (tried.values - prior.values) ** 2)
            if after <= before:
                break
            damping *= 10.0
        else:
            break
        lens, poses, residuals, damping = tried, poses + steps, moved, max(damping / 10.0, 1e-9)
        if before - after <= 1e-9 * before and abs(_noise(residuals) - noise) <= 1e-4 * noise:
            break
    return _fit_of(lens, views, poses, residuals, prior)


def _fit_of(lens: Lens, views: tuple[BoardView, ...], poses: Array, residuals: list[Array], prior: Prior) -> Fit:
    scale = _noise(residuals)
    weights = [_weights(r, scale) for r in residuals]
    roots, rests = zip(*(_root(lens, *p) for p in zip(views, poses, residuals, weights, strict=True)), strict=True)
    free = 2.0 * sum(float(w.sum()) for w in weights) - 6 * len(views) - len(lens.values)
    noise = np.sqrt(_weighted(residuals, weights) / max(free, 1.0))
    return Fit(lens, views, poses, tuple(residuals), np.array(roots), np.array(rests), prior, float(noise))


def _rows(lens: Lens, view: BoardView, pose: Array, residuals: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return a view's weighted Jacobians (2M, P), (2M, 6), and what is to be explained (2M,)."""
    _, J_lens, J_pose = lens.project(view.points, pose)
    root = np.sqrt(weights)[:, None, None]
    A, B = (root * J_lens).reshape(-1, len(lens.values)), (root * J_pose).reshape(-1, 6)
    return A, B, -(root[..., 0] * residuals).ravel()


def _root(lens: Lens, view: BoardView, pose: Array, residuals: Array, weights: Array) -> tuple[Array, Array]:
    """Return R (P, P) of a view's Jacobian by the lens, its pose eliminated, and the residuals along its rows (P,)."""
    A, B, r = _rows(lens, view, pose, residuals, weights)
    count = A.shape[1]
    triangle = np.zeros((6 + count, 7 + count))
    found = np.linalg.qr(np.column_stack([B, A, r]), mode="r")[: 6 + count]
    triangle[: len(found)] = found
    return triangle[6:, 6:-1], triangle[6:, -1]


def _blocks(lens: Lens, view: BoardView, pose: Array, residuals: Array, weights: Array) -> _Blocks:
    A, B, r = _rows(lens, view, pose, residuals, weights)
    return _Blocks(A.T @ A, A.T @ B, B.T @ B, A.T @ r, B.T @ r)


def _reduced(blocks: _Blocks, damping: float) -> tuple[Array, Array]:
    """Return a view's information and pull on the lens, its pose eliminated."""
    damped = blocks.pose + damping * np.diag(np.diag(blocks.pose))
    solved = np.linalg.solve(damped, np.column_stack([blocks.both.T, blocks.pull_pose]))
    return blocks.lens - blocks.both @ solved[:, :-1], blocks.pull_lens - blocks.both @ solved[:, -1]


def _step(blocks: list[_Blocks], prior: Array, pull_prior: Array, damping: float) -> tuple[Array, Array]:
    """Return the damped step of the lens (P,) and of the poses (V, 6)."""
    reduced = [_reduced(block, damping) for block in blocks]
    whole = np.sum([information for information, _ in reduced], axis=0) + np.diag(prior)
    whole += damping * np.diag(np.sum([np.diag(block.lens) for block in blocks], axis=0))
    step = inverse(whole) @ (np.sum([pull for _, pull in reduced], axis=0) + pull_prior)
    steps = [
        np.linalg.solve(block.pose + damping * np.diag(np.diag(block.pose)), block.pull_pose - block.both.T @ step)
        for block in blocks
    ]
    return step, np.array(steps)


def _residuals(lens: Lens, views: Sequence[BoardView], poses: Array) -> list[Array]:
    return [lens.project(view.points, pose)[0] - view.pixels for view, pose in zip(views, poses, strict=True)]


def _noise(residuals: list[Array]) -> float:
    """Return the standard deviation of a coordinate that most residuals have [px]."""
    return max(1.4826 * float(np.median(np.abs(np.concatenate(residuals)))), 1e-6)


def _weights(residuals: Array, noise: float) -> Array:
    return np.asarray(np.minimum(1.0, _HUBER * noise / np.maximum(np.linalg.norm(residuals, axis=1), 1e-12)))


def _weighted(residuals: list[Array], weights: list[Array]) -> float:
    cost = sum(float((w[:, None] * r * r).sum()) for r, w in zip(residuals, weights, strict=True))
    return cost if np.isfinite(cost) else np.inf
