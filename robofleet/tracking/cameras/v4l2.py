"""A camera of the kernel's (Video4Linux): images through OpenCV, controls and stamps by the kernel's own interface."""

import fcntl
import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.camera import CameraSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, from_monotonic
from robofleet.tracking.cameras.v4l2_controls import EXPOSURE_TIME, EXPOSURE_UNIT_S, FOCUS, GAIN, CameraControls
from robofleet.tracking.cameras.v4l2_device import UVCVIDEO, Device, Ioctl, sysfs_line
from robofleet.tracking.sources import (
    CameraContext,
    CameraError,
    Exposure,
    ExposureChange,
    ExposureLimits,
    Frame,
    start_to_middle_ns,
    unmeasured,
)

# The driver fills one buffer while the last image waits in another. With one alone it has none when the next image
# begins, and drops that. More would keep older images when the reader is late.
_BUFFERS = 3
_GAIN_DB = 24.0  # that a gain's range is taken for: no driver tells; the loop corrects what is wrong with it
_SAME_RATE = 0.01  # drivers round it
_OLDEST_STAMP_NS = 10 * S  # an older stamp is of another clock
_AHEAD_NS = 10 * MS
_CLOSE_WITHIN_S = 0.2
_SYSFS = Path("/sys/class/video4linux")


class V4L2Camera:
    """Reads ``camera.v4l2.device``; CameraError with everything that it did not take over."""

    def __init__(
        self,
        context: CameraContext,
        open_capture: Callable[[str, int], Any] = cv2.VideoCapture,
        ioctl: Ioctl = fcntl.ioctl,
        uvcvideo: Path = UVCVIDEO,
    ) -> None:
        camera = context.config.camera
        self._device, self._luminance = camera.v4l2.device, _LUMINANCE[camera.v4l2.format]
        self._clock, self._camera, self._uvcvideo = context.clock, camera, uvcvideo
        self._exposing = ExposureChange(Exposure(camera.exposure_s, float(camera.v4l2.gain or 0)))
        self._first = True  # whose stamp and controls are looked at; of later stamps ``watch.py`` judges
        self._reading = threading.Lock()
        try:
            self._kernel = Device(self._device, ioctl)
        except OSError as error:
            raise CameraError(f"{self._device} cannot be opened: {error.strerror}: is it plugged in?") from error
        self._capture = open_capture(self._device, cv2.CAP_V4L2)
        try:
            self._set_up(camera)
            self.controls = CameraControls(self._kernel, camera)
            self._refuse(self.controls.refused, self._refused_format(camera))
        except CameraError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise CameraError(f"{self._device} fails: {error.strerror}: plug it in again") from error
        self.driver = self._kernel.driver
        self.stamp = camera.v4l2.stamp or self._kernel.stamped_instant(uvcvideo)
        self.identity = device_identity(Path(self._device))
        if FOCUS in self.controls.of_device:  # the lens is another one
            self.identity += f" focus {self._kernel.get(FOCUS)}"

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        settings = config.camera.v4l2
        device = Path(settings.device)
        if not device.is_char_device():
            found = ", ".join(str(path) for path in sorted(Path("/dev").glob("video*"))) or "none"
            yield "camera.v4l2.device", f"there is no camera {device} (there are: {found}): plug it in, or name another"
        elif not os.access(device, os.R_OK | os.W_OK):
            yield "camera.v4l2.device", f"{device} may not be opened: add this user to the device's group (video)"
        if config.camera.trigger == "tick":
            yield "camera.trigger", "a V4L2 camera keeps its own time: set it to free"
        yield from unmeasured(config)

    def read(self) -> Frame:
        """Return the next image; one that did not arrive whole is passed over."""
        while True:
            with self._reading:
                self._take_over()
                arrived, data = self._capture.read()
                stamp_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
            if not arrived:
                raise CameraError(f"{self._device} gives no image: is it plugged in?")
            stamp_ns = from_monotonic(round(stamp_ms * MS))
            if self._first:
                self._refuse_first(stamp_ns)
            image = self._luminance(data)
            if image is not None:
                return self._frame(image, stamp_ns)

    def exposure_limits(self) -> ExposureLimits:
        """Return what the device can be set to; its gain's decibels are assumed."""
        times, gain = self.controls.of_device[EXPOSURE_TIME], self._exposing.newest.gain
        low, high, step = gain, gain, 1.0
        if self._camera.v4l2.gain is not None:
            gains = self.controls.of_device[GAIN]
            low, high, step = gains.low, gains.high, max(gains.step, 1)
        return ExposureLimits(
            Exposure(max(times.low, 1) * EXPOSURE_UNIT_S, low),
            Exposure(times.high * EXPOSURE_UNIT_S, high),
            Exposure(max(times.step, 1) * EXPOSURE_UNIT_S, step),
            _GAIN_DB / max(high - low, 1),
        )

    def adjust(self, exposure: Exposure) -> None:
        """Expose so from the image after the one that is awaited."""
        self._exposing.ask(exposure)

    def close(self) -> None:
        """Close the device; one that waits for an image is left to the end of the process."""
        if self._reading.acquire(timeout=_CLOSE_WITHIN_S):
            try:
                self._capture.release()
                self._kernel.close()
            finally:
                self._reading.release()

    def _take_over(self) -> None:
        """Set what was asked for, and note what the device made of it."""
        change = self._exposing.take()
        if change is None:
            return
        time_s = self.controls.adjust(EXPOSURE_TIME, round(change.time_s / EXPOSURE_UNIT_S)) * EXPOSURE_UNIT_S
        gain = change.gain
        if self._camera.v4l2.gain is not None:
            gain = float(self.controls.adjust(GAIN, round(gain)))
        self._exposing.done(Exposure(time_s, gain), self._clock.now_ns())

    def _frame(self, image: NDArray[np.uint8], stamp_ns: int) -> Frame:
        exposure = self._exposing.of(stamp_ns - self._to_stamp_ns(self._exposing.newest.time_s))
        began_ns = stamp_ns - self._to_stamp_ns(exposure.time_s)
        return Frame(image, began_ns + start_to_middle_ns(self._camera, exposure.time_s), exposure)

    def _to_stamp_ns(self, exposure_s: float) -> int:
        """Return the time from the start of the first row's exposure to the stamp [ns]."""
        exposed_s = {"start": 0.0, "transfer": exposure_s, "end": exposure_s + self._camera.readout_s}
        return round(exposed_s[self.stamp] * S)

    def _refuse_first(self, stamp_ns: int) -> None:
        """Raise CameraError where the first image shows another clock, or its stream brought old settings back."""
        if not -_AHEAD_NS <= self._clock.now_ns() - stamp_ns <= _OLDEST_STAMP_NS:
            clock = sysfs_line(self._uvcvideo / "clock") if self.driver == "uvcvideo" else ""
            cure = f": `echo CLOCK_MONOTONIC | sudo tee {self._uvcvideo / 'clock'}`" if "REAL" in clock else ""
            raise CameraError(f"{self._device} stamps its images by another clock than CLOCK_MONOTONIC{cure}")
        self._refuse(self.controls.keep())
        self._first = False

    def _set_up(self, camera: CameraSettings) -> None:
        if not self._capture.isOpened():
            raise CameraError(f"{self._device} gives no images: does another program use it?")
        # First: it makes OpenCV ask for format and rate anew, and for the rate wrongly if it is no whole number.
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, _BUFFERS)
        for _, key, wanted_value in _wanted(camera):
            self._capture.set(key, wanted_value)

    def _refused_format(self, camera: CameraSettings) -> list[str]:
        """Return what the device has not; read only now, since width and height take effect together."""
        return [
            f"{name} {_shown(key, value)} (it has {_shown(key, got)})"
            for name, key, value in _wanted(camera)
            if not math.isclose(
                got := self._capture.get(key), value, rel_tol=_SAME_RATE if key == cv2.CAP_PROP_FPS else 0.0
            )
        ]

    def _refuse(self, controls: list[str], formats: Sequence[str] = ()) -> None:
        if controls or formats:
            hint = f"`v4l2-ctl -d {self._device} --list-formats-ext --list-ctrls` tells what it can do"
            if controls:
                hint += "; `camera.v4l2.controls: {NAME: null}` leaves a control as it is"
            raise CameraError(f"{self._device} does not accept {'; '.join([*formats, *controls])}. {hint}")


def device_identity(device: Path, sysfs: Path = _SYSFS) -> str:
    """Return a camera's name and serial number; without one, the socket that it is plugged into."""
    entry = sysfs / device.resolve().name
    name = sysfs_line(entry / "name")
    if not name:
        return str(device)
    interface = (entry / "device").resolve()  # of a USB device, which has the serial number
    serial = sysfs_line(interface.parent / "serial")
    return f"{name} {serial}" if serial else f"{name} at {interface.name}"


def _wanted(camera: CameraSettings) -> Iterator[tuple[str, int, float]]:
    """Return name, OpenCV's property and value of every setting, in an order that the kernel accepts."""
    yield "camera.v4l2.format", cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*camera.v4l2.format.ljust(4))
    yield "camera.width", cv2.CAP_PROP_FRAME_WIDTH, camera.width
    yield "camera.height", cv2.CAP_PROP_FRAME_HEIGHT, camera.height
    yield "camera.rate_hz", cv2.CAP_PROP_FPS, camera.rate_hz
    yield "raw images", cv2.CAP_PROP_CONVERT_RGB, 0  # the luminance alone is decoded, by us


def _shown(key: int, value: float) -> str:
    if key == cv2.CAP_PROP_FOURCC and value > 0:
        return int(value).to_bytes(4, "little").decode(errors="replace").rstrip()
    return f"{value:g}"


def _decoded(data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the luminance of a JPEG; None if it is broken."""
    with suppress(cv2.error):  # no bytes at all, or a size that cannot be
        return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)  # type: ignore[return-value]
    return None


_LUMINANCE: dict[str, Callable[[NDArray[Any]], Any]] = {  # of what OpenCV hands out without conversion
    "MJPG": _decoded,
    "GREY": lambda data: data,
    "YUYV": lambda data: cv2.extractChannel(data, 0),  # (H, W, 2): Y U, Y V
    "UYVY": lambda data: cv2.extractChannel(data, 1),
    "NV12": lambda data: data[: len(data) * 2 // 3],  # (3 H / 2, W): the luminance, then half-size colours
    "Y10": lambda data: cv2.convertScaleAbs(data, alpha=1 / 4),  # (H, W) of 16 bits
    "Y16": lambda data: cv2.convertScaleAbs(data, alpha=1 / 256),
}
