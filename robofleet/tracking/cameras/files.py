"""A recording as a camera (``camera.source: files``): its images come at the times when they were taken."""

from collections.abc import Iterator
from pathlib import Path

from robofleet.config.camera import FilesSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.arrays import Image
from robofleet.core.clock import S
from robofleet.tracking.cameras.recorded import Recording, images, size, within
from robofleet.tracking.sources import CameraContext, CameraError, Frame, PoseContext


class FileCamera:
    """Plays ``camera.files`` as if it were taken now; like a camera, it drops images that nobody is in time for.

    In a run it begins with the controller's first tick: before, nobody would see its images. Elsewhere it begins when
    it is asked for the first image.
    """

    def __init__(self, context: CameraContext) -> None:
        """Open the recording; CameraError if there is anything wrong with it or with its times."""
        camera = context.config.camera
        if camera.files is None:
            raise CameraError("camera.files: no file is named")
        recording = recording_of(camera.files)
        self._path, self.identity = recording.path, recording.path.name
        self._clock, self._ticks = context.clock, context.ticks if isinstance(context, PoseContext) else None
        self._after_ns = round((camera.exposure_s / 2 + camera.readout_s) * S) + context.extra_delay_ns
        self._period_ns = round(S / camera.rate_hz)
        self._shots = recording.shots()
        self._shown, self._end_ns, self._ended = 0, 0, ""
        self._coming = self._next()
        self._shift_ns: int | None = None  # from the recording's clock to this host's

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        """Return what cannot work with this configuration; of the images only the first one is decoded."""
        camera = config.camera
        if camera.trigger == "tick":
            yield "camera.trigger", "images in a file were taken at their own times: set it to free"
        if camera.files is None:
            yield "camera.files", "name a video or a folder of images: {path: ..., stamps: ...}"
            return
        path = Path(camera.files.path)
        try:
            recording_of(camera.files)
            name, image = next(images(path))
        except CameraError as error:
            yield "camera.files", str(error)
        else:
            if image.shape != (camera.height, camera.width):
                message = f"{size(image)}, but camera has {camera.width} x {camera.height}: mend one"
                yield "camera.files.path", f"{within(path, name)}: {message}"

    def ready_ns(self) -> int | None:
        """Return when the next image, or the end, will have come; None: the run has not begun."""
        if self._shift_ns is None:
            if self._ticks is not None and not self._ticks.newest:
                return None
            self._shift_ns = self._clock.now_ns() - (self._coming[0] if self._coming else 0)
        if self._coming is None:
            return self._end_ns + self._shift_ns
        return self._coming[0] + self._shift_ns + self._after_ns

    def read(self) -> Frame:
        """Return the next image when its time has come; EOFError at the end, also at one that comes too early."""
        ready_ns = self.ready_ns()
        if ready_ns is None or self._shift_ns is None:
            raise CameraError(f"{self._path}: the run has not begun")
        self._clock.sleep_until(ready_ns)
        while self._coming is not None:
            taken_ns, image = self._coming
            self._coming = self._next()
            if self._coming is None or self._coming[0] + self._shift_ns + self._after_ns > self._clock.now_ns():
                return Frame(image, taken_ns + self._shift_ns)
        raise EOFError(self._ended)

    def close(self) -> None:
        self._shots = iter(())

    def _next(self) -> tuple[int, Image] | None:
        """Return the image that comes next, and when it was taken [ns; the recording's clock]; None at the end."""
        try:
            shot = next(self._shots)
            image = shot.load()
        except StopIteration:
            self._ended = f"{self._path}: all of its {self._shown} images were shown"
            return None
        except CameraError as error:
            self._ended = str(error)
            return None
        self._shown += 1
        self._end_ns = shot.taken_ns + self._after_ns + self._period_ns
        return shot.taken_ns, image


def recording_of(settings: FilesSettings) -> Recording:
    """Return what ``camera.files`` names; CameraError as ``Recording``."""
    stamps = None if settings.stamps is None else Path(settings.stamps)
    return Recording(Path(settings.path), stamps, settings.rate_hz)
