"""Where poses and images come from: pose sources and cameras, found by the entry-point groups ``robofleet.poses`` and
``robofleet.cameras`` or as ``module:Class``.

A camera just reads and raises. One that fails is closed and opened again, ever more patiently, for as long as it takes:
by a thread where reading waits (``Reader``), between two steps where it does not (``Poller``). Motion-capture systems
are read in the same way.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, MemoryBus, Wake
from robofleet.bus.messages import TagPose
from robofleet.bus.ticks import TickFollower
from robofleet.config.camera import CameraSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.core.errors import RobofleetError
from robofleet.tracking.events import Notice, TrackerEvent

_FIRST_PAUSE_S = 0.2  # before a camera that failed is opened again; doubled from one failure to the next
_LONGEST_PAUSE_S = 2.0
_LAST_IMAGE_S = 0.2  # a reader that ends waits so long for the image that is under way


Image_co = TypeVar("Image_co", covariant=True)  # a Frame of a camera, or a CaptureFrame


class CameraError(RobofleetError):
    """Raised where a camera or another pose source cannot be used. The message says what is wrong, and the cure."""


class Exposure(NamedTuple):
    """How a camera exposes.

    Attributes:
        time_s: Exposure time of each row [s].
        gain: Gain [the camera's own units].
    """

    time_s: float
    gain: float


class ExposureLimits(NamedTuple):
    """What a camera can be set to.

    Attributes:
        shortest: The shortest time and the least gain.
        longest: The longest time and the greatest gain.
        step: From one possible setting to the next. 0: any.
        gain_db: One unit of the gain [dB]; roughly, where the camera does not tell.
    """

    shortest: Exposure
    longest: Exposure
    step: Exposure
    gain_db: float


class Frame(NamedTuple):
    """One image.

    Attributes:
        image: Grey levels (H, W).
        exposure_ns: Mid-exposure, of the middle row if the shutter rolls [ns; this host's clock].
        exposure: How it was exposed, as far as an ``AdjustableCamera`` knows.
    """

    image: NDArray[np.uint8]
    exposure_ns: int
    exposure: Exposure | None = None


class Lost(NamedTuple):
    """No image, and there will be none for a while."""

    event: TrackerEvent
    why: str


class Camera(Protocol):
    """A camera, made from one :class:`CameraContext`; its constructor raises if it cannot be opened.

    Its class may have a static method ``refusals(config)``, which returns what cannot work as (dotted path, what is
    wrong): ``robofleet check`` calls it before anything is opened.

    Attributes:
        identity: Which device this is, as its calibration names it.
    """

    identity: str

    def read(self) -> Frame:
        """Wait for the next image.

        Returns:
            The image with its mid-exposure.

        Raises:
            EOFError: A file has no more images. Any other exception counts as unplugged: the camera is opened again.
        """

    def close(self) -> None:
        """Let go of the device. Idempotent; a ``read`` that still waits in another thread may fail."""


@runtime_checkable
class ScheduledCamera(Protocol):
    """A camera that knows when its next image will be there, and needs no thread: a simulated one, or a file."""

    def ready_ns(self) -> int | None:
        """Return when ``read`` will not wait.

        Returns:
            An instant [ns; this host's clock]. None while it is not known.
        """


@runtime_checkable
class AdjustableCamera(Protocol):
    """A camera whose exposure can be changed between two images. Its frames carry their ``exposure``."""

    def exposure_limits(self) -> ExposureLimits:
        """Return what the camera can be set to.

        Returns:
            Exposure times [s] and gains.
        """

    def adjust(self, exposure: Exposure) -> None:
        """Expose so as soon as possible. Return at once, also while ``read`` waits in another thread.

        Mid-exposures of images that follow ticks stay where they are: the exposure begins half the change earlier.

        Args:
            exposure: Exposure time [s] and gain, within the limits.
        """


@dataclass(frozen=True, kw_only=True)
class CameraContext:
    """What a camera is made from; ``bus`` is for a simulated one, ``ticks`` for one that they trigger.

    Attributes:
        config: The configuration. ``config.camera`` is this camera's.
        clock: The process's clock.
        bus: The bus, for a simulated camera.
        ticks: The controller's ticks, for a camera that they trigger.
        rng: Random numbers of the camera.
        extra_delay_ns: Time from the end of the readout to the image's use [ns]: what lockstep charges for the
            tracker's work.
    """

    config: Config
    clock: Clock
    bus: Bus
    ticks: TickFollower
    rng: np.random.Generator
    extra_delay_ns: int

    @classmethod
    def without_run(cls, config: Config, clock: Clock) -> "CameraContext":
        """Return what a camera is made from where no run is: nobody ticks, and its bus is its own.

        Args:
            config: The configuration, whose ``camera`` is opened.
            clock: The clock of its images.

        Returns:
            The context.
        """
        bus = MemoryBus(config.arena.name, clock, 0)
        ticks = TickFollower(bus, round(config.controller.tick_s * S), lambda _: None)
        return CameraContext(
            config=config, clock=clock, bus=bus, ticks=ticks, rng=np.random.default_rng(config.run.seed),
            extra_delay_ns=0,
        )  # fmt: skip


def start_to_middle_ns(camera: CameraSettings, exposure_s: float) -> int:
    """Return the time from the start of the first row's exposure to the middle row's mid-exposure [ns]."""
    rolling_s = camera.model.line_time_s * (camera.height - 1)
    return round((exposure_s + rolling_s) / 2 * S)


class ExposureChange:
    """Which exposure an image has while a camera changes it: the old one, if it began before the change."""

    def __init__(self, exposure: Exposure) -> None:
        self.newest = self._before = exposure
        self._requested: Exposure | None = None
        self._since_ns = 0

    def ask(self, exposure: Exposure) -> None:
        """Note what is wanted, from any thread."""
        self._requested = exposure

    def take(self) -> Exposure | None:
        change, self._requested = self._requested, None
        return change

    def done(self, exposure: Exposure, now_ns: int) -> None:
        """Note what the camera has from now on."""
        self._before, self.newest, self._since_ns = self.newest, exposure, now_ns

    def of(self, began_ns: int) -> Exposure:
        """Return the exposure of an image by when it began [ns]."""
        return self.newest if began_ns >= self._since_ns else self._before


def unmeasured(config: Config) -> Iterator[Complaint]:
    """Refuse a real camera with a lens that nobody measured: the shipped one's numbers are of no camera at all."""
    model = config.camera.model
    if model.intrinsics is None and not model.camera:
        why = "nobody has measured this camera's lens: `robofleet calibrate intrinsics` writes a file for camera.model"
        other = "if it was measured by other means, write the device's name as `camera` into that file"
        yield "camera.source", f"{why}; {other}"


class Readable(Protocol[Image_co]):
    """A camera, or a motion-capture system."""

    def read(self) -> Image_co | None:
        """Wait for the next image. None: nothing new came."""

    def close(self) -> None:
        """Let go of the device. Idempotent."""


class ReopenedCamera(Generic[Image_co]):
    """A camera that is opened again when it fails, and that must be the one which was calibrated."""

    def __init__(
        self, camera: Readable[Image_co], open_again: Callable[[], Readable[Image_co]], calibrated: str
    ) -> None:
        """Take a camera that is open; ``calibrated``: its identity, empty if any camera will do."""
        self.camera: Readable[Image_co] | None = camera
        self._open, self._calibrated = open_again, calibrated
        self._pause_s = _FIRST_PAUSE_S

    def read(self) -> Image_co | Lost | None:
        """Return the next image, waiting for it, or why there is none; None when the camera was opened just now."""
        camera = self.camera
        try:
            if camera is None:
                self.camera = self._open()
                return None
            identity = getattr(camera, "identity", "")
            if self._calibrated and identity != self._calibrated:
                self.close()
                why = f"this camera is {identity!r}, the calibration is for {self._calibrated!r}: plug in that one"
                return Lost(TrackerEvent.CAMERA_STRANGE, why + ", or calibrate this one")
            frame = camera.read()
        except EOFError as end:
            return Lost(TrackerEvent.CAMERA_ENDED, str(end))
        except Exception as error:  # noqa: BLE001 - a camera is anybody's: whatever it raises, it gives no image
            self.close()
            return Lost(TrackerEvent.CAMERA_UNPLUGGED, str(error) or type(error).__name__)
        self._pause_s = _FIRST_PAUSE_S
        return frame

    def exposure_limits(self) -> ExposureLimits | None:
        """Return what the camera can be set to; None if it cannot be adjusted, or is away."""
        camera = self.camera
        return camera.exposure_limits() if isinstance(camera, AdjustableCamera) else None

    def adjust(self, exposure: Exposure) -> None:
        """Change how the camera exposes, unless it is away."""
        camera = self.camera
        if isinstance(camera, AdjustableCamera):
            camera.adjust(exposure)

    def pause_s(self) -> float:
        """Return how long to wait before the next ``read`` after one that lost the camera [s]."""
        pause_s = self._pause_s
        self._pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
        return pause_s

    def close(self) -> None:
        """Let go of the device, also of one that is gone and says so. Idempotent."""
        camera, self.camera = self.camera, None
        if camera is not None:
            with suppress(Exception):
                camera.close()


class Observation(NamedTuple):
    """What one image says.

    Attributes:
        exposure_ns: Instant of the measurement: mid-exposure [ns; this host's clock].
        poses: One pose for each robot that was seen.
        refused: How many candidates were refused so far.
        image: The image to look at, until the next one: grey levels (H, W). None: there is no camera.
    """

    exposure_ns: int
    poses: tuple[TagPose, ...]
    refused: int
    image: NDArray[np.uint8] | None = None


class PoseSource(Protocol):
    """Gives observations as they become ready. Made from one :class:`PoseContext`; its constructor raises CameraError
    if it cannot be opened.

    Its class may have static methods:

    - ``refusals(config)`` returns what cannot work as (dotted path, what is wrong), and opens nothing.
    - ``unreachable(config)`` asks who is there, and returns what does not answer, in the same form.
    - ``works_in_lockstep(config)`` returns whether it uses ``context.clock`` alone, without a thread.
    """

    def next_ns(self) -> int | None:
        """Return when the next observation will be ready.

        Returns:
            An instant [ns; this host's clock]. None: a message or ``context.wake`` will wake the process.
        """

    def observe(self, now_ns: int) -> Observation | None:
        """Take the observation that is ready.

        Args:
            now_ns: The instant of this step [ns; this host's clock].

        Returns:
            The instant of the measurement and the poses. None: nothing is ready.
        """

    def news(self) -> tuple[Notice, ...]:
        """Take what happened to the camera and to the tags since the last call, with an image or without one.

        Returns:
            The events in their order.
        """

    def close(self) -> None:
        """Let go of the device. Idempotent."""


class Feed(Protocol):
    """A camera's images as they become ready; the camera is opened again when it fails."""

    @property
    def device(self) -> ReopenedCamera[Frame]:
        """The camera."""

    def next_ns(self) -> int | None:
        """Return when there will be something to take [ns]; None: not known, or an image wakes the process."""

    def take(self, now_ns: int) -> Frame | Lost | None:
        """Return the image that is there, or why there is none."""

    def close(self) -> None:
        """Let go of the camera."""


@dataclass(frozen=True, kw_only=True)
class PoseContext(CameraContext):
    """What a pose source is made from.

    Attributes:
        wake: Wakes the process, which then observes. Any thread may call it, with an instant [ns].
        real_time: Whether the run is in real time. Else it is in lockstep.
        around: Puts faults on purpose around a camera's images.
    """

    wake: Wake
    real_time: bool
    around: Callable[[Feed], Feed]


class Reader(Generic[Image_co]):
    """Reads a camera that blocks, in a thread of its own. Of images that nobody took the newest one is kept."""

    def __init__(self, device: ReopenedCamera[Image_co], wake: Wake) -> None:
        self.device, self._wake = device, wake
        self._taken: deque[Image_co | Lost] = deque()
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def next_ns(self) -> int | None:
        """Return None: an image wakes the process."""
        return None

    def take(self, now_ns: int) -> Image_co | Lost | None:
        """Return the newest image not taken yet, or what happened before it."""
        with self._lock:
            return self._taken.popleft() if self._taken else None

    def close(self) -> None:
        """End the thread, over which an interpreter that ends may abort, and let go of the camera; one that is silent
        keeps its thread."""
        self._closing.set()
        self._thread.join(_LAST_IMAGE_S)
        self.device.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            taken = self.device.read()
            if taken is None:
                continue
            with self._lock:
                if self._taken and not isinstance(taken, Lost) and not isinstance(self._taken[-1], Lost):
                    self._taken.pop()
                self._taken.append(taken)
            self._wake(0)
            if isinstance(taken, Lost):
                if taken.event is TrackerEvent.CAMERA_ENDED:
                    return
                self._closing.wait(self.device.pause_s())


class Poller(Generic[Image_co]):
    """Reads a :class:`ScheduledCamera` when its image is there: lockstep has no threads."""

    def __init__(self, device: ReopenedCamera[Image_co]) -> None:
        self.device = device
        self._again_ns = 0
        self._ended = False

    def next_ns(self) -> int | None:
        if self._ended:
            return None
        camera = self.device.camera
        ready_ns = getattr(camera, "ready_ns", None)  # faster than to ask whether it is a ScheduledCamera
        return self._again_ns if ready_ns is None else ready_ns()

    def take(self, now_ns: int) -> Image_co | Lost | None:
        due_ns = self.next_ns()
        if due_ns is None or due_ns > now_ns:
            return None
        taken = self.device.read()
        if isinstance(taken, Lost):
            self._ended = taken.event is TrackerEvent.CAMERA_ENDED
            self._again_ns = now_ns + round(self.device.pause_s() * S)
        return taken

    def close(self) -> None:
        self.device.close()
