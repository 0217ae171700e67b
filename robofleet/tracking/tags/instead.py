"""Says what images show in which none of the tags is seen that are looked for: how to mend that."""

from collections.abc import Sequence

import cv2
import numpy as np

from robofleet.core.arrays import Image
from robofleet.core.settings import FAMILIES, FamilyName, is_family
from robofleet.tracking.tags.prints import TagFinder

_ENLARGED = (2, 4)  # times
_LEAST_PX = 14  # side of a tag that is found
_MOST_NAMED = 12  # ids


def instead(images: Sequence[Image], ids: Sequence[int], family: FamilyName) -> str:
    """Return a sentence about tags that images (H, W) show in place of these."""
    wanted = f"no tag {_listed(ids)} of {family} is seen"
    whole_family = TagFinder(family)
    if others := _ids(whole_family, images):
        return f"{wanted}, but tags {_listed(others)}: name these ids"
    for other in sorted(FAMILIES, key=lambda name: -FAMILIES[name].distance):
        if other != family and is_family(other) and (others := _ids(TagFinder(other), images)):
            return f"{wanted}, but tags {_listed(others)} of {other}: name that family"
    if others := _ids(whole_family, [np.ascontiguousarray(image[:, ::-1]) for image in images]):
        return f"{wanted}, but tags {_listed(others)}, mirrored: switch a horizontal flip off at the camera"
    for times in _ENLARGED:
        large = [cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC) for image in images[:1]]
        for image in large:
            for prints in whole_family.find(np.asarray(image, np.uint8)).values():
                side = np.linalg.norm(prints[0].corners[1] - prints[0].corners[0]) / times
                return (
                    f"{wanted}, but tags with a side of {side:.0f} px: at least {_LEAST_PX} px are needed: take larger "
                    "tags, more pixels, or a nearer camera"
                )
    return (
        f"{wanted}, and no other tag: are they flat, sharp, with a white rim, and seen from above? Is --family theirs?"
    )


def _ids(finder: TagFinder, images: Sequence[Image]) -> list[int]:
    return sorted({tag for image in images for tag in finder.find(image)})


def _listed(ids: Sequence[int]) -> str:
    """Return numbers as a person writes them: 1 to 4, 7."""
    runs: list[list[int]] = []
    for tag in sorted(set(ids)):
        if runs and tag == runs[-1][-1] + 1:
            runs[-1].append(tag)
        else:
            runs.append([tag])
    words = [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]
    return ", ".join(words[:_MOST_NAMED]) + (", ..." if len(words) > _MOST_NAMED else "")
