"""Says what images show in which none of the tags is seen that are looked for: how to mend that."""

from collections.abc import Sequence

import cv2
import numpy as np

from robofleet.core.arrays import Image
from robofleet.core.sentences import listed
from robofleet.core.settings import FAMILIES, FamilyName, is_family
from robofleet.tracking.tags.finder import TagFinder

_ENLARGED = (2, 4)  # times
_LEAST_PX = 14  # side of a tag that is found


def instead(images: Sequence[Image], ids: Sequence[int], family: FamilyName) -> str:
    """Return a sentence about tags that images (H, W) show in place of these."""
    wanted = f"no tag {listed(ids)} of {family} is seen"
    whole_family = TagFinder(family)
    if others := _ids(whole_family, images):
        return f"{wanted}, but tags {listed(others)}: name these ids"
    for other in sorted(FAMILIES, key=lambda name: -FAMILIES[name].distance):
        if other != family and is_family(other) and (others := _ids(TagFinder(other), images)):
            return f"{wanted}, but tags {listed(others)} of {other}: name that family"
    if others := _ids(whole_family, [np.ascontiguousarray(image[:, ::-1]) for image in images]):
        return f"{wanted}, but tags {listed(others)}, mirrored: switch a horizontal flip off at the camera"
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
