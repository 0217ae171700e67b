"""Recorded images: a video, a folder with one file an image, or one image; each with the time at which it was taken.

The times are, in this order: those of a rate that is named; those of a CSV (see ``stamps.py``); those of the video's
own container, whose rate may vary; the names of a folder's images, mid-exposures in ns (``1714000000123456789.png``).
"""

import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2

from robofleet.core.arrays import Image
from robofleet.core.clock import MS, S
from robofleet.tracking.cameras.stamps import Stamp, read_stamps
from robofleet.tracking.sources import CameraError

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp"}
_AS_TAKEN = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION  # pixels as the sensor has them
_TIMES_MISSING = "name a CSV of its times, or its rate"
_SHORTEST_NS = 100_000  # between two images: numbers that count are no times
_TRUNCATED = 1.5  # a video that ends so many of its longest intervals too early


class Shot(NamedTuple):
    """An image that is not decoded yet."""

    name: str  # of its file; of a video's frame ``name.avi:frame 12``, counted from 0
    taken_ns: int  # mid-exposure, on a clock of the recording's own
    load: Callable[[], Image]


def images(path: Path) -> Iterator[tuple[str, Image]]:
    """Return every image of a video or of a folder (sorted by name), or one image, with its name; all of one size.

    Raises:
        CameraError: when it comes to something that cannot be read, to the end of a truncated video or to an image
            of another size than the first one.
    """
    for shot, image in decoded(path, _shots(path)):
        yield shot.name, image


def decoded(path: Path, shots: Iterator[Shot]) -> Iterator[tuple[Shot, Image]]:
    """Decode the shots of a recording, as ``images`` does."""
    first: Image | None = None
    for shot in shots:
        image = shot.load()
        first = image if first is None else first
        if image.shape != first.shape:
            raise CameraError(f"{within(path, shot.name)}: {size(image)}, but the first image has {size(first)}")
        yield shot, image


class Recording:
    """Images with their times; it can be read several times."""

    def __init__(self, path: Path, stamps: Path | None = None, rate_hz: float | None = None) -> None:
        """Read the times that do not stand in a video.

        Raises:
            CameraError: There is anything wrong with them, or the recording cannot be opened.
        """
        self.path, self._fixed_hz = path, rate_hz
        self._stamps = None if rate_hz is not None else _stamps(path, stamps)
        self.count, own_hz = _count(path)  # of images; 0: a video does not tell
        self.rate_hz = own_hz if rate_hz is None else rate_hz  # on average; 0: not known
        if self._stamps and len(self._stamps) > 1:
            self.rate_hz = (len(self._stamps) - 1) * S / (self._stamps[-1].exposure_ns - self._stamps[0].exposure_ns)

    def shots(self) -> Iterator[Shot]:
        """Yield the images, later from one to the next; CameraError as ``images``, and where there are too few."""
        if self._stamps is None:
            shots = _shots(self.path)
            if self._fixed_hz is not None:
                shots = (shot._replace(taken_ns=round(k * S / self._fixed_hz)) for k, shot in enumerate(shots))
            yield from shots
            return
        named = (_file(self.path / stamp.file) for stamp in self._stamps)
        shots = named if self.path.is_dir() else _shots(self.path)
        k = 0
        for shot, stamp in zip(shots, self._stamps, strict=False):
            yield shot._replace(taken_ns=stamp.exposure_ns)
            k += 1
        if k < len(self._stamps):
            raise CameraError(f"{self.path} ends before its stamps do")


def within(path: Path, name: str) -> Path:
    return path / name if path.is_dir() else path.with_name(name)


def size(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px"


def _shots(path: Path) -> Iterator[Shot]:
    if _is_folder(path):
        return (_file(path / name) for name in _names(path))
    return iter([_file(path)]) if _is_image(path) else _video(path)


def _is_folder(path: Path) -> bool:
    """Return whether this is a folder; CameraError unless it is there and may be read."""
    try:
        path.stat()
        folder = path.is_dir()
        for entry in (path, *(path.iterdir() if folder else ())):
            str(entry).encode()  # OpenCV crashes on a name that has bytes of another encoding
    except UnicodeEncodeError as error:
        raise CameraError(f"{str(entry)!a}: this name is not in UTF-8: rename it") from error
    except (OSError, ValueError) as error:
        raise CameraError(f"{path}: {getattr(error, 'strerror', error)}") from error
    return folder


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in _SUFFIXES


def _names(path: Path) -> list[str]:
    """Return the names of the images in a folder, numbers in them in their order: 9 before 10."""
    names = [f.name for f in path.iterdir() if _is_image(f) and not f.name.startswith(".")]
    if not names:
        raise CameraError(f"{path}: there is no image in this folder ({', '.join(sorted(_SUFFIXES))})")
    return sorted(names, key=lambda name: [int(p) if p.isdecimal() else p for p in re.split(r"(\d+)", name)])


def _count(path: Path) -> tuple[int, float]:
    """Return how many images there are, and how many a second; 0: it is not known."""
    if _is_folder(path):
        return len(_names(path)), 0.0
    if _is_image(path):
        return 1, 0.0
    capture, frames, rate_hz = _opened(path)
    capture.release()
    return max(frames, 0), rate_hz


def _file(file: Path) -> Shot:
    def load() -> Image:
        try:
            image = cv2.imread(str(file), _AS_TAKEN)
        except cv2.error:  # of a size that cannot be
            image = None
        if image is None:
            raise CameraError(f"{file}: cannot be read as an image")
        return image  # type: ignore[return-value]

    return Shot(file.name, 0, load)


def _video(path: Path) -> Iterator[Shot]:
    capture, frames, rate_hz = _opened(path)
    period_ns = round(S / rate_hz)
    try:
        k, taken_ns, longest_ns = 0, -period_ns, period_ns
        while capture.grab():

            def load(name: str = f"{path.name}:frame {k}") -> Image:
                decoded, image = capture.retrieve()
                if not decoded:
                    raise CameraError(f"{within(path, name)} cannot be decoded")
                return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image  # type: ignore[return-value]

            stamp_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * MS)
            before_ns, taken_ns = taken_ns, stamp_ns if stamp_ns > taken_ns else taken_ns + period_ns
            longest_ns = max(longest_ns, taken_ns - before_ns)
            yield Shot(f"{path.name}:frame {k}", taken_ns, load)
            k += 1
        # Where the container does not hold the number of frames, it is the duration times the mean rate.
        early = frames * period_ns - taken_ns > _TRUNCATED * longest_ns
        if k == 0 or (k < frames and early):
            raise CameraError(f"{path}:frame {k}: cannot be read: the video is truncated, it should have {frames}")
    finally:
        capture.release()


def _opened(path: Path) -> tuple[cv2.VideoCapture, int, float]:
    """Return a video, how many frames it says it has, not positive if it does not know, and how many a second."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    if not capture.isOpened():
        raise CameraError(f"{path}: cannot be read as a video: it is none, or it was not written to its end")
    rate_hz = capture.get(cv2.CAP_PROP_FPS)
    return capture, round(capture.get(cv2.CAP_PROP_FRAME_COUNT)), rate_hz if 0.0 < rate_hz < S else 30.0


def _stamps(path: Path, file: Path | None) -> list[Stamp] | None:
    """Return the stamps of all images in their order; None of a video, or one image, that is its own clock.

    Raises:
        CameraError: They do not match the images one to one.
    """
    if _is_folder(path):
        stamps = _own_names(path) if file is None else read_stamps(file, named=True)
        _match_names(path, stamps)
    elif file is None:
        return None
    else:
        frames, _ = _count(path)
        stamps = read_stamps(file, named=False)
        if len(stamps) > frames > 0:
            raise CameraError(f"{stamps[frames].where}: is for frame {frames}, but {path} has {frames} frames")
        if len(stamps) < frames:
            raise CameraError(f"{file}:{len(stamps) + 2}: no line for {path}:frame {len(stamps)}")
    for before, stamp in itertools.pairwise(stamps):
        if stamp.exposure_ns <= before.exposure_ns:
            raise CameraError(f"{stamp.where}: is not later than the one before: sort the lines by time")
    if file is None and stamps[-1].exposure_ns - stamps[0].exposure_ns < _SHORTEST_NS * (len(stamps) - 1):
        raise CameraError(f"{path}: the images' names are numbers, and no times in ns: {_TIMES_MISSING}")
    return stamps


def _own_names(path: Path) -> list[Stamp]:
    stamps = []
    for name in _names(path):
        if not Path(name).stem.isdecimal():
            raise CameraError(f"{path / name}: this name is not a time in ns: {_TIMES_MISSING}")
        stamps.append(Stamp(name, int(Path(name).stem), str(path / name)))
    return stamps


def _match_names(path: Path, stamps: list[Stamp]) -> None:
    present, stamped = set(_names(path)), set()
    for stamp in stamps:
        if stamp.file not in present:
            raise CameraError(f"{stamp.where}: there is no image {path / stamp.file}")
        if stamp.file in stamped:
            raise CameraError(f"{stamp.where}: {stamp.file} has a line already")
        stamped.add(stamp.file)
    for name in _names(path):
        if name not in stamped:
            raise CameraError(f"{path / name}: has no line in the CSV of stamps")
