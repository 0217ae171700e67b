"""Verifies that the camera still hangs where it was calibrated, by new images of the surveyed marks.

Two hypotheses are compared. First: the camera stayed, and somebody moved the marks that are elsewhere now. Then a new
fit of the other marks must give the calibrated pose, within the uncertainty of the change. Second: the camera was
knocked, and most marks agree on another pose. The first is reported if it needs at most one moved mark more than the
second. Limits are probabilities, not millimetres.

How uncertain the change is. Let the lens's file be wrong by l, a mark's survey by s, and its pixel by e then and e'
now. The calibrated pose is wrong by A l + B (s + e): the fit spreads the marks' errors over the pose. A fit of today is
wrong by A' l + B' (s + e'). Lens and survey are the same ones, and a camera that has not moved sees the same marks at
the same pixels: then A' = A and B' = B, and all that is left of the difference is B (e' - e): pixel noise, twice.
Two fits that are each uncertain by millimetres can so show a change of a tenth of one.

That holds only while the same marks are used in the same way. So the camera's file keeps where the camera saw each
mark when it was placed, and verify compares with that: the places at which the calibrated camera saw the marks serve
as their survey. They are exact but for e. How they follow the lens is known (``Marks.by_lens``), and is taken off how
today's follow it; what is left is nothing for a camera that stayed, and grows with a knock. Marks that are new, or have
been surveyed again, say nothing about a change and are left aside.

Where fewer than four marks can be compared so (the floor was surveyed again, or the file does not say what was seen),
the survey is all there is. Its errors are others now, and count in both fits: B s and B' s'. The lens is still the
same: its share A l in the calibrated pose is taken out of that pose's covariance, and every mark is compared with what
a camera wrong by l and A l would see.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robofleet.calibration.extrinsics.arena import covariance_of, lens_of
from robofleet.calibration.extrinsics.consensus import agree, chance, distances, limit, refuse_undetermined
from robofleet.calibration.extrinsics.fiducials import Marks, look
from robofleet.calibration.extrinsics.placing import Lens, Placement, change_between, errors_at, on_plane, place
from robofleet.calibration.extrinsics.region import floor_points
from robofleet.calibration.extrinsics.survey import LEAST, load_survey, on_one_line
from robofleet.calibration.frames import Named, refuse_other_sizes
from robofleet.calibration.store import CalibrationError, load
from robofleet.config.calibrated import CameraModel, SeenMark
from robofleet.core.arrays import Array, Flags
from robofleet.tracking.camera import CameraGeometry

_FALSE_ALARM = 1e-3  # probability of an accusation when nothing moved
_SUFFICES = 0.01  # chance of what a turn alone leaves over, above which it explains a knock
_WORTH_REPORTING = 0.1  # of a turn's largest part
_LIE_STILL_M = 1e-5  # standard deviation with which a print keeps its place on a floor, one coordinate
_SAME_M = 1e-6  # a mark whose surveyed coordinates differ by more was surveyed again


class Verdict(NamedTuple):
    """What a look says."""

    good: bool
    sentences: tuple[str, ...]


class Calibrated(NamedTuple):
    """The pose to verify, and what is known of it."""

    T: Array
    covariance: Array  # (6, 6), the lens's share included; of a pose written by hand, 0
    survey_m: float
    marks: Mapping[str, SeenMark]  # as seen when it was calibrated; none: not known


class _Known(NamedTuple):
    """Where marks should be seen if the camera stayed."""

    marks: Marks  # as seen now, at the places where they should be
    T: Array
    covariance: Array  # (6, 6) of T against these places, with the lens as it is
    place_m: float  # standard deviation of the places, one coordinate, their pixels aside
    survey_m: float
    their: str  # in words, where they should be
    frame: str


class _Hypothesis(NamedTuple):
    placement: Placement  # by the marks that stayed
    stayed: Flags  # (N,)
    change: Array  # (6,) of the camera
    surprise: float  # chance of so large a change if the camera stayed


def verify(camera: Path, survey_file: Path, images: Sequence[Named], survey_mm: float | None = None) -> Verdict:
    """Compare where marks are seen now with the survey, through a calibrated camera.

    ``survey_mm``: standard deviation of the survey, one coordinate; None: as when the camera was calibrated.

    Raises:
        CalibrationError: there is nothing to compare, or it does not tell.
    """
    model, survey = load(camera, CameraModel), load_survey(survey_file)
    lens = lens_of(camera, model)
    calibrated = _calibrated(camera, model, survey_mm)
    refuse_other_sizes(images, model)
    marks, notes = look(survey, images, lens.size)
    try:
        verdict = judge(lens, marks, calibrated, floor_points(survey, None, 0.0))
    except CalibrationError as unclear:
        raise CalibrationError((*(f"cannot tell: {fault}" for fault in unclear.faults), *notes)) from unclear
    return Verdict(verdict.good, (*verdict.sentences, *notes))


def _calibrated(camera: Path, model: CameraModel, survey_mm: float | None) -> Calibrated:
    if model.T_world_camera is None:
        raise CalibrationError(f"{camera}: T_world_camera: is missing: run robofleet calibrate arena")
    arena, covariance = model.arena, np.zeros((6, 6))
    if arena is not None and arena.covariance:
        covariance = covariance_of(f"{camera}: arena", arena.covariance, 6)
    survey_mm = survey_mm or (None if arena is None else arena.figures.get("survey_sigma_mm"))
    if survey_mm is None or not 0.0 < survey_mm < math.inf:
        raise CalibrationError(f"{camera}: does not say how exact the survey is: state it with --survey-mm")
    return Calibrated(CameraGeometry.from_model(model).T_world_camera, covariance, survey_mm / 1e3, model.marks or {})


def judge(lens: Lens, marks: Marks, calibrated: Calibrated, floor: Array) -> Verdict:
    """Report the likelier hypothesis; ``floor`` (G, 3) [m; world]: where an error of the camera matters.

    Raises:
        CalibrationError: the marks do not tell.
    """
    refuse_undetermined(marks)
    known = _by_pixels(lens, marks, calibrated) or _by_survey(lens, marks, calibrated)
    squares, error, expected = _compared(lens, known)
    stayed = squares < limit(_FALSE_ALARM / len(known.marks), None)
    hypothesis = _by_those(lens, known, stayed)
    believed = hypothesis is not None and hypothesis.surprise > _FALSE_ALARM
    if hypothesis is None or not believed or not stayed.all():
        try:
            other = _by_most(lens, known)
        except CalibrationError:
            if not believed:
                raise
        else:
            if not believed or np.count_nonzero(~stayed) > np.count_nonzero(~other.stayed) + 1:
                hypothesis = other
    assert hypothesis is not None
    others = _others(hypothesis, known, marks)
    if hypothesis.surprise <= _FALSE_ALARM:
        return Verdict(False, (_knock(hypothesis, lens, calibrated, floor), *others))
    rms, usual = (1e3 * math.sqrt(float(values[hypothesis.stayed].mean())) for values in ((error**2).sum(1), expected))
    count = np.count_nonzero(hypothesis.stayed)
    fine = f"{count} marks are seen {rms:.2f} mm rms from {known.their}; {usual:.2f} mm is expected"
    if not hypothesis.stayed.all() or hypothesis.placement.turned.any():
        return Verdict(False, (f"the camera is in its place, but not every mark is where it was: {fine}", *others))
    return Verdict(True, (f"OK: {fine}", *others))


def _by_pixels(lens: Lens, marks: Marks, calibrated: Calibrated) -> _Known | None:
    """Return the places at which the calibrated camera saw marks then; None if it saw too few of them."""
    then = [calibrated.marks.get(name) for name in marks.names]
    same = np.array(
        [
            seen is not None and bool(np.allclose((seen.x_m, seen.y_m, seen.height_m), point, rtol=0.0, atol=_SAME_M))
            for seen, point in zip(then, marks.points, strict=True)
        ]
    )
    marks = marks.chosen(same)
    if len(marks) < LEAST or on_one_line(marks.points):
        return None
    seen = [mark for mark, chosen in zip(then, same, strict=True) if mark is not None and chosen]
    pixels, sigma_px = np.array([mark.pixel_px for mark in seen]), np.array([mark.sigma_px for mark in seen])
    places, _, by_slope = on_plane(calibrated.T, lens.slopes(pixels), marks.points[:, 2])
    marks = dataclasses.replace(
        marks,
        points=np.column_stack([places, marks.points[:, 2]]),
        sigma_px=np.hypot(marks.sigma_px, sigma_px),
        by_lens=by_slope @ lens.by_lens(pixels),
    )
    words = "where they were at the calibration", "where it was at the calibration"
    return _Known(marks, calibrated.T, np.zeros((6, 6)), _LIE_STILL_M, calibrated.survey_m, *words)


def _by_survey(lens: Lens, marks: Marks, calibrated: Calibrated) -> _Known:
    try:
        absorbed = place(lens, marks, calibrated.T, calibrated.survey_m).absorbed
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"{', '.join(marks.names)}: {error}: lay more, farther apart") from error
    _, J, _ = on_plane(calibrated.T, lens.slopes(marks.pixels), marks.points[:, 2])
    values, vectors = np.linalg.eigh(calibrated.covariance - absorbed @ lens.covariance @ absorbed.T)
    own = (vectors * np.maximum(values, 0.0)) @ vectors.T
    marks = dataclasses.replace(marks, by_lens=J @ absorbed)
    return _Known(marks, calibrated.T, own, calibrated.survey_m, calibrated.survey_m, "their survey", "its survey")


def _compared(lens: Lens, known: _Known) -> tuple[Array, Array, Array]:
    """Compare marks with where they should be seen.

    Returns squared distances in standard deviations (N,), errors (N, 2) [m] and their expected squares (N,) [m^2].
    """
    marks = known.marks
    error, noise = errors_at(lens, marks, known.T, known.covariance, known.place_m)
    _, _, by_slope = on_plane(known.T, lens.slopes(marks.pixels), marks.points[:, 2])
    follows = by_slope @ lens.by_lens(marks.pixels) - marks.by_lens
    noise = noise + follows @ lens.covariance @ follows.transpose(0, 2, 1)
    return distances(error, noise), error, np.trace(noise, axis1=1, axis2=2)


def _by_those(lens: Lens, known: _Known, stayed: Flags) -> _Hypothesis | None:
    if np.count_nonzero(stayed) < LEAST - 1 or on_one_line(known.marks.points[stayed]):
        return None
    try:
        placement = place(lens, known.marks.chosen(stayed), known.T, known.place_m)
    except np.linalg.LinAlgError:
        return None
    return _hypothesis(placement, stayed, known)


def _by_most(lens: Lens, known: _Known) -> _Hypothesis:
    """Return the hypothesis that most marks stayed, wherever the camera is now; CalibrationError if they disagree.

    From elsewhere, and in other light, a mark's pixel does not repeat as well as it did. If the marks do not agree as
    well as expected, how well they do is estimated; no worse than they were surveyed is still an answer.
    """
    for place_m in (known.place_m, None):
        try:
            placement, inside, *_ = agree(lens, known.marks, place_m)
        except CalibrationError:
            if place_m is None:
                raise
            continue
        if placement.survey_m <= known.survey_m and chance(placement.chi_square, placement.freedom) >= _FALSE_ALARM:
            return _hypothesis(placement, inside, known)
    names = ", ".join(known.marks.names)
    raise CalibrationError(f"{names}: no pose shows these where they were surveyed: survey them again")


def _hypothesis(placement: Placement, stayed: Flags, known: _Known) -> _Hypothesis:
    change = change_between(known.T, placement.T_world_camera)
    covariance = placement.covariance + known.covariance
    surprise = chance(float(change @ np.linalg.solve(covariance, change)), len(change))
    return _Hypothesis(placement, stayed, change, surprise)


def _others(hypothesis: _Hypothesis, known: _Known, seen: Marks) -> list[str]:
    """Return a sentence for each mark that is not where it was, and one for those that say nothing of that."""
    marks = known.marks
    error, _ = hypothesis.placement.seen(marks)
    sentences = [
        f"{marks.names[i]}: lies {math.hypot(x, y):.2g} mm from {known.frame} ({x:+.2f} mm in x, {y:+.2f} mm in y)"
        for i, (x, y) in enumerate((1e3 * error).tolist())
        if not hypothesis.stayed[i]
    ]
    names = [name for name, stays in zip(marks.names, hypothesis.stayed, strict=True) if stays]
    for i in np.flatnonzero(hypothesis.placement.turned):
        off = math.degrees(hypothesis.placement.heading_error[i])
        sentences.append(f"{names[i]}: is turned by {off:+.1f} degrees from its surveyed heading")
    if new := [name for name in seen.names if name not in marks.names]:
        sentences.append(f"{', '.join(new)}: not compared: not seen, or surveyed otherwise, at the calibration")
    return sentences


def _knock(hypothesis: _Hypothesis, lens: Lens, calibrated: Calibrated, floor: Array) -> str:
    """Return in words how a camera moved, and what that does on the floor."""
    before, after = lens.geometry.moved(calibrated.T), hypothesis.placement.geometry
    off = before.to_plane(after.project(floor), floor[:, 2]) - floor[:, :2]
    distance = 1e3 * np.hypot(off[:, 0], off[:, 1])
    turn, shift = _explanation(hypothesis)
    parts = ([_turned(turn, before)] if turn.any() else []) + ([_shifted(shift)] if shift.any() else [])
    return (
        f"the camera was knocked: by its calibration, things now seem {math.sqrt((distance**2).mean()):.1f} mm rms "
        f"from where they are, {distance.max():.1f} mm at most; it {' and '.join(parts)}: run robofleet calibrate arena"
    )


def _explanation(hypothesis: _Hypothesis) -> tuple[Array, Array]:
    """Return the turn [rad] and the shift [m] of a knock: a turn alone if that explains it, for mounts turn easily."""
    weight = np.linalg.inv(hypothesis.placement.covariance)
    for kept in (slice(0, 3), slice(3, 6)):
        part = np.zeros(6)
        part[kept] = np.linalg.solve(weight[kept, kept], (weight @ hypothesis.change)[kept])
        left = hypothesis.change - part
        if chance(float(left @ weight @ left), 3) > _SUFFICES:
            return part[:3], part[3:]
    return hypothesis.change[:3], hypothesis.change[3:]


def _turned(turn: Array, before: CameraGeometry) -> str:
    """Return a turn (3,) [rad; world] in the terms of the camera's image."""
    degrees = np.degrees(before.T_world_camera[:3, :3].T @ turn)
    parts = [
        f"{abs(value):.2g} degrees {positive if value > 0 else negative}"
        for value, positive, negative in zip(
            degrees,
            ("towards its image's top", "towards its image's right", "clockwise about its axis"),
            ("towards its image's bottom", "towards its image's left", "counter-clockwise about its axis"),
            strict=True,
        )
        if abs(value) > _WORTH_REPORTING * np.abs(degrees).max()
    ]
    return f"turned by {np.linalg.norm(degrees):.2g} degrees ({', '.join(parts)})"


def _shifted(shift: Array) -> str:
    x, y, z = 1e3 * shift
    return f"shifted by {np.linalg.norm(1e3 * shift):.1f} mm ({x:+.1f}, {y:+.1f}, {z:+.1f} mm in the world's x, y, z)"
