"""A film of a recorded run: an MP4 or a GIF, of the arena or of a camera's images."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.calibrated import CameraModel
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.refusal import RefusedError
from robofleet.gateways.exports import video
from robofleet.gateways.exports.artist import Artist
from robofleet.reports.canvas import RunView
from robofleet.reports.recorded_run import RecordedImage, RecordedRun
from robofleet.reports.sampled import look
from robofleet.tracking.camera import CameraGeometry

Image = NDArray[np.uint8]

RATES_HZ = {".mp4": 25, ".gif": 20}  # images a second, by the file's ending
_LONGEST_GIF = 2000  # images


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a film shows."""

    from_s: float  # since the run's first tick
    to_s: float | None  # None: to its end
    speed: float
    width: int  # [px]
    camera: Config | None  # the view of a camera; None: the arena is drawn
    title: str


class Film:
    """The images of a film."""

    def __init__(self, run: Path, wanted: Wanted, rate_hz: int) -> None:
        """Read the run.

        Raises:
            RecordingError: The recording cannot be read.
            RefusedError: The film would have no image.
        """
        columns = look(run)
        if not len(columns.t):
            raise RefusedError(f"{run}: no robot drove in it: there is nothing to film")
        self._run, self._wanted = run, wanted
        view = RunView(columns, {"stops": []})
        last_s = view.span[1]
        to_s = last_s if wanted.to_s is None else min(wanted.to_s, last_s)
        if not 0 <= wanted.from_s < to_s:
            raise RefusedError(f"--from, --to: the run drove from 0 to {last_s:.1f} s: name a part of it")
        self.count = max(1, round((to_s - wanted.from_s) / wanted.speed * rate_hz))
        self._instants = (wanted.from_s + np.arange(self.count) * wanted.speed / rate_hz).tolist()
        width = 2 * (wanted.width // 2)
        pixels = None if wanted.camera is None else _pixels(wanted.camera, width)
        self._artist = Artist(view, wanted.title, wanted.speed, width, pixels)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height [px]; both even."""
        artist, camera = self._artist, self._wanted.camera
        height = artist.arena.shape[0] if camera is None else _height(artist.width, camera.camera.model)
        return artist.width, artist.header + height

    def images(self) -> Iterator[Image]:
        """Yield the images."""
        if self._wanted.camera is not None:
            return self._of_camera(self._wanted.camera)
        return map(self._artist.frame, self._instants)

    def _of_camera(self, camera: Config) -> Iterator[Image]:
        """Yield at each instant the newest image of a camera, with what is drawn on it."""
        size = self._artist.width, _height(self._artist.width, camera.camera.model)

        def drawn(recorded: RecordedImage) -> Image:
            photograph = np.asarray(cv2.resize(recorded.image, size, interpolation=cv2.INTER_AREA), np.uint8)
            return self._artist.frame(recorded.t_s, photograph)

        coming = RecordedRun(self._run).images(camera.camera.name)
        newest, following = next(coming, None), next(coming, None)
        if newest is None:
            raise RefusedError(f"{self._run}: it has no image of {camera.camera.name}: take --view arena")
        shown: Image | None = None
        for t in self._instants:
            while following is not None and following.t_s <= t:
                newest, following, shown = following, next(coming, None), None
            shown = drawn(newest) if shown is None else shown
            yield shown


def make(run: Path, file: Path, wanted: Wanted, counting: Callable[[int], Callable[[], None]]) -> None:
    """Write a film: what its file's ending says.

    ``counting``: returns, for so many images, what is called for each.

    Raises:
        RecordingError, RefusedError: As ``Film``.
        OSError: It cannot be written.
    """
    rate_hz = RATES_HZ[file.suffix.lower()]
    film = Film(run, wanted, rate_hz)
    is_gif = file.suffix.lower() == ".gif"
    if is_gif and film.count > _LONGEST_GIF:
        raise RefusedError(f"--out: a GIF of {film.count} images is too long: take --from, --to or --speed, or an .mp4")
    counted = counting(film.count)

    def images() -> Iterator[Image]:
        for image in film.images():
            yield image
            counted()

    if is_gif:
        video.gif(file, images(), 1000 // rate_hz)
        return
    with video.mp4(file, *film.size, Fraction(rate_hz)) as add:
        for image in images():
            add(image)


def _pixels(camera: Config, width: int) -> Callable[[Array], Array]:
    """Return where points of the floor (n, 2) [m], at the height of the tags, are in images (n, 2) [px] of a width."""
    model, height_m = camera.camera.model, camera.tracker.tag_height_m
    geometry = CameraGeometry.from_model(model)
    scale = np.array([width / model.width, _height(width, model) / model.height])

    def pixels(points: Array) -> Array:
        at = geometry.project(np.column_stack([points, np.full(len(points), height_m)]))
        return np.asarray((at + 0.5) * scale - 0.5)

    return pixels


def _height(width: int, model: CameraModel) -> int:
    """Return the height of a camera's image of that width [px]; even."""
    return 2 * round(width * model.height / model.width / 2)
