"""A camera of the kernel's (Video4Linux) through OpenCV: one buffer, exposure and gain by hand, the kernel's stamps."""

import fcntl
import math
import os
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.camera import CameraSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, from_monotonic
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

EXPOSURE_ABSOLUTE, GAIN = 0x009A0902, 0x00980913  # V4L2_CID_EXPOSURE_ABSOLUTE [100 us], V4L2_CID_GAIN
_QUERYCTRL = 0xC0445624
_CONTROL = struct.Struct("=II32siiiiI2I")  # id, type, name, low, high, step, default, flags
_UNUSABLE_FLAGS = 0x1 | 0x4  # disabled, read only

Ioctl = Callable[[int, int, bytearray], object]


class Range(NamedTuple):
    """The values that a control can have."""

    low: int
    high: int
    step: int


def control_range(path: str, control: int, ioctl: Ioctl = fcntl.ioctl) -> Range | None:
    """Return the range of a device's control; None where it has no such control."""
    buffer = bytearray(_CONTROL.pack(control, 0, b"", 0, 0, 0, 0, 0, 0, 0))
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        ioctl(descriptor, _QUERYCTRL, buffer)
    except OSError:
        return None
    finally:
        os.close(descriptor)
    _, _, _, low, high, step, _, flags, _, _ = _CONTROL.unpack(buffer)
    return None if flags & _UNUSABLE_FLAGS else Range(low, high, step)


_MANUAL_EXPOSURE = 1  # V4L2_EXPOSURE_MANUAL
_EXPOSURE_UNIT_S = 1e-4  # of V4L2_CID_EXPOSURE_ABSOLUTE
_GAIN_DB = 24.0  # that a gain's range is taken for: no driver tells; the loop corrects what is wrong with it
_ROUNDED = {cv2.CAP_PROP_FPS: 0.01, cv2.CAP_PROP_EXPOSURE: 0.05}  # drivers round to what the sensor can do
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
        ask_range: Callable[[str, int], Range | None] = control_range,
    ) -> None:
        camera = context.config.camera
        self._device, self._gray = camera.v4l2.device, camera.v4l2.format == "GREY"
        self._clock, self._camera, self._ask = context.clock, camera, ask_range
        self._exposing = ExposureChange(Exposure(camera.exposure_s, float(camera.v4l2.gain or 0)))
        self._stamped = False  # by the right clock: the first image tells; of later ones ``watch.py`` judges
        self.identity = device_identity(Path(self._device))
        self._reading = threading.Lock()
        self._capture = open_capture(self._device, cv2.CAP_V4L2)
        try:
            self._set_up(camera)
        except CameraError:
            self.close()
            raise

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
            image = data if self._gray else _decoded(data)
            if image is not None:
                return self._frame(image, stamp_ms)

    def exposure_limits(self) -> ExposureLimits:
        """Return what the device can be set to; its gain's decibels are assumed."""
        times, gains = self._ask(self._device, EXPOSURE_ABSOLUTE), None
        if self._camera.v4l2.gain is not None:
            gains = self._ask(self._device, GAIN)
        if times is None:
            raise CameraError(f"{self._device} tells no exposure times: set camera.exposure_control to fixed")
        low, high, step = gains or Range(int(self._exposing.newest.gain), int(self._exposing.newest.gain), 1)
        return ExposureLimits(
            Exposure(max(times.low, 1) * _EXPOSURE_UNIT_S, low),
            Exposure(times.high * _EXPOSURE_UNIT_S, high),
            Exposure(max(times.step, 1) * _EXPOSURE_UNIT_S, max(step, 1)),
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
            finally:
                self._reading.release()

    def _take_over(self) -> None:
        """Set what was asked for, and note what the device made of it."""
        change = self._exposing.take()
        if change is None:
            return
        self._capture.set(cv2.CAP_PROP_EXPOSURE, round(change.time_s / _EXPOSURE_UNIT_S))
        gain = change.gain
        if self._camera.v4l2.gain is not None:
            self._capture.set(cv2.CAP_PROP_GAIN, round(gain))
            gain = self._capture.get(cv2.CAP_PROP_GAIN)
        time_s = self._capture.get(cv2.CAP_PROP_EXPOSURE) * _EXPOSURE_UNIT_S
        self._exposing.done(Exposure(time_s, gain), self._clock.now_ns())

    def _frame(self, image: NDArray[np.uint8], stamp_ms: float) -> Frame:
        stamp_ns = from_monotonic(round(stamp_ms * MS))
        if not self._stamped and not -_AHEAD_NS <= self._clock.now_ns() - stamp_ns <= _OLDEST_STAMP_NS:
            raise CameraError(f"{self._device} stamps its images by another clock than CLOCK_MONOTONIC")
        self._stamped = True
        to_end_s = self._exposing.newest.time_s + self._camera.readout_s if self._camera.v4l2.stamp == "end" else 0.0
        exposure = self._exposing.of(stamp_ns - round(to_end_s * S))
        if to_end_s:
            stamp_ns -= round((exposure.time_s + self._camera.readout_s) * S)
        return Frame(image, stamp_ns + start_to_middle_ns(self._camera, exposure.time_s), exposure)

    def _set_up(self, camera: CameraSettings) -> None:
        if not self._capture.isOpened():
            raise CameraError(f"{self._device} cannot be opened: is it plugged in, and does no other program use it?")
        wanted = list(_wanted(camera))
        for _, key, wanted_value in wanted:
            self._capture.set(key, wanted_value)
        # Read back only now: width and height take effect together, and a reset may change what was set before.
        refused = [
            f"{name} {_shown(key, wanted_value)} (it has {_shown(key, got)})"
            for name, key, wanted_value in wanted
            if not math.isclose(got := self._capture.get(key), wanted_value, rel_tol=_ROUNDED.get(key, 0.0))
        ]
        if refused:
            hint = f"`v4l2-ctl -d {self._device} --list-formats-ext --list-ctrls` tells what it can do"
            raise CameraError(f"{self._device} does not accept {', '.join(refused)}: {hint}")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # a driver that needs more keeps them: the stamps stay right
        self._capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)  # where there is one, it would end the calibration


def device_identity(device: Path, sysfs: Path = _SYSFS) -> str:
    """Return a camera's name and serial number; without one, the socket that it is plugged into."""
    entry = sysfs / device.resolve().name
    name = _line(entry / "name")
    if not name:
        return str(device)
    interface = (entry / "device").resolve()  # of a USB device, which has the serial number
    serial = _line(interface.parent / "serial")
    return f"{name} {serial}" if serial else f"{name} at {interface.name}"


def _wanted(camera: CameraSettings) -> Iterator[tuple[str, int, float]]:
    """Return name, OpenCV's property and value of every setting, in an order that the kernel accepts."""
    yield "camera.v4l2.format", cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*camera.v4l2.format)
    yield "camera.width", cv2.CAP_PROP_FRAME_WIDTH, camera.width
    yield "camera.height", cv2.CAP_PROP_FRAME_HEIGHT, camera.height
    yield "camera.rate_hz", cv2.CAP_PROP_FPS, camera.rate_hz
    yield "raw images", cv2.CAP_PROP_CONVERT_RGB, 0  # the luminance alone is decoded, by us
    yield "manual exposure", cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE
    yield "camera.exposure_s", cv2.CAP_PROP_EXPOSURE, max(1, round(camera.exposure_s / _EXPOSURE_UNIT_S))
    if camera.v4l2.gain is not None:
        yield "camera.v4l2.gain", cv2.CAP_PROP_GAIN, camera.v4l2.gain


def _shown(key: int, value: float) -> str:
    if key == cv2.CAP_PROP_FOURCC and value > 0:
        return int(value).to_bytes(4, "little").decode(errors="replace")
    return f"{value * _EXPOSURE_UNIT_S:g}" if key == cv2.CAP_PROP_EXPOSURE else f"{value:g}"


def _decoded(data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the luminance of a JPEG; None if it is broken."""
    try:
        return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)  # type: ignore[return-value]
    except cv2.error:  # no bytes at all, or a size that cannot be
        return None


def _line(file: Path) -> str:
    try:
        return file.read_text().strip()
    except (OSError, UnicodeDecodeError):
        return ""
