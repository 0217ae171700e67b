"""Photographs of what a projector shows, by every camera, and how late its light comes."""

from collections.abc import Mapping

import numpy as np

from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array, Image
from robofleet.core.clock import Clock, S
from robofleet.projection.display import Display
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.sources import Camera, CameraError, Frame

_SETTLED_NS = 4 * S // 10  # from a picture's drawing until its light is there for sure
_IMAGES = 8  # that are averaged
_SWITCHES = 8  # by which the delay is measured


class SimulatedDisplay:
    """A simulated projector's light, for simulated cameras."""

    def __init__(self, projector: str, cameras: Mapping[str, Camera], clock: Clock) -> None:
        self._projector, self._clock = projector, clock
        self._cameras = [camera for camera in cameras.values() if isinstance(camera, SimulatedCamera)]

    def show(self, picture: Image) -> int:
        for camera in self._cameras:
            camera.project(self._projector, picture)
        return self._clock.now_ns()

    def close(self) -> None:
        """Nothing to let go of."""


class Photographer:
    """Shows pictures, and takes images of them."""

    def __init__(self, display: Display, cameras: Mapping[str, Camera], clock: Clock) -> None:
        self._display, self._cameras, self._clock = display, cameras, clock

    def take(self, picture: Image) -> dict[str, Array]:
        """Return what each camera sees of a picture (H, W): the mean of some images."""
        settled_ns = self._display.show(picture) + _SETTLED_NS
        means = {}
        for name, camera in self._cameras.items():
            total, count = np.zeros(()), 0
            while count < _IMAGES:
                frame = _read(name, camera)
                if frame.exposure_ns >= settled_ns:
                    total, count = total + frame.image, count + 1
            means[name] = total / _IMAGES
        return means

    def delay_s(self, name: str, pictures: Mapping[str, Image], seen: Mapping[str, Array]) -> float:
        """Return the time from a picture's drawing until a camera sees it, the mean of some changes between black and
        white: each is seen to fall between two images. ``seen``: what that camera saw of both."""
        light = seen["white"] - seen["black"]
        lit = light > light.max() / 2.0
        middle = (seen["white"] + seen["black"])[lit].mean() / 2.0
        camera = self._cameras[name]
        self._display.show(pictures["black"])
        delays = []
        for switch in range(_SWITCHES):
            newest_ns = self._clock.now_ns() + _SETTLED_NS
            while (frame := _read(name, camera)).exposure_ns < newest_ns:
                last_ns = frame.exposure_ns
            wait_ns = switch * (frame.exposure_ns - last_ns) // _SWITCHES  # else all fall alike between two images
            self._clock.sleep_until(self._clock.now_ns() + wait_ns)
            white = switch % 2 == 0
            drawn_ns = before_ns = self._display.show(pictures["white" if white else "black"])
            while (frame := _read(name, camera)).exposure_ns < drawn_ns or (frame.image[lit].mean() > middle) != white:
                before_ns = max(before_ns, frame.exposure_ns)
                if before_ns > drawn_ns + 2 * _SETTLED_NS:
                    raise CalibrationError("the projector's light comes and goes: switch off its saving of power")
            delays.append((before_ns + frame.exposure_ns) / 2.0 - drawn_ns)
        return float(np.mean(delays)) / S


def _read(name: str, camera: Camera) -> Frame:
    try:
        return camera.read()
    except EOFError:
        raise CalibrationError(f"camera {name}: a recording sees no projector: name a live camera") from None
    except (CameraError, OSError) as error:
        raise CalibrationError(f"camera {name}: {error}") from error
