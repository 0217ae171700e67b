"""How bright an image is: the white paper of the tags in it, or, where there are none, its light greys."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Complex
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.families import pattern
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagSighting

_CELLS = 8  # of a colour that are looked at, those with the most neighbours of their colour
_VEILED = 1 / 3  # a tag with less of its white as contrast lies under a reflection, which no exposure takes away
_SAMPLED_PX = 8  # along each side, one of so many, where there are no tags
_LIGHT_GRAY = 99.0  # percentile: lamps and their reflections are smaller than the rest


class Light(NamedTuple):
    """Grey levels of an image."""

    white: float  # of the brightest tag's paper; without tags, of the image's light parts
    clearest: float  # the largest contrast of a tag; without tags as ``white``
    faintest: float  # the smallest contrast of a tag; without tags the image's median
    tags: int


class TagLight:
    """Looks at the white and black cells of known tags."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self._cells = {target.tag: (target, _chosen(target)) for target in targets}

    def of(self, image: NDArray[np.uint8], geometry: CameraGeometry, sightings: Iterable[TagSighting]) -> Light:
        """Return how bright an image (H, W) is, by the tags that were seen in it."""
        points = []
        for seen in sightings:
            target, cells = self._cells[seen.tag]
            z = complex(seen.x, seen.y) + target.whole * np.exp(1j * seen.psi) * cells
            points.append(np.stack([z.real, z.imag, np.full(len(z), target.height)], axis=1))
        if not points:
            middle, gray = np.percentile(image[::_SAMPLED_PX, ::_SAMPLED_PX], (50.0, _LIGHT_GRAY)).tolist()
            return Light(gray, gray, middle, 0)
        pixels = np.rint(geometry.project(np.concatenate(points))).astype(np.int64)
        column, row = (np.clip(pixels[:, axis], 0, image.shape[1 - axis] - 1) for axis in (0, 1))
        grays = np.median(image[row, column].reshape(len(points), 2, _CELLS), axis=2)
        white, contrast = grays[:, 0], grays[:, 0] - grays[:, 1]
        clear = contrast >= _VEILED * white
        if clear.any():
            white, contrast = white[clear], contrast[clear]
        return Light(float(white.max()), float(contrast.max()), float(contrast.min()), len(points))


def _chosen(target: Target) -> Complex:
    """Return the centres (2 K,) of K white cells, then K black ones, in the tag's frame, forward + i left [prints]."""
    white = pattern(target.tag, target.family)
    count = len(white)
    at = (np.arange(count) + 0.5) / count - 0.5
    centres = (at[None, :] - 1j * at[:, None]).ravel()
    chosen = []
    for colour in (white, ~white):
        around = np.pad(colour, 1).astype(int)
        alike = around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]
        order = np.argsort(np.where(colour, -alike, 1).ravel(), kind="stable")
        chosen.append(centres[np.resize(order[: min(_CELLS, colour.sum())], _CELLS)])
    return np.concatenate(chosen)
