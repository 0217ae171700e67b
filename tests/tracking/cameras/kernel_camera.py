"""A camera in the kernel: a driver behind the ioctls of linux/videodev2.h, as OpenCV and robofleet meet it.

Structs are filled as the header lays them out; sizes, errors, rounding and the order in which controls free each other
are those of uvcvideo.
"""

import errno
import struct
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.clock import MS, WallClock, stopwatch_ns
from robofleet.tracking.cameras.v4l2_device import Mode

CAPTURE, METADATA, DEVICE_CAPS = 0x1, 0x00800000, 0x80000000
END_OF_FRAME, START_OF_EXPOSURE = 0x2000, 0x12000  # with MONOTONIC
INTEGER, BOOLEAN, MENU, BUTTON = 1, 2, 3, 4
DISABLED, READ_ONLY, INACTIVE, NEXT = 0x1, 0x4, 0x10, 0x80000000
AUTO_EXPOSURE, EXPOSURE, DYNAMIC_RATE, GAIN = 0x009A0901, 0x009A0902, 0x009A0903, 0x00980913
AUTOFOCUS, FOCUS, ZOOM, SHARPNESS = 0x009A090C, 0x009A090A, 0x009A090D, 0x0098091B
AUTO_WHITE, TEMPERATURE, BACKLIGHT, POWER_LINE = 0x0098090C, 0x0098091A, 0x0098091C, 0x00980918
BRIGHTNESS, DENOISING = 0x00980900, 0x08001234
PERIOD_MS = 1000 / 30
MODES = (Mode("MJPG", 1280, 720, (60.0, 30.0)), Mode("MJPG", 640, 480, (30.0,)), Mode("YUYV", 1280, 720, (10.0,)))


@dataclass(frozen=True)
class Knob:
    """A control. ``lies``: what it is read as, whatever was written; ``streams``: its value when a stream starts;
    ``insists``: and as long as it goes on."""

    id: int
    name: str
    low: int
    high: int
    default: int
    step: int = 1
    kind: int = INTEGER
    flags: int = 0
    manual: tuple[int, int] | None = None  # control and value without which it cannot be written
    lies: int | None = None
    streams: int | None = None
    insists: bool = False


C920 = (  # as `v4l2-ctl --list-ctrls` prints them
    Knob(BRIGHTNESS, "Brightness", 0, 255, 128),
    Knob(AUTO_WHITE, "White Balance, Automatic", 0, 1, 1, kind=BOOLEAN),
    Knob(GAIN, "Gain", 0, 255, 0),
    Knob(POWER_LINE, "Power Line Frequency", 0, 2, 2, kind=MENU),
    Knob(TEMPERATURE, "White Balance Temperature", 2000, 6500, 4000, manual=(AUTO_WHITE, 0)),
    Knob(SHARPNESS, "Sharpness", 0, 255, 128),
    Knob(BACKLIGHT, "Backlight Compensation", 0, 1, 0),
    Knob(AUTO_EXPOSURE, "Auto Exposure", 0, 3, 3, kind=MENU),
    Knob(EXPOSURE, "Exposure Time, Absolute", 3, 2047, 250, manual=(AUTO_EXPOSURE, 1)),
    Knob(DYNAMIC_RATE, "Exposure, Dynamic Framerate", 0, 1, 1, kind=BOOLEAN),
    Knob(FOCUS, "Focus, Absolute", 0, 250, 0, step=5, manual=(AUTOFOCUS, 0)),
    Knob(AUTOFOCUS, "Focus, Automatic Continuous", 0, 1, 1, kind=BOOLEAN),
    Knob(ZOOM, "Zoom, Absolute", 100, 500, 100),
)
CHEAP = (  # names of kernels before 5.14; no disabled item in the menu of the power line
    Knob(GAIN, "Gain", 0, 15, 0),
    Knob(POWER_LINE, "Power Line Frequency", 1, 2, 1, kind=MENU),
    Knob(SHARPNESS, "Sharpness", 1, 7, 3),
    Knob(AUTO_EXPOSURE, "Exposure, Auto", 0, 3, 3, kind=MENU),
    Knob(EXPOSURE, "Exposure (Absolute)", 1, 5000, 156, manual=(AUTO_EXPOSURE, 1)),
    Knob(AUTOFOCUS, "Focus, Auto", 0, 1, 1, kind=BOOLEAN),
)
INDUSTRIAL = (  # nothing by itself; a class's title and a button are listed, too
    Knob(0x00980001, "User Controls", 0, 0, 0, kind=6, flags=READ_ONLY),
    Knob(GAIN, "Gain", 16, 255, 64, step=4),
    Knob(0x0098090D, "Do White Balance", 0, 0, 0, kind=BUTTON),
    Knob(DENOISING, "3D Noise Reduction", 0, 3, 2),
    Knob(EXPOSURE, "Exposure Time, Absolute", 1, 10000, 100),
)


def without(knobs: tuple[Knob, ...], *ids: int) -> tuple[Knob, ...]:
    return tuple(knob for knob in knobs if knob.id not in ids)


def instead(knobs: tuple[Knob, ...], knob: Knob) -> tuple[Knob, ...]:
    return (*without(knobs, knob.id), knob)


class KernelCamera:
    """A driver with one camera."""

    def __init__(
        self, knobs: tuple[Knob, ...] = C920, *, driver: str = "uvcvideo", stamps: int = START_OF_EXPOSURE,
        caps: int = CAPTURE, of_device: int = CAPTURE, modes: tuple[Mode, ...] = MODES,
    ) -> None:  # fmt: skip
        self.driver, self.stamps, self.caps, self.of_device, self.modes = driver, stamps, caps, of_device, modes
        self.buffers = 4  # that OpenCV asked for
        self.plug(knobs)

    def plug(self, knobs: tuple[Knob, ...]) -> None:
        """A camera that was plugged in has its own values."""
        self.streaming = False
        self.knobs = {knob.id: knob for knob in knobs}
        self.has = {knob.id: knob.default for knob in knobs}

    def start_stream(self) -> None:
        self.streaming = True
        self.has |= {knob.id: knob.streams for knob in self.knobs.values() if knob.streams is not None}

    def __call__(self, _descriptor: int, request: int, buffer: bytearray) -> int:
        number, size = request & 0xFF, request >> 16 & 0x3FFF
        assert (request >> 8 & 0xFF, len(buffer)) == (ord("V"), size)
        assert request >> 30 == (2 if number == 0 else 3), "read, or read and written"
        calls = {0: self._capability, 2: self._format, 74: self._size, 75: self._interval}
        calls |= {9: self._buffer, 27: self._get, 28: self._set, 36: self._query}
        try:
            calls[number](buffer)
        except (KeyError, IndexError, ValueError, StopIteration):
            raise OSError(errno.EINVAL, "there is no such thing") from None
        return 0

    def _capability(self, buffer: bytearray) -> None:
        words = self.driver.encode(), b"Eye 3", b"usb-1"
        struct.pack_into("=16s32s32sIII", buffer, 0, *words, 0, self.caps, self.of_device)

    def _format(self, buffer: bytearray) -> None:
        index, kind = struct.unpack_from("=II", buffer)
        assert kind == 1
        letters = list(dict.fromkeys(mode.format for mode in self.modes))
        struct.pack_into("=I32s4s", buffer, 8, 0, b"a format", letters[index].encode())

    def _size(self, buffer: bytearray) -> None:
        index, letters = struct.unpack_from("=I4s", buffer)
        mode = [mode for mode in self.modes if mode.format.encode() == letters][index]
        struct.pack_into("=III", buffer, 8, 1, mode.width, mode.height)

    def _interval(self, buffer: bytearray) -> None:
        index, letters, width, height = struct.unpack_from("=I4sII", buffer)
        mode = next(mode for mode in self.modes if mode[:3] == (letters.decode(), width, height))
        struct.pack_into("=III", buffer, 16, 1, 1000, round(1000 * mode.rates_hz[index]))

    def _buffer(self, buffer: bytearray) -> None:
        index, kind = struct.unpack_from("=II", buffer)
        assert (kind, struct.unpack_from("=I", buffer, 60)[0]) == (1, 1), "images that are mapped"
        range(self.buffers)[index]
        struct.pack_into("=I", buffer, 12, self.stamps)

    def _query(self, buffer: bytearray) -> None:
        (number,) = struct.unpack_from("=I", buffer)
        following = [known for known in self.knobs if known > number & ~NEXT]
        knob = self.knobs[min(following) if number & NEXT else number]
        flags = knob.flags | (INACTIVE if not self._free(knob) else 0)
        struct.pack_into(
            "=II32siiiiI", buffer, 0, knob.id, knob.kind, knob.name.encode(), knob.low, knob.high, knob.step,
            knob.default, flags,
        )  # fmt: skip

    def _get(self, buffer: bytearray) -> None:
        knob = self.knobs[struct.unpack_from("=I", buffer)[0]]
        struct.pack_into("=i", buffer, 4, self.has[knob.id] if knob.lies is None else knob.lies)

    def _set(self, buffer: bytearray) -> None:
        number, value = struct.unpack_from("=Ii", buffer)
        knob = self.knobs[number]
        if knob.flags & READ_ONLY or not self._free(knob):
            raise OSError(errno.EACCES, "it cannot be written now")
        if knob.kind == MENU and not knob.low <= value <= knob.high:
            raise OSError(errno.ERANGE, "the menu has no such item")
        steps = (min(max(value, knob.low), knob.high) - knob.low + knob.step // 2) // knob.step
        if not (self.streaming and knob.insists):
            self.has[number] = min(knob.low + steps * knob.step, knob.high)

    def _free(self, knob: Knob) -> bool:
        return knob.manual is None or self.has[knob.manual[0]] == knob.manual[1]


class Capture:
    """OpenCV's V4L2 capture of such a camera: what it is set to, of which some stays as it is, and its images."""

    def __init__(self, kernel: KernelCamera | None = None, **keeps: float) -> None:
        self.kernel = kernel or KernelCamera()
        self.keeps = {getattr(cv2, f"CAP_PROP_{name}"): value for name, value in keeps.items()}
        self.has: dict[int, float] = {cv2.CAP_PROP_FRAME_WIDTH: 640, cv2.CAP_PROP_FRAME_HEIGHT: 480} | self.keeps
        self.order: list[int] = []
        self.width = 640.0
        self.images: list[tuple[NDArray[Any], float]] = []
        self.stamp_ms = 0.0
        self.opened = True
        self.released = 0
        self.started = False

    def __call__(self, device: str, backend: int) -> "Capture":
        assert Path(device).is_file()
        assert backend == cv2.CAP_V4L2
        self.started = False
        return self

    def isOpened(self) -> bool:
        return self.opened

    def set(self, key: int, value: float) -> bool:
        self.order.append(key)
        if key == cv2.CAP_PROP_FRAME_WIDTH:  # takes effect with the height
            self.width = value
        elif key == cv2.CAP_PROP_FRAME_HEIGHT:
            self.has |= {cv2.CAP_PROP_FRAME_WIDTH: self.width, key: value}
        else:
            self.has[key] = value
        self.has |= self.keeps
        return key not in self.keeps

    def get(self, key: int) -> float:
        return self.stamp_ms if key == cv2.CAP_PROP_POS_MSEC else self.has.get(key, -1.0)

    def read(self) -> tuple[bool, Any]:
        if not self.started:
            self.started = True
            self.kernel.start_stream()
        image = self.next_image()
        if image is None:
            return False, None
        data, self.stamp_ms = image
        return True, data

    def next_image(self) -> tuple[NDArray[Any], float] | None:
        return self.images.pop(0) if self.images else None

    def release(self) -> None:
        self.released += 1


class LiveCapture(Capture):
    """A camera that sends all the time. The driver fills a free buffer, or drops the image if there is none when it
    begins; the reader takes filled ones, oldest first, and gives each back a moment later. Image k is grey k."""

    def __init__(self, kernel: KernelCamera | None = None, *, dark: bool = False, **keeps: float) -> None:
        super().__init__(kernel, **keeps)
        self.dark = dark
        self.now_ms = 0.0
        self.busy_ms = 1.0  # that the reader takes after each image
        self.begun_ms = [0.0]  # when each image began
        self.filling: int | None = None
        self.full: deque[int] = deque()
        self.zero_ms = clocks()[1] - 5000.0

    @property
    def period_ms(self) -> float:
        slow = self.dark and self.kernel.has.get(DYNAMIC_RATE)
        return max(2 * PERIOD_MS if slow else PERIOD_MS, 0.1 * self.kernel.has[EXPOSURE])

    def next_image(self) -> tuple[NDArray[Any], float]:
        self._go_on(self.now_ms)
        while not self.full:
            self._go_on(self.begun_ms[-1] + self.period_ms)
        k = self.full.popleft()
        self.now_ms += self.busy_ms
        shape = int(self.get(cv2.CAP_PROP_FRAME_HEIGHT)), int(self.get(cv2.CAP_PROP_FRAME_WIDTH))
        return np.full(shape, k % 256, np.uint8), self.zero_ms + self.begun_ms[k]

    def _go_on(self, until_ms: float) -> None:
        while self.begun_ms[-1] + self.period_ms <= until_ms:
            self.begun_ms.append(self.begun_ms[-1] + self.period_ms)
            self.now_ms = max(self.now_ms, self.begun_ms[-1])
            if self.filling is not None:
                self.full.append(self.filling)
            free = len(self.full) < self.get(cv2.CAP_PROP_BUFFERSIZE)
            self.filling = len(self.begun_ms) - 1 if free else None


def clocks() -> tuple[int, float]:
    """Return this host's instant [ns], and what the kernel would stamp a buffer with at it [ms].

    That is CLOCK_MONOTONIC, which on Linux the stopwatch reads.
    """
    readings = []
    for _ in range(5):
        before_ns, now_ns, after_ns = stopwatch_ns(), WallClock().now_ns(), stopwatch_ns()
        readings.append((after_ns - before_ns, now_ns, (before_ns + after_ns) / 2 / MS))
    return min(readings)[1:]
