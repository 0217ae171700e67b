"""Is the camera where it was calibrated? A fresh look at the surveyed marks tells, or says that it cannot.

Two stories are tried. The camera stayed, and marks that are not where they were surveyed were moved; then the others,
fitted afresh, must give the calibrated pose within both fits' uncertainty. Or the camera was knocked, and most marks
agree on another pose. The first is told if it needs no more than one moved mark more than the second. Limits are
probabilities, not millimetres: what is expected of a mark counts survey, pixels and the calibration's own covariance.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.arena import covariance_of, lens_of
from robofleet.calibration.consensus import agree, chance, distances, limit, refuse_undetermined
from robofleet.calibration.fiducials import Marks, look
from robofleet.calibration.frames import Named, refuse_other_sizes
from robofleet.calibration.placing import Lens, Placement, change_between, errors_at, place
from robofleet.calibration.region import region_of
from robofleet.calibration.store import CalibrationError, load, provenance
from robofleet.calibration.survey import LEAST, load_survey, on_one_line
from robofleet.config.calibrated import CameraModel
from robofleet.tracking.camera import CameraGeometry

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_FALSE_ALARM = 1e-3  # probability of an accusation when nothing moved
_SUFFICES = 0.01  # chance of what a turn alone leaves over, above which it explains a knock
_WORTH_TELLING = 0.1  # of a turn's largest part


class Verdict(NamedTuple):
    """What a look says."""

    good: bool
    sentences: tuple[str, ...]


class Calibrated(NamedTuple):
    """The pose to verify, and what is known of it."""

    T: Array
    covariance: Array  # (6, 6); of a pose written by hand, 0
    fresh: bool  # the survey is another one than the pose was fitted to, with errors of its own
    survey_m: float


class _Story(NamedTuple):
    """What may have happened."""

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
    calibrated = _calibrated(camera, model, survey_file, survey_mm)
    refuse_other_sizes(images, model)
    marks, notes = look(survey, images, lens.size)
    try:
        verdict = judge(lens, marks, calibrated, region_of(survey, None, 0.0).points)
    except CalibrationError as unclear:
        raise CalibrationError((*(f"cannot tell: {fault}" for fault in unclear.faults), *notes)) from unclear
    return Verdict(verdict.good, (*verdict.sentences, *notes))


def _calibrated(camera: Path, model: CameraModel, survey_file: Path, survey_mm: float | None) -> Calibrated:
    """Return the pose of a camera's file, and how good it was."""
    if model.T_world_camera is None:
        raise CalibrationError(f"{camera}: T_world_camera: is missing: run robofleet calibrate arena")
    arena, covariance = model.arena, np.zeros((6, 6))
    if arena is not None and arena.covariance:
        covariance = covariance_of(f"{camera}: arena", arena.covariance, 6)
    survey_mm = survey_mm or (None if arena is None else arena.figures.get("survey_sigma_mm"))
    if survey_mm is None or not 0.0 < survey_mm < math.inf:
        raise CalibrationError(f"{camera}: does not say how exact the survey is: state it with --survey-mm")
    now = set(provenance("verify", {"survey": survey_file.read_bytes()}, {}).inputs.values())
    fresh = arena is None or now.isdisjoint(arena.inputs.values())
    T = CameraGeometry.from_model(model).T_world_camera
    return Calibrated(T, covariance, fresh, survey_mm / 1e3)


def judge(lens: Lens, marks: Marks, calibrated: Calibrated, floor: Array) -> Verdict:
    """Tell the likelier story; ``floor`` (G, 3) [m; world]: where an error of the camera matters.

    Raises:
        CalibrationError: the marks do not tell.
    """
    refuse_undetermined(marks)
    squares, error, expected = _compared(lens, marks, calibrated)
    stayed = squares < limit(_FALSE_ALARM / len(marks), None)
    story = _by_those(lens, marks, stayed, calibrated)
    believed = story is not None and story.surprise > _FALSE_ALARM
    if story is None or not believed or not stayed.all():
        try:
            other = _by_most(lens, marks, calibrated)
        except CalibrationError:
            if not believed:
                raise
        else:
            if not believed or np.count_nonzero(~stayed) > np.count_nonzero(~other.stayed) + 1:
                story = other
    assert story is not None
    moved_marks = _moved_marks(story, marks)
    if story.surprise <= _FALSE_ALARM:
        return Verdict(False, (_knock(story, lens, calibrated, floor), *moved_marks))
    rms, usual = (1e3 * math.sqrt(float(values[story.stayed].mean())) for values in ((error**2).sum(1), expected))
    count = np.count_nonzero(story.stayed)
    fine = f"{count} marks are seen {rms:.2f} mm rms from their survey; {usual:.2f} mm is expected"
    if moved_marks:
        return Verdict(
            False, (f"the camera is in its place, but not every mark is where it was surveyed: {fine}", *moved_marks)
        )
    return Verdict(True, (f"OK: {fine}",))


def _compared(lens: Lens, marks: Marks, calibrated: Calibrated) -> tuple[Array, Array, Array]:
    """Compare marks with the survey through the calibrated pose.

    Returns squared distances in standard deviations (N,), errors (N, 2) [m] and their expected squares (N,) [m^2].
    """
    error, noise = errors_at(lens, marks, calibrated.T, np.zeros((6, 6)), calibrated.survey_m)
    by_pose = errors_at(lens, marks, calibrated.T, calibrated.covariance, calibrated.survey_m)[1] - noise
    # A pose that was fitted to this survey follows its errors, and what is left over is smaller by as much.
    expected = np.trace(noise + by_pose if calibrated.fresh else noise - by_pose, axis1=1, axis2=2)
    return distances(error, noise + by_pose if calibrated.fresh else noise), error, np.maximum(expected, 0.0)


def _by_those(lens: Lens, marks: Marks, stayed: Flags, calibrated: Calibrated) -> _Story | None:
    """Return the story that some marks stayed; None if they do not determine a pose."""
    if np.count_nonzero(stayed) < LEAST - 1 or on_one_line(marks.points[stayed]):
        return None
    try:
        placement = place(lens, marks.chosen(stayed), calibrated.T, calibrated.survey_m)
    except np.linalg.LinAlgError:
        return None
    return _story(placement, stayed, calibrated)


def _by_most(lens: Lens, marks: Marks, calibrated: Calibrated) -> _Story:
    """Return the story that most marks stayed, wherever the camera is now; CalibrationError if they disagree."""
    agreement = agree(lens, marks, calibrated.survey_m)
    placement = agreement.placement
    if chance(placement.chi_square, placement.freedom) < _FALSE_ALARM:
        raise CalibrationError(
            f"{', '.join(marks.names)}: no pose shows these where they were surveyed: survey them again"
        )
    return _story(placement, agreement.inside, calibrated)


def _story(placement: Placement, stayed: Flags, calibrated: Calibrated) -> _Story:
    change = change_between(calibrated.T, placement.T_world_camera)
    # Fitted to the same survey, both poses have its errors in common.
    covariance = placement.covariance + (calibrated.covariance if calibrated.fresh else 0.0)
    surprise = chance(float(change @ np.linalg.solve(covariance, change)), len(change))
    return _Story(placement, stayed, change, surprise)


def _moved_marks(story: _Story, marks: Marks) -> list[str]:
    """Return a sentence for each mark that is not as it was surveyed."""
    error, _ = story.placement.seen(marks)
    sentences = [
        f"{marks.names[i]}: lies {math.hypot(x, y):.1f} mm from its survey ({x:+.1f} mm in x, {y:+.1f} mm in y)"
        for i, (x, y) in enumerate((1e3 * error).tolist())
        if not story.stayed[i]
    ]
    names = [name for name, there in zip(marks.names, story.stayed, strict=True) if there]
    for i in np.flatnonzero(story.placement.turned):
        off = math.degrees(story.placement.heading_error[i])
        sentences.append(f"{names[i]}: is turned by {off:+.1f} degrees from its surveyed heading")
    return sentences


def _knock(story: _Story, lens: Lens, calibrated: Calibrated, floor: Array) -> str:
    """Return in words how a camera moved, and what that does on the floor."""
    before, after = lens.geometry.moved(calibrated.T), story.placement.geometry
    off = before.to_plane(after.project(floor), floor[:, 2]) - floor[:, :2]
    distance = 1e3 * np.hypot(off[:, 0], off[:, 1])
    turn, shift = _explanation(story)
    parts = ([_turned(turn, before)] if turn.any() else []) + ([_shifted(shift)] if shift.any() else [])
    return (
        f"the camera was knocked: by its calibration, things now seem {math.sqrt((distance**2).mean()):.1f} mm rms "
        f"from where they are, {distance.max():.1f} mm at most; it {' and '.join(parts)}: run robofleet calibrate arena"
    )


def _explanation(story: _Story) -> tuple[Array, Array]:
    """Return the turn [rad] and the shift [m] of a knock: a turn alone if that explains it, for mounts turn easily."""
    weight = np.linalg.inv(story.placement.covariance)
    for kept in (slice(0, 3), slice(3, 6)):
        part = np.zeros(6)
        part[kept] = np.linalg.solve(weight[kept, kept], (weight @ story.change)[kept])
        left = story.change - part
        if chance(float(left @ weight @ left), 3) > _SUFFICES:
            return part[:3], part[3:]
    return story.change[:3], story.change[3:]


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
        if abs(value) > _WORTH_TELLING * np.abs(degrees).max()
    ]
    return f"turned by {np.linalg.norm(degrees):.2g} degrees ({', '.join(parts)})"


def _shifted(shift: Array) -> str:
    x, y, z = 1e3 * shift
    return f"shifted by {np.linalg.norm(1e3 * shift):.1f} mm ({x:+.1f}, {y:+.1f}, {z:+.1f} mm in the world's x, y, z)"
