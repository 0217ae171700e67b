"""Where the camera hangs: its pose in the world from surveyed tags and points, how sure that is, and which to doubt."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robofleet.calibration.extrinsics.consensus import Agreement, agree, chance
from robofleet.calibration.extrinsics.fiducials import Look, Marks, look
from robofleet.calibration.extrinsics.page import Found, write_page
from robofleet.calibration.extrinsics.placing import PARAMETERS, Lens, Placement, on_plane, rotation_vector
from robofleet.calibration.extrinsics.region import floor_points, predicted
from robofleet.calibration.extrinsics.survey import LEAST, Survey, load_survey
from robofleet.calibration.extrinsics.together import SurveyView, agree_together, with_places
from robofleet.calibration.frames import Named, refuse_other_sizes
from robofleet.calibration.store import CalibrationError, load, provenance, save
from robofleet.config.calibrated import CameraModel, FloorTag, PoseSettings, SeenMark
from robofleet.config.cameras import lens_fault
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.finder import TagFinder

_USABLE_MM = 3.0  # predicted error on the floor; the paper's robots keep to about 5 mm
_UNLIKELY = 1e-3  # chance of residuals, below which the marks contradict what was stated of the survey
_WIDTH_RATIO = (0.8, 1.25)  # of a tag as seen, over the surveyed side


class Wanted(NamedTuple):
    """What is asked of a calibration."""

    survey_file: Path
    survey_mm: float | None = None  # standard deviation of the survey, one coordinate; None: estimated
    arena_m: tuple[float, float] | None = None  # sides around the world's origin; None: the rectangle of the marks
    tag_height_m: float = 0.0


def calibrate_arena(camera: Path, images: Sequence[Named], report: Path, wanted: Wanted) -> Found:
    """Measure where a camera hangs, write it into its file, and a page about it.

    Raises:
        CalibrationError: the inputs do not say it, or not well enough; nothing is written then.
    """
    model, survey = load(camera, CameraModel), load_survey(wanted.survey_file)
    lens = lens_of(camera, model)
    refuse_other_sizes(images, model)
    seen = look(survey, images, lens.size)
    agreement = _agreement(lens, seen, wanted.survey_mm)
    return _written(_judged(camera, model, survey, images, seen, agreement, wanted), report)


def calibrate_together(
    cameras: Sequence[Path], images: Sequence[Sequence[Named]], report: Path, wanted: Wanted
) -> list[Found]:
    """Measure where several cameras hang by one survey, ``images`` of each; writes their files and a page for each.

    Tags that two cameras see tie them together, also those that nobody surveyed: they lie on the floor.

    Raises:
        CalibrationError: the inputs do not say it, or not well enough; nothing is written then.
    """
    survey = load_survey(wanted.survey_file)
    if survey.points:
        raise CalibrationError(f"{wanted.survey_file}: points: they are pixels of one camera's image: survey tags")
    models = [load(camera, CameraModel) for camera in cameras]
    for model, camera_images in zip(models, images, strict=True):
        refuse_other_sizes(camera_images, model)
    strangers = _shared_strangers(survey, images)
    whole_survey = survey.model_copy(update={"floor_tags": (*survey.floor_tags, *strangers)})
    views, looks = [], []
    for camera, model, camera_images in zip(cameras, models, images, strict=True):
        lens = lens_of(camera, model)
        seen = look(whole_survey, camera_images, lens.size)
        points = seen.marks.points.copy()
        points[np.isin(seen.marks.names, [f"tag {tag.tag}" for tag in strangers]), :2] = np.nan
        views.append(SurveyView(camera.stem, lens, replace(seen.marks, points=points)))
        looks.append(seen)
    agreements = agree_together(views, None if wanted.survey_mm is None else wanted.survey_mm / 1e3)
    judged = []
    for k, (camera, model, view, agreement) in enumerate(zip(cameras, models, views, agreements, strict=True)):
        others = {name for other in looks if other is not looks[k] for name in other.marks.names}
        notes = [note for note in looks[k].notes if "in no image" not in note or note.partition(":")[0] not in others]
        seen = Look(with_places(view, agreement), tuple(f"{camera.stem}: {note}" for note in notes))
        judged.append(_judged(camera, model, survey, images[k], seen, agreement, wanted))
    return [_written(found, report.with_name(f"{report.stem}-{found.camera.stem}{report.suffix}")) for found in judged]


def _shared_strangers(survey: Survey, images: Sequence[Sequence[Named]]) -> list[FloorTag]:
    """Return the tags that two cameras or more see and nobody surveyed."""
    finder, surveyed = TagFinder(survey.family), {tag.tag for tag in survey.floor_tags}
    seen = Counter(tag for own_images in images for tag in (finder.find(own_images[0][1]) if own_images else ()))
    side_m = survey.floor_tags[0].side_m
    shared = [tag for tag, count in seen.items() if count > 1 and tag not in surveyed]
    return [FloorTag(tag=tag, side_m=side_m, x_m=0.0, y_m=0.0) for tag in shared]


def _judged(
    camera: Path, model: CameraModel, survey: Survey, images: Sequence[Named], seen: Look, agreement: Agreement,
    wanted: Wanted,
) -> Found:  # fmt: skip
    placement, survey_mm = agreement.placement, wanted.survey_mm
    points = floor_points(survey, wanted.arena_m, wanted.tag_height_m)
    sigma = predicted(placement, points)
    figures = _figures(agreement, seen.marks, sigma)
    notes = (*seen.notes, *_notes(agreement, seen.marks, survey_mm))
    if 0.0 < (in_sight := float(np.isfinite(sigma).mean())) < 1.0:
        notes += (f"the camera sees {100 * in_sight:.0f} % of the arena: the expected error is for that part",)
    _refuse_poor(agreement, seen.marks, figures, notes, survey_mm)
    inputs = {camera.name: camera.read_bytes(), wanted.survey_file.name: wanted.survey_file.read_bytes()}
    if images:
        inputs["images"] = b"".join(image.tobytes() for _, image in images)
    where = provenance("arena", inputs, figures, PARAMETERS, placement.covariance.tolist())
    pose, marks = _pose(placement.T_world_camera), _seen(seen.marks)
    model = model.model_copy(update={"T_world_camera": pose, "arena": where, "marks": marks})
    return Found(camera, model, agreement, seen.marks, points, sigma, notes)


def _written(found: Found, report: Path) -> Found:
    write_page(report, found)
    return found._replace(kept=save(found.camera, found.model))


def lens_of(file: Path, model: CameraModel) -> Lens:
    """Return a camera's lens; CalibrationError if its values cannot be."""
    fault = lens_fault(model)
    if fault:
        raise CalibrationError(f"{file}: distortion: {fault}")
    here = model.model_copy(update={"T_world_camera": PoseSettings(position_m=(0, 0, 0), rotation_rad=(0, 0, 0))})
    covariance = np.zeros((0, 0))
    if model.intrinsics is not None and model.intrinsics.covariance:
        covariance = covariance_of(f"{file}: intrinsics", model.intrinsics.covariance, 4 + len(model.distortion))
    return Lens(CameraGeometry.from_model(here), (model.width, model.height), covariance)


def covariance_of(where: str, rows: Sequence[Sequence[float]], size: int) -> Array:
    """Return a covariance (size, size) of a file; CalibrationError if it is none."""
    if {len(rows), *map(len, rows)} != {size}:
        raise CalibrationError(f"{where}.covariance: must have {size} rows of {size} numbers: calibrate again")
    covariance = np.array(rows)
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    unit = covariance / np.outer(scale, scale)
    if np.abs(unit - unit.T).max() > 1e-3 or np.linalg.eigvalsh(unit).min() < -1e-3:
        raise CalibrationError(f"{where}.covariance: is not a valid covariance: calibrate again")
    return covariance


def _agreement(lens: Lens, seen: Look, survey_mm: float | None) -> Agreement:
    """Return what the marks agree on; what is missing in the images is said beside a refusal."""
    try:
        if survey_mm is None and len(seen.marks) == LEAST:
            raise CalibrationError("four marks do not tell how well they were surveyed: state it with --survey-mm")
        return agree(lens, seen.marks, None if survey_mm is None else survey_mm / 1e3)
    except CalibrationError as refused:
        raise CalibrationError((*refused.faults, *seen.notes)) from refused


def _figures(agreement: Agreement, marks: Marks, sigma: Array) -> dict[str, float | None]:
    placement, inside = agreement.placement, agreement.inside
    left_out = agreement.error[inside]
    known = np.isfinite(left_out[:, 0])
    expected = np.trace(agreement.covariance[inside][known], axis1=1, axis2=2)
    return {
        "marks_used": float(inside.sum()),
        "marks_left_out": float((~inside).sum()),
        "survey_sigma_mm": 1e3 * placement.survey_m,
        "pixel_sigma_px": float(np.sqrt((marks.sigma_px[inside] ** 2).mean())),
        "residual_rms_mm": _rms_mm(placement.error),
        "held_out_rms_mm": _rms_mm(left_out[known]) if known.any() else None,
        "held_out_expected_mm": 1e3 * math.sqrt(expected.mean()) if known.any() else None,
        "predicted_rms_mm": float(np.sqrt(np.nanmean(sigma**2))) if np.isfinite(sigma).any() else None,
        "predicted_max_mm": float(np.nanmax(sigma)) if np.isfinite(sigma).any() else None,
        "arena_in_sight": float(np.isfinite(sigma).mean()),
    }


def _rms_mm(errors: Array) -> float:
    return 1e3 * math.sqrt(float((errors**2).sum(axis=1).mean()))


def _notes(agreement: Agreement, marks: Marks, survey_mm: float | None) -> list[str]:
    placement, inside = agreement.placement, agreement.inside
    notes = []
    for i in np.flatnonzero(~inside):
        x, y = 1e3 * agreement.error[i]
        notes.append(
            f"{marks.names[i]}: lies {math.hypot(x, y):.1f} mm from where its survey says ({x:+.1f} mm in x, "
            f"{y:+.1f} mm in y); left out: survey it again"
        )
    if survey_mm is not None and len(notes) > 1:
        notes.append(
            f"{len(notes)} marks were left out: if their surveys are right, {survey_mm:g} mm was stated too small"
        )
    names = [name for name, used in zip(marks.names, inside, strict=True) if used]
    for i in np.flatnonzero(placement.turned):
        off = math.degrees(placement.heading_error[i])
        notes.append(f"{names[i]}: is turned by {off:+.1f} degrees from its surveyed heading; the heading is not used")
    for i in np.flatnonzero(~np.isfinite(placement.left_out[:, 0])):
        notes.append(f"{names[i]}: the others do not determine the pose without it, so that nothing checks it")
    if len(marks) == LEAST:
        notes.append("four marks: none can be left out, so that a wrong one is not found: survey a fifth")
    elif survey_mm is None and len(marks) < LEAST + 3:
        notes.append(f"{len(marks)} marks: a small error of one is not found; --survey-mm makes the test sharper")
    return notes


def _refuse_poor(
    agreement: Agreement, marks: Marks, figures: dict[str, float | None], notes: Sequence[str], survey_mm: float | None
) -> None:
    placement, faults = agreement.placement, []
    widths = _widths(placement, marks)
    if len(widths) and not _WIDTH_RATIO[0] < np.median(widths) < _WIDTH_RATIO[1]:
        ratio = f"the tags look {np.median(widths):.3g} times as wide as their side_m"
        faults.append(f"{ratio}: side_m or the survey's unit is wrong")
    if survey_mm is not None and chance(placement.chi_square, placement.freedom) < _UNLIKELY:
        faults.append(
            f"the marks are {figures['residual_rms_mm']:.2g} mm rms off the best pose, too much for a survey of "
            f"{survey_mm:g} mm: survey again, calibrate the lens (intrinsics), or state a larger --survey-mm"
        )
    rms = figures["predicted_rms_mm"]
    if rms is None:
        faults.append("the camera sees nothing of the arena: check the survey's origin, or give --arena-m")
    elif rms > _USABLE_MM:
        faults.append(
            f"the pose would be {rms:.2g} mm rms off on the arena, more than {_USABLE_MM:g}: survey more marks, "
            "farther apart, and better; or calibrate the lens (intrinsics)"
        )
    if faults:
        raise CalibrationError((*faults, *notes))


def _widths(placement: Placement, marks: Marks) -> Array:
    """Return how wide tags look from there, over their sides (T,)."""
    tags = marks.chosen(np.isfinite(marks.sides))
    T, heights = placement.T_world_camera, tags.points[:, 2]
    centre, *_ = on_plane(T, placement.lens.slopes(tags.pixels), heights)
    edge, *_ = on_plane(T, placement.lens.slopes(tags.ahead), heights)
    widths: Array = 2.0 * np.hypot(*(edge - centre).T) / tags.sides
    return widths


def _seen(marks: Marks) -> dict[str, SeenMark]:
    """Return what ``verify`` compares with: every mark, also one that was left out."""
    rows = zip(marks.names, marks.points.tolist(), marks.pixels.tolist(), marks.sigma_px.tolist(), strict=True)
    return {
        name: SeenMark(x_m=x, y_m=y, height_m=height, pixel_px=(round(u, 6), round(v, 6)), sigma_px=round(sigma, 6))
        for name, (x, y, height), (u, v), sigma in rows
    }


def _pose(T_world_camera: Array) -> PoseSettings:
    x, y, z = np.round(T_world_camera[:3, 3], 9).tolist()
    a, b, c = np.round(rotation_vector(T_world_camera[:3, :3]), 9).tolist()
    return PoseSettings(position_m=(x, y, z), rotation_rad=(a, b, c))
