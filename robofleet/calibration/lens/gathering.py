"""Images of a board, one by one: from a folder or a video; the views worth having are kept."""

from collections import Counter
from pathlib import Path

import numpy as np

from robofleet.calibration.frames import MIRRORED, images
from robofleet.calibration.lens.board import Board, BoardCheck, BoardDetector, BoardView
from robofleet.calibration.lens.views import Collector, Offer
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Image

FIRST = 3  # views before a lens is fitted at all


class Gathering:
    """Takes images, keeps the views worth having, and remembers what became of the others."""

    def __init__(self, board: Board, *, film: bool) -> None:
        self._board, self._film = board, film
        self._detector, self._check = BoardDetector(board), BoardCheck(board)
        self._collector: Collector | None = None
        self._mirrored = False
        self.size = (0, 0)  # of the images, width and height [px]
        self.fates: dict[str, Offer] = {}

    @property
    def views(self) -> list[BoardView]:
        return [] if self._collector is None else self._collector.views

    @property
    def mirrored(self) -> bool:
        return self._mirrored and not self.views

    @property
    def counts(self) -> Counter[Offer]:
        return Counter(self.fates.values())

    def take(self, name: str, image: Image) -> Offer:
        """Look at an image; CalibrationError if it has another size than those before."""
        size = (image.shape[1], image.shape[0])
        if self._collector is None:
            self.size, self._collector = size, Collector(size, film=self._film)
        if size != self.size:
            raise CalibrationError(
                f"{name}: {size[0]} x {size[1]} px, those before it {self.size[0]} x {self.size[1]}: "
                "take the images of one camera at one resolution"
            )
        sight = self._detector.detect(name, image)
        if sight.view is None and not self.views:
            mirror = np.ascontiguousarray(image[:, ::-1])
            self._mirrored = self._mirrored or self._detector.detect(name, mirror).view is not None
        self._check.add(sight)
        self.fates[name] = Offer.NO_BOARD if sight.view is None else self._collector.offer(sight.view)
        return self.fates[name]

    def refuse(self) -> None:
        """Raise a CalibrationError if there is nothing to fit a lens to, or if the board is another one."""
        if not self.fates:
            raise CalibrationError("there is no image: name a folder or a video that has some")
        faults = [MIRRORED] if self.mirrored else self._check.faults()
        if not faults and len(self.views) < FIRST:
            tally = ", ".join(f"{count} {offer.value}" for offer, count in self.counts.items())
            hold = "; hold the board still for a moment at each place" if self.counts[Offer.MOVING] else ""
            faults = [f"{len(self.views)} views are too few to say anything of the lens ({tally}){hold}"]
        if faults:
            raise CalibrationError(faults)


def gather(source: Path, board: Board) -> Gathering:
    gathering = Gathering(board, film=not source.is_dir())
    for name, image in images(source):
        gathering.take(name, image)
    return gathering
