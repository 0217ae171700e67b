"""Where several cameras hang: one adjustment of all of them to one survey.

A surveyed tag that two cameras see has one error of its survey, which both have in common. A tag that nobody surveyed
ties two cameras together, too: both see it at one place, wherever that is. So every mark has a place with a standard
deviation, the survey's or a metre, and ``placing`` fits the poses of all cameras at once. What is then known of one
camera counts what the others may be off by.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.extrinsics.consensus import Agreement, agree
from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.placing import Lens, Placement, on_plane, place_together
from robofleet.calibration.extrinsics.survey import LEAST
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

_TIED_M = 0.003  # standard deviation at first of a place that another camera saw


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
    used = [view.marks.chosen(agreement.inside) for view, agreement in zip(views, found, strict=True)]
    begun = [agreement.placement.T_world_camera for agreement in found]
    placements = place_together([view.lens for view in views], used, begun, survey_m)
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
