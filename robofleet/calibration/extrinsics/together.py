"""Where several cameras hang: one adjustment of all of them to one survey.

A surveyed tag that two cameras see has one error of its survey, which both have in common. A tag that nobody surveyed
ties two cameras together, too: both see it at one place, wherever that is. So every mark has a place with a standard
deviation, the survey's or a metre, and the poses of all cameras are fitted at once, as ``placing`` fits one. What is
then known of one camera counts what the others may be off by.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.extrinsics.consensus import Agreement, agree
from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.placing import (
    LEAST_SURVEY_M,
    Lens,
    Placement,
    left_out,
    moved,
    noise,
    normal,
    on_plane,
)
from robofleet.calibration.extrinsics.survey import LEAST
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

_GAUSS_NEWTON_STEPS = 8
_TIED_M = 0.003  # standard deviation at first of a place that another camera saw
_UNSURVEYED_SIGMA_M = 1.0


class SurveyView(NamedTuple):
    """What one camera sees."""

    name: str
    lens: Lens
    marks: Marks  # those that nobody surveyed have NaN as x and y


def agree_together(views: Sequence[SurveyView], survey_m: float | None) -> list[Agreement]:
    """Return what the marks of each camera agree on, and the places of all cameras.

    CalibrationError where a camera cannot be placed: it sees too few marks that are surveyed, or that others see.
    """
    found = _begun(views, survey_m)
    placements = _place([view.lens for view in views], _used(views, found), [a.placement for a in found], survey_m)
    agreements = []
    for view, agreement, placement in zip(views, found, placements, strict=True):
        marks = _placed(view.marks, agreement.placement, known={})
        error, covariance = placement.seen(marks)
        error[agreement.inside], covariance[agreement.inside] = placement.left_out, placement.left_out_covariance
        open_ = np.isnan(view.marks.points[:, 0])
        error[open_], covariance[open_] = np.nan, np.nan
        agreements.append(Agreement(placement, agreement.inside, error, covariance))
    return agreements


def with_places(view: SurveyView, agreement: Agreement) -> Marks:
    """Return a camera's marks; those that nobody surveyed lie where the camera sees them."""
    return _placed(view.marks, agreement.placement, known={})


def _begun(views: Sequence[SurveyView], survey_m: float | None) -> list[Agreement]:
    """Place camera after camera: each by what was surveyed, and by what those before it saw."""
    found: dict[int, Agreement] = {}
    known: dict[str, Array] = {}
    while len(found) < len(views):
        left = [k for k in range(len(views)) if k not in found]
        each = {k: _known(views[k].marks, known) for k in left}
        best = max(left, key=lambda k: int(each[k].sum()))
        view, known_marks = views[best], each[best]
        if known_marks.sum() < LEAST:
            raise CalibrationError(
                f"{view.name}: sees {known_marks.sum()} tags that are surveyed or that a camera which is placed sees; "
                f"{LEAST} or more are needed: survey more there, or lay more where the views overlap"
            )
        if survey_m is None and known_marks.sum() == LEAST:
            raise CalibrationError(
                f"{view.name}: four marks do not tell how well they were surveyed: state it with --survey-mm"
            )
        marks = _placed(view.marks, None, known).chosen(known_marks)
        try:
            tied = bool(np.isnan(view.marks.points[known_marks, 0]).any())
            agreement = agree(view.lens, marks, max(survey_m or 0.0, _TIED_M) if tied else survey_m)
        except CalibrationError as refused:
            raise CalibrationError(tuple(f"{view.name}: {fault}" for fault in refused.faults)) from refused
        inside = known_marks.copy()
        inside[known_marks] = agreement.inside
        strangers = ~known_marks
        inside |= strangers  # seen by this camera first: they tie those that come after it
        found[best] = agreement._replace(inside=inside)
        placed = _placed(view.marks, agreement.placement, known)
        known |= {name: point for name, point in zip(placed.names, placed.points, strict=True) if name not in known}
    return [found[k] for k in range(len(views))]


def _known(marks: Marks, known: dict[str, Array]) -> NDArray[np.bool_]:
    surveyed = np.isfinite(marks.points[:, 0])
    return surveyed | np.array([name in known for name in marks.names], np.bool_)


def _placed(marks: Marks, placement: Placement | None, known: dict[str, Array]) -> Marks:
    points = marks.points.copy()
    for i in np.flatnonzero(np.isnan(points[:, 0])):
        if marks.names[i] in known:
            points[i] = known[marks.names[i]]
        elif placement is not None:
            slopes = placement.lens.slopes(marks.pixels[[i]])
            points[i, :2] = on_plane(placement.T_world_camera, slopes, points[[i], 2])[0][0]
    return replace(marks, points=points)


def _used(views: Sequence[SurveyView], found: Sequence[Agreement]) -> list[Marks]:
    return [view.marks.chosen(agreement.inside) for view, agreement in zip(views, found, strict=True)]


def _place(
    lenses: Sequence[Lens], marks: list[Marks], begun: Sequence[Placement], survey_m: float | None
) -> list[Placement]:
    """Fit all poses at once; ``survey_m`` None: estimated from what is left over."""
    cameras, ends = len(lenses), np.cumsum([2 * len(camera_marks) for camera_marks in marks])
    parts = [slice(end - 2 * len(camera_marks), end) for end, camera_marks in zip(ends, marks, strict=True)]
    names = [name for camera_marks in marks for name in camera_marks.names]
    open_ = np.concatenate([np.isnan(camera_marks.points[:, 0]) for camera_marks in marks])
    shared = np.array([[candidate == other for other in names] for candidate in names], np.float64)
    freedom = (
        2 * len(names)
        - 6 * cameras
        - 2 * len({name for name, camera_marks in zip(names, open_, strict=True) if camera_marks})
    )
    sigma = LEAST_SURVEY_M if survey_m is None else survey_m
    slopes = [lens.slopes(camera_marks.pixels) for lens, camera_marks in zip(lenses, marks, strict=True)]
    by_pixel = [lens.by_pixel(camera_marks.pixels) for lens, camera_marks in zip(lenses, marks, strict=True)]
    by_lens = [lens.by_lens(camera_marks.pixels) for lens, camera_marks in zip(lenses, marks, strict=True)]
    T = [placement.T_world_camera for placement in begun]
    surveyed = np.concatenate([camera_marks.points[:, :2] for camera_marks in marks])
    J, V, follows = np.zeros((ends[-1], 6 * cameras)), np.zeros((ends[-1], ends[-1])), [np.zeros(0)] * cameras
    r, P, weighted, covariance = (np.zeros(0),) * 4
    seen = surveyed
    for last in [False] * _GAUSS_NEWTON_STEPS + [True]:
        V[:] = np.kron(shared * np.where(open_, _UNSURVEYED_SIGMA_M, sigma) ** 2, np.eye(2))
        places = []
        for c, (camera_marks, part) in enumerate(zip(marks, parts, strict=True)):
            point, J_c, by_slope = on_plane(T[c], slopes[c], camera_marks.points[:, 2])
            follows[c] = by_slope @ by_lens[c]
            J[part, 6 * c : 6 * c + 6] = J_c.reshape(-1, 6)
            V[part, part] += noise(by_slope @ by_pixel[c], follows[c], camera_marks.sigma_px, 0.0, lenses[c].covariance)
            places.append(point)
        seen = np.concatenate(places)
        mean = (shared @ seen) / shared.sum(axis=1)[:, None]
        r = (np.where(open_[:, None], mean, surveyed) - seen).ravel()
        weighted, covariance, P = normal(J, V)
        if not last:
            change = (covariance @ (weighted.T @ r)).reshape(-1, 6)
            T = [moved(at, step) for at, step in zip(T, change, strict=True)]
            if survey_m is None:
                sigma = max(LEAST_SURVEY_M, sigma * math.sqrt(float(r @ P @ r) / freedom))
    off, off_covariance = left_out(P, r, np.zeros(len(names), np.bool_))
    off[open_], off_covariance[open_] = np.nan, np.nan
    found = []
    for c, (camera_marks, part, placement) in enumerate(zip(marks, parts, begun, strict=True)):
        rows, own = slice(part.start // 2, part.stop // 2), slice(6 * c, 6 * c + 6)
        found.append(replace(
            placement, T_world_camera=T[c], covariance=covariance[own, own], survey_m=sigma,
            error=-r[part].reshape(-1, 2), left_out=-off[rows], left_out_covariance=off_covariance[rows],
            heading_error=np.full(len(camera_marks), np.nan), turned=np.zeros(len(camera_marks), np.bool_),
            chi_square=float(r @ P @ r), freedom=freedom,
            absorbed=covariance[own] @ weighted[part].T @ follows[c].reshape(2 * len(camera_marks), -1),
        ))  # fmt: skip
    return found
