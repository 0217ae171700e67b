"""Where surveyed tags are in images, to a hundredth of a pixel, whatever is known of the camera."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.extrinsics.survey import Survey
from robofleet.calibration.frames import MIRRORED, Named
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array
from robofleet.tracking.tags.finder import Seen, TagFinder

_LEAST_PX = 0.01  # standard deviation of a tag's pixel that no averaging betters: interpolation, uneven light
_FEW_FRAMES = 3  # frames, of which the scatter does not tell
_BY_EYE_PX = 0.5  # of a point that was read off an image
_MOVED_PX = 0.3  # spread over the images, beyond that of most tags, of a tag that was carried meanwhile


@dataclass(frozen=True)
class Marks:
    """N surveyed tags and points, and where they are seen."""

    names: tuple[str, ...]
    points: Array  # (N, 3) as surveyed [m; world]
    headings: Array  # (N,) as surveyed [rad]; NaN: not surveyed
    sides: Array  # (N,) of tags [m]; NaN: a point
    pixels: Array  # (N, 2)
    ahead: Array  # (N, 2) of a tag's right edge, in the middle; NaN: a point
    sigma_px: Array  # (N,) of a pixel's coordinate
    by_lens: Array | float = 0.0  # (N, 2, K) how x, y follow the lens's values [m], if they were seen; 0: by hand

    def __len__(self) -> int:
        return len(self.names)

    def chosen(self, which: NDArray[np.bool_]) -> "Marks":
        arrays = {name: values[which] for name, values in vars(self).items() if isinstance(values, np.ndarray)}
        return replace(self, names=tuple(compress(self.names, which)), **arrays)


class Look(NamedTuple):
    """What images show of a survey."""

    marks: Marks
    notes: tuple[str, ...]  # what is missing, too much, or strange


def look(survey: Survey, images: Sequence[Named], size: tuple[int, int]) -> Look:
    """Return where the survey's tags are, averaged over images of one still scene, and its points.

    The spread over the images tells how exact a tag's pixel is, and whether somebody carried it meanwhile.
    CalibrationError if there is nothing to look at, if the images are mirrored, or if a point lies outside of ``size``:
    width, height [px].
    """
    if survey.floor_tags and not images:
        raise CalibrationError("tags were surveyed, and there is no image to find them in: name images, or --live")
    outside = [
        f"point {point.name}: u_px, v_px: {point.u_px:g}, {point.v_px:g} is outside the image, {size[0]} x {size[1]}"
        for point in survey.points
        if not (0 <= point.u_px + 0.5 <= size[0] and 0 <= point.v_px + 0.5 <= size[1])
    ]
    if outside:
        raise CalibrationError(outside)
    finder = TagFinder(survey.family)
    found = [finder.find(image) for _, image in images]
    twice = {tag for prints in found for tag, seen in prints.items() if len(seen) > 1}
    tracks = {
        tag.tag: [prints[tag.tag][0] for prints in found if tag.tag in prints]
        for tag in survey.floor_tags
        if tag.tag not in twice and any(tag.tag in prints for prints in found)
    }
    spreads = {tag: float(np.std([seen.centre for seen in track], axis=0).max()) for tag, track in tracks.items()}
    usual = float(np.median(list(spreads.values()))) if spreads else 0.0
    carried = {tag for tag, spread in spreads.items() if spread > 3.0 * usual + _MOVED_PX}
    marks = _marks(survey, {tag: track for tag, track in tracks.items() if tag not in carried})
    surveyed = {tag.tag for tag in survey.floor_tags}
    if not tracks and any(surveyed & finder.find(np.ascontiguousarray(image[:, ::-1])).keys() for _, image in images):
        raise CalibrationError(MIRRORED)
    strangers = {tag for prints in found for tag in prints} - surveyed
    notes = [
        *(f"tag {tag}: is surveyed, but is in no image" for tag in sorted(surveyed - twice - set(tracks)) if images),
        *(f"tag {tag}: two prints of it are in one image; left out" for tag in sorted(twice & surveyed)),
        *(f"tag {tag}: moved while images were taken; left out" for tag in sorted(carried)),
        *(f"tag {tag}: is in the images, but not in the survey" for tag in sorted(strangers)),
    ]
    return Look(marks, tuple(notes))


def _marks(survey: Survey, tracks: dict[int, list[Seen]]) -> Marks:
    """Return the tags that have tracks, over the frames, and all points."""
    tags = [tag for tag in survey.floor_tags if tag.tag in tracks]
    nan = math.nan
    rows = [
        (
            (tag.x_m, tag.y_m, tag.height_m),
            math.radians(tag.heading_deg) if "heading_deg" in tag.model_fields_set else nan,
            tag.side_m,
            np.mean([seen.centre for seen in tracks[tag.tag]], axis=0),
            np.mean([seen.ahead for seen in tracks[tag.tag]], axis=0),
            _sigma_of_mean_px(tracks[tag.tag]),
        )
        for tag in tags
    ]
    rows += [
        ((p.x_m, p.y_m, p.height_m), nan, nan, np.array([p.u_px, p.v_px]), np.array([nan, nan]), _BY_EYE_PX)
        for p in survey.points
    ]
    columns = list(zip(*rows, strict=True)) or [()] * 6
    widths = ((-1, 3), (-1,), (-1,), (-1, 2), (-1, 2), (-1,))
    arrays = (np.array(c, dtype=np.float64).reshape(w) for c, w in zip(columns, widths, strict=True))
    names = (*(f"tag {tag.tag}" for tag in tags), *(f"point {point.name}" for point in survey.points))
    return Marks(names, *arrays)


def _sigma_of_mean_px(track: list[Seen]) -> float:
    """Return the standard deviation of the mean over frames, one coordinate: by its scatter, of a few by the greys."""
    if len(track) < _FEW_FRAMES:
        variance = float(np.mean([seen.sigma**2 for seen in track]))
    else:
        variance = float(np.var([seen.centre for seen in track], axis=0, ddof=1).mean())
    return max(_LEAST_PX, math.sqrt(variance / len(track)))
