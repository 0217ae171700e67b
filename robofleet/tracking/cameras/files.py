"""Images from a file: a video, or a folder with one file an image; as a camera, at the times when they were taken.

The times are in a CSV (see ``stamps.py``); without one, each image of a folder is called after its mid-exposure in ns
(``1714000000123456789.png``).
"""

import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2

from robofleet.config.camera import FilesSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.arrays import Image
from robofleet.core.clock import S
from robofleet.tracking.cameras.stamps import Stamp, read_stamps
from robofleet.tracking.sources import CameraContext, CameraError, Frame

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp"}
_AS_TAKEN = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION  # pixels as the sensor has them


_Entry = tuple[str, Callable[[], Image]]  # an image that was not decoded yet: its name, and what decodes it


def images(path: Path) -> Iterator[tuple[str, Image]]:
    """Return every image of a video or of a folder (sorted by name), or one image, with its name; all of one size.

    Names are those of the files; of a video ``name.avi:frame 12``, counted from 0.

    Raises:
        CameraError: when it comes to something that cannot be read, to the end of a truncated video or to an image
            of another size than the first one.
    """
    first: Image | None = None
    if _is_folder(path):
        entries = _folder(path)
    else:
        entries = iter([_file(path)]) if path.suffix.lower() in _SUFFIXES else _video(path)
    for name, load in entries:
        image = load()
        first = image if first is None else first
        if image.shape != first.shape:
            raise CameraError(f"{_within(path, name)}: {_size(image)}, but the first image has {_size(first)}")
        yield name, image


class FileCamera:
    """Plays ``camera.files`` as if it were taken now; like a camera, it drops images that nobody is in time for."""

    def __init__(self, context: CameraContext) -> None:
        """Read the stamps; CameraError if there is anything wrong with them."""
        camera = context.config.camera
        if camera.files is None:
            raise CameraError("camera.files: no file is named")
        self._path = Path(camera.files.path)
        self.identity = self._path.name
        self._stamps = _stamps(camera.files)
        if _is_folder(self._path):
            self._entries = iter([_file(self._path / stamp.file) for stamp in self._stamps])
        else:
            self._entries = _video(self._path)
        self._clock = context.clock
        self._shift_ns = self._clock.now_ns() - self._stamps[0].exposure_ns
        self._after_ns = round((camera.exposure_s / 2 + camera.readout_s) * S) + context.extra_delay_ns
        self._period_ns = round(S / camera.rate_hz)
        self._next = 0

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        """Return what cannot work with this configuration; of the images only the first one is decoded."""
        camera = config.camera
        if camera.trigger == "tick":
            yield "camera.trigger", "images in a file were taken at their own times: set it to free"
        if camera.files is None:
            yield "camera.files", "name a video or a folder of images: {path: ..., stamps: ...}"
            return
        try:
            _stamps(camera.files)
            name, image = next(images(Path(camera.files.path)))
        except CameraError as error:
            yield "camera.files", str(error)
        else:
            if image.shape != (camera.height, camera.width):
                where = _within(Path(camera.files.path), name)
                message = f"{where}: {_size(image)}, but camera has {camera.width} x {camera.height}: mend one"
                yield "camera.files.path", message

    def ready_ns(self) -> int:
        """Return when the next image, or the end, will have come."""
        if self._next < len(self._stamps):
            return self._exposure_ns(self._next) + self._after_ns
        return self._exposure_ns(-1) + self._after_ns + self._period_ns

    def read(self) -> Frame:
        """Return the next image when its time has come; EOFError at the end, also at one that comes too early."""
        self._clock.sleep_until(self.ready_ns())
        if self._next == len(self._stamps):
            raise EOFError(f"{self._path}: all of its {self._next} images were shown")
        try:
            while True:
                _, load = next(self._entries)
                k, self._next = self._next, self._next + 1
                late = self._next < len(self._stamps) and self.ready_ns() <= self._clock.now_ns()
                if not late:
                    return Frame(load(), self._exposure_ns(k))
        except (CameraError, StopIteration) as error:
            raise EOFError(str(error) or f"{self._path} ends before its stamps do") from error

    def close(self) -> None:
        self._entries = iter(())

    def _exposure_ns(self, k: int) -> int:
        return self._stamps[k].exposure_ns + self._shift_ns


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


def _folder(path: Path) -> Iterator[_Entry]:
    for name in _names(path):
        yield _file(path / name)


def _names(path: Path) -> list[str]:
    """Return the names of the images in a folder, numbers in them in their order: 9 before 10."""
    names = [f.name for f in path.iterdir() if f.suffix.lower() in _SUFFIXES and not f.name.startswith(".")]
    if not names:
        raise CameraError(f"{path}: there is no image in this folder ({', '.join(sorted(_SUFFIXES))})")
    return sorted(names, key=lambda name: [int(p) if p.isdecimal() else p for p in re.split(r"(\d+)", name)])


def _file(file: Path) -> _Entry:
    def load() -> Image:
        try:
            image = cv2.imread(str(file), _AS_TAKEN)
        except cv2.error:  # of a size that cannot be
            image = None
        if image is None:
            raise CameraError(f"{file}: cannot be read as an image")
        return image  # type: ignore[return-value]

    return file.name, load


def _video(path: Path) -> Iterator[_Entry]:
    capture, frames = _opened(path)
    try:
        k = 0
        while capture.grab():

            def load(name: str = f"{path.name}:frame {k}") -> Image:
                decoded, image = capture.retrieve()
                if not decoded:
                    raise CameraError(f"{_within(path, name)} cannot be decoded")
                return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image  # type: ignore[return-value]

            yield f"{path.name}:frame {k}", load
            k += 1
        if k < max(frames, 1):
            raise CameraError(f"{path}:frame {k}: cannot be read: the video is truncated, it should have {frames}")
    finally:
        capture.release()


def _opened(path: Path) -> tuple[cv2.VideoCapture, int]:
    """Return a video and how many frames it says it has; not positive if it does not know."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    if not capture.isOpened():
        raise CameraError(f"{path}: cannot be read as a video: it is none, or it was not written to its end")
    return capture, round(capture.get(cv2.CAP_PROP_FRAME_COUNT))


def _stamps(settings: FilesSettings) -> list[Stamp]:
    """Return the stamps of all images in their order; CameraError unless they match the images one to one."""
    path = Path(settings.path)
    if _is_folder(path):
        stamps = _own_names(path) if settings.stamps is None else read_stamps(Path(settings.stamps), named=True)
        _match_names(path, stamps)
    else:
        capture, frames = _opened(path)
        capture.release()
        if settings.stamps is None:
            raise CameraError(f"{path}: its frames have no times: name a CSV of them in camera.files.stamps")
        stamps = read_stamps(Path(settings.stamps), named=False)
        if len(stamps) > frames > 0:
            raise CameraError(f"{stamps[frames].where}: is for frame {frames}, but {path} has {frames} frames")
        if len(stamps) < frames:
            raise CameraError(f"{settings.stamps}:{len(stamps) + 2}: no line for {path}:frame {len(stamps)}")
    for before, stamp in itertools.pairwise(stamps):
        if stamp.exposure_ns <= before.exposure_ns:
            raise CameraError(f"{stamp.where}: is not later than the one before: sort the lines by time")
    return stamps


def _own_names(path: Path) -> list[Stamp]:
    stamps = []
    for name in _names(path):
        if not Path(name).stem.isdecimal():
            raise CameraError(f"{path / name}: this name is not a time in ns: name a CSV in camera.files.stamps")
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


def _within(path: Path, name: str) -> Path:
    return path / name if path.is_dir() else path.with_name(name)


def _size(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px"
