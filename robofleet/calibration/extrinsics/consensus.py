"""Which marks agree on the camera's pose: finds wrongly surveyed marks, so that they do not bias the fit.

Every four marks give a pose; the one that most marks fit best begins (least trimmed squares). From there on marks join
that are where the fit expects them, the nearest first, and leave when they are not; what is expected counts the survey,
the pixels and the fit's own uncertainty. If the survey's error is not stated it is estimated from the marks
that agree, and the test allows for that (F in place of chi-square): few marks then accuse only what is far off.
"""

import itertools
import math
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import chdtrc

from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.placing import Lens, Placement, on_plane, place
from robofleet.calibration.extrinsics.survey import LEAST, on_one_line
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array, Flags

_FALSE_ALARM = 0.01  # probability that a mark of a survey without faults is accused
_ENOUGH_MARKS = 7  # so many that agree accuse one mark, not two
_TIE = 0.01  # another choice of marks that fits by so much chance is as good
_MOST_FOURS = 500
_SEED = 1  # for the fours of a large survey: same input, same result


class Agreement(NamedTuple):
    """The marks that agree, and the pose that they give."""

    placement: Placement  # of the marks inside, in their order
    inside: Flags  # (N,)
    error: Array  # (N, 2) [m] of each mark for a fit without it, seen minus surveyed; NaN: cannot be said
    covariance: Array  # (N, 2, 2)


def agree(lens: Lens, marks: Marks, survey_m: float | None) -> Agreement:
    refuse_undetermined(marks)
    agreement = _begin(lens, marks, survey_m)
    visited = {agreement.inside.tobytes()}
    while (inside := _changed(agreement, survey_m)).tobytes() not in visited:
        visited.add(inside.tobytes())
        try:
            agreement = _agreement(lens, marks, inside, agreement.placement.T_world_camera, survey_m)
        except np.linalg.LinAlgError:  # what remained would not determine a pose
            break
    if 2 * agreement.inside.sum() <= len(marks):
        names = ", ".join(marks.names)
        raise CalibrationError(f"{names}: no more than half of these agree on a pose: check the survey and the lens")
    _refuse_ties(lens, marks, agreement, survey_m)
    return agreement


def refuse_undetermined(marks: Marks) -> None:
    if len(marks) < LEAST:
        seen = f": {', '.join(marks.names)}" if len(marks) else ""
        raise CalibrationError(
            f"{len(marks)} surveyed marks are in sight{seen}; {LEAST} or more are needed: lay more, or clear the view"
        )
    if on_one_line(marks.points):
        names = ", ".join(marks.names)
        raise CalibrationError(f"{names} lie on one line, around which the camera could turn: lay some beside it")


def chance(distance: float, freedom: int) -> float:
    """Return with which probability a draw from the chi-square distribution is larger."""
    return float(chdtrc(freedom, distance))


def distances(error: Array, covariance: Array) -> Array:
    """Return squared distances (N,) in standard deviations; NaN where the error is."""
    known = np.isfinite(error[:, 0])
    squares = np.full(len(error), np.nan)
    solved = np.linalg.solve(covariance[known], error[known][:, :, None])[:, :, 0]
    squares[known] = (error[known] * solved).sum(1)
    return squares


def limit(probability: float, freedom: int | None) -> float:
    """Return what a squared distance in the plane exceeds with a probability.

    ``freedom``: of the estimate that its unit comes from; None: the unit is known.
    """
    if freedom is None:
        return -2.0 * math.log(probability)
    return freedom * (probability ** (-2.0 / freedom) - 1.0) if freedom > 0 else math.inf


def _begin(lens: Lens, marks: Marks, survey_m: float | None) -> Agreement:
    """Return the agreement of the marks nearest to the best of many poses by four."""
    n = len(marks)
    fours = list(itertools.islice(itertools.combinations(range(n), LEAST), _MOST_FOURS + 1))
    if len(fours) > _MOST_FOURS:
        rng = np.random.default_rng(_SEED)
        fours = [tuple(rng.permutation(n)[:LEAST].tolist()) for _ in range(_MOST_FOURS)]
    slopes, heights = lens.slopes(marks.pixels), marks.points[:, 2]
    count = max(LEAST, n - max(1, (n - LEAST) // 2))
    best, best_T, nearest = math.inf, None, np.zeros(0, np.intp)
    for four in map(list, fours):
        for T in _poses(marks.points[four], slopes[four]):
            if T[2, 3] <= heights.max():
                continue
            off = ((on_plane(T, slopes, heights)[0] - marks.points[:, :2]) ** 2).sum(1)
            order = off.argsort()[:count]
            if off[order].sum() < best:
                best, best_T, nearest = off[order].sum(), T, order
    if best_T is None:
        raise CalibrationError("no pose above the floor shows the marks where they are: check the survey's axes, units")
    inside = np.zeros(n, np.bool_)
    inside[nearest] = True
    if on_one_line(marks.points[inside]):
        inside[:] = True
    return _agreement(lens, marks, inside, best_T, survey_m)


def _poses(points: Array, slopes: Array) -> list[Array]:
    """Return the cameras' poses (4, 4) that show points (4, 3) along rays; none if the four do not tell."""
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, slopes, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        return []
    poses = []
    for turn, shift in zip(turns, shifts, strict=True):
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(turn)[0].T
        T[:3, 3] = -T[:3, :3] @ shift.ravel()
        poses.append(T)
    return poses


def _agreement(lens: Lens, marks: Marks, inside: Flags, T: Array, survey_m: float | None) -> Agreement:
    """Fit the marks inside, and say what each mark is off by for a fit without it."""
    placement = place(lens, marks.chosen(inside), T, survey_m)
    error, covariance = placement.seen(marks)
    error[inside], covariance[inside] = placement.left_out, placement.left_out_covariance
    return Agreement(placement, inside, error, covariance)


def _changed(agreement: Agreement, survey_m: float | None) -> Flags:
    """Return the marks inside after those that fit best joined; when none fits, after the least fitting one left."""
    placement, inside, n = agreement.placement, agreement.inside.copy(), len(agreement.inside)
    squares = distances(agreement.error, agreement.covariance)
    leaving, joining = np.where(inside, squares, np.nan), np.where(inside, np.nan, squares)
    freedom: int | None = None
    if survey_m is None:
        freedom = placement.freedom
        # A mark's own error is part of the estimate of what is usual; and those outside were the largest.
        rest = np.maximum(placement.chi_square - leaving, 1e-9) / max(freedom - 2, 1)
        leaving = leaving / rest
        joining = joining * _trimmed(np.count_nonzero(inside) / n)
    share = _FALSE_ALARM / n
    own = limit(share, None if freedom is None else freedom - 2)
    fitting = np.count_nonzero(joining < limit(share, freedom))
    if fitting:  # the nearer half: with them, more is known of the others
        inside[joining.argsort()[: (fitting + 1) // 2]] = True
    elif np.count_nonzero(inside) > LEAST and np.nanmax(leaving, initial=-math.inf) > own:
        inside[np.nanargmax(leaving)] = False
    return inside


def _trimmed(part: float) -> float:
    """Return the variance of the innermost part of a normal distribution in the plane, over the whole one's."""
    return 1.0 if part >= 1.0 else 1.0 + (1.0 - part) * math.log(1.0 - part) / part


def _refuse_ties(lens: Lens, marks: Marks, agreement: Agreement, survey_m: float | None) -> None:
    """Raise CalibrationError if another mark may as well be the one that was surveyed wrongly."""
    placement, inside = agreement.placement, agreement.inside
    if np.count_nonzero(inside) >= _ENOUGH_MARKS:
        return
    for wrong, other in itertools.product(np.flatnonzero(~inside), np.flatnonzero(inside)):
        swapped = inside.copy()
        swapped[[wrong, other]] = True, False
        try:
            fit = place(lens, marks.chosen(swapped), placement.T_world_camera, survey_m)
        except np.linalg.LinAlgError:
            continue
        if survey_m is None:
            alike = (fit.survey_m / placement.survey_m) ** 2 < limit(_TIE, placement.freedom) / 2.0
        else:
            alike = chance(fit.chi_square, fit.freedom) > _TIE
        if alike:
            either = f"{marks.names[wrong]} or {marks.names[other]}"
            raise CalibrationError(f"{either} was surveyed wrongly; these marks do not tell which: survey both again")
