"""Cameras: where images come from. Found by the entry-point group ``robofleet.cameras`` or as ``module:Class``."""

import threading
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from robofleet.clock import Clock
from robofleet.comms.bus import Bus, Wake
from robofleet.comms.ticks import TickFollower
from robofleet.config.tree import Config


class Frame(NamedTuple):
    """One image."""

    image: NDArray[np.uint8]  # gray (H, W)
    exposure_ns: int  # mid-exposure [this host's clock]


class Camera(Protocol):
    """A camera, called with one :class:`CameraContext`."""

    def read(self) -> Frame:
        """Return the next image, waiting for it; EOFError at the end of a file."""

    def close(self) -> None:
        """Let go of the device. Idempotent."""


@runtime_checkable
class ScheduledCamera(Protocol):
    """A camera that knows when its next image will be there, and needs no thread: a simulated one."""

    def ready_ns(self) -> int | None:
        """Return when ``read`` will not wait; None while that is not known."""


@dataclass(frozen=True)
class CameraContext:
    """What a camera is made from; ``bus`` and ``ticks`` are for a simulated one."""

    config: Config
    clock: Clock
    bus: Bus
    ticks: TickFollower
    rng: np.random.Generator
    extra_delay_ns: int  # from the end of the readout to the image's use (lockstep's charge for the tracker's work)


class CameraReader:
    """Reads a camera that blocks, in a thread of its own, into one newest slot."""

    def __init__(self, camera: Camera, wake: Wake) -> None:
        self._camera, self._wake = camera, wake
        self._newest: deque[Frame] = deque(maxlen=1)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def newest(self) -> Frame | None:
        """Return the newest image not taken yet."""
        return self._newest.pop() if self._newest else None

    def _run(self) -> None:
        while True:
            try:
                self._newest.append(self._camera.read())
            except EOFError:
                return
            self._wake(0)
