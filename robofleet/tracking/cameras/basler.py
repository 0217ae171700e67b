"""A Basler camera through pylon: the newest image only, the camera's own stamps on this host's clock.

pypylon is the extra ``basler``; it is loaded when a camera is opened. Tested on pylon's own camera emulation, which has
neither stamps nor a way to be unplugged.
"""

import importlib.util
import warnings
from collections import deque
from collections.abc import Iterator
from typing import Any

from robofleet.bus.ticks import TickFollower
from robofleet.config.camera import CameraSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
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

_NO_PYPYLON = "pypylon is not installed: pip install 'robofleet[basler]'"
_TIMES, _GAINS = ("ExposureTime", "ExposureTimeAbs"), ("Gain", "GainRaw")  # of new and of old models
_GAIN_RAW_DB = 24.0  # its range is taken for this
_IMAGE_WAIT_MS = 500  # then it is asked whether the camera is still there
_WINDOW_IMAGES = 64  # the least delayed one of them counts
_POLL_NS = 1 * MS
_LATEST_TRIGGER_NS = 2 * MS  # after its instant; later it is left out


class BaslerCamera:
    """Reads the camera of ``camera.basler``; CameraError with the setting that it does not take over."""

    def __init__(self, context: CameraContext) -> None:
        if not _installed():
            raise CameraError(_NO_PYPYLON)
        genicam, pylon = _loaded()
        self._pylon, self._clock = pylon, context.clock
        camera = context.config.camera
        device = _found(pylon, camera.basler.serial)
        self.identity = _name(device)
        self._settings = camera
        self._exposing = ExposureChange(Exposure(camera.exposure_s, camera.basler.gain))
        try:
            self._camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateDevice(device))
            self._camera.Open()
        except genicam.GenericException as error:
            raise CameraError(f"{self.identity} cannot be opened: does another program have it? {error}") from error
        try:
            self._nodes = _Nodes(self._camera, genicam, self.identity)
            self._nodes.apply(camera)
            ticks_hz = self._camera.GetNodeMap().GetNode("GevTimestampTickFrequency")
            self._stamps = DeviceClock(S / ticks_hz.Value if genicam.IsReadable(ticks_hz) else 1.0)
            self._camera.StartGrabbing(pylon.GrabStrategy_LatestImageOnly)
        except (CameraError, genicam.GenericException) as error:
            self.close()
            raise CameraError(str(error)) from error
        self._trigger: SoftwareTrigger | None = None
        if camera.trigger == "tick" and camera.basler.trigger_source == "Software":
            self._trigger = SoftwareTrigger(context.config, context.ticks, context.clock)

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        if not _installed():
            yield "camera.source", _NO_PYPYLON
        if config.camera.triggered_by_line and config.camera.adjusts_exposure:
            where = f"camera.basler.trigger_source is {config.camera.basler.trigger_source}"
            yield "camera.exposure_control", f"{where}, which cannot move with the exposure: set it to fixed"
        yield from unmeasured(config)

    def read(self) -> Frame:
        """Return the next image; one that did not arrive whole is passed over."""
        while True:
            self._take_over()
            if self._trigger is not None and self._trigger.wait(self._camera.IsGrabbing):
                self._camera.TriggerSoftware.Execute()
            with self._camera.RetrieveResult(_IMAGE_WAIT_MS, self._pylon.TimeoutHandling_Return) as result:
                arrival_ns = self._clock.now_ns()
                if result.IsValid() and result.GrabSucceeded():
                    return self._frame(result, arrival_ns)
            if self._camera.IsCameraDeviceRemoved() or not self._camera.IsGrabbing():
                raise CameraError(f"{self.identity} gives no images any more: is it plugged in?")

    def exposure_limits(self) -> ExposureLimits:
        """Return what the camera can be set to; GainRaw's decibels are assumed."""
        times, gains = self._nodes.find(*_TIMES), self._nodes.find(*_GAINS)
        gain_db = 1.0 if gains.Node.Name == _GAINS[0] else _GAIN_RAW_DB / max(gains.Max - gains.Min, 1)
        return ExposureLimits(
            Exposure(times.Min * 1e-6, gains.Min), Exposure(times.Max * 1e-6, gains.Max),
            Exposure(_step(times) * 1e-6, _step(gains)), gain_db,
        )  # fmt: skip

    def adjust(self, exposure: Exposure) -> None:
        """Expose so from the next image that has not begun."""
        self._exposing.ask(exposure)

    def _take_over(self) -> None:
        """Set what was asked for, and note what the camera made of it; the trigger moves by half the change."""
        change = self._exposing.take()
        if change is None:
            return
        times, gains = self._nodes.find(*_TIMES), self._nodes.find(*_GAINS)
        times.Value = type(times.Value)(change.time_s * 1e6)
        gains.Value = type(gains.Value)(change.gain)
        has = Exposure(times.Value * 1e-6, float(gains.Value))
        if self._trigger is None:
            self._exposing.done(has, self._clock.now_ns())
        else:  # the next image is triggered after this
            self._exposing.done(has, 0)
            self._trigger.exposure_s = has.time_s

    def _frame(self, result: Any, arrival_ns: int) -> Frame:
        """Return an image. A camera stamps when its exposure begins, so the clock must not see how long that takes."""
        readout_ns = round(self._settings.readout_s * S)
        exposed_ns = round(self._exposing.newest.time_s * S)
        exposure = self._exposing.of(arrival_ns - readout_ns - exposed_ns)
        exposed_ns = round(exposure.time_s * S)
        began_ns = self._stamps.arrival(result.TimeStamp, arrival_ns - readout_ns - exposed_ns)
        return Frame(result.Array, began_ns + start_to_middle_ns(self._settings, exposure.time_s), exposure)

    def close(self) -> None:
        self._camera.Close()


def _installed() -> bool:
    return importlib.util.find_spec("pypylon") is not None


def _loaded() -> tuple[Any, Any]:
    """Return pypylon's modules. Their making warns, and crashes the interpreter where warnings are errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from pypylon import genicam, pylon  # noqa: PLC0415 - an extra
    return genicam, pylon


def _found(pylon: Any, serial: str | None) -> Any:
    """Return the camera with a serial number, or the only one that there is."""
    devices = list(pylon.TlFactory.GetInstance().EnumerateDevices())
    known = ", ".join(_name(device) for device in devices) or "none"
    matching = [device for device in devices if serial in (None, device.GetSerialNumber())]
    if not matching:
        raise CameraError(f"camera.basler.serial: there is no such camera (there are: {known}): plug it in")
    if len(matching) > 1:
        raise CameraError(f"camera.basler.serial: say which camera (there are: {known})")
    return matching[0]


def _name(device: Any) -> str:
    return f"{device.GetModelName()} {device.GetSerialNumber()}"


def _step(node: Any) -> float:
    """Return a node's increment; 0 where it has none, as some floats have not."""
    return float(node.Inc) if not hasattr(node, "HasInc") or node.HasInc() else 0.0


class DeviceClock:
    """Puts a camera's stamps on this host's clock, by the image that came with the least delay of late."""

    def __init__(self, tick_ns: float) -> None:
        """Take the unit of the stamps [ns]."""
        self._tick_ns = tick_ns
        self._offsets: deque[int] = deque(maxlen=_WINDOW_IMAGES)
        self._last = 0

    def arrival(self, stamp: int, arrival_ns: int) -> int:
        """Return when the image stamped ``stamp`` would have arrived with the least delay [ns].

        An image cannot come sooner than the least delay allows: the smallest of the last offsets is the best known.
        A camera without stamps leaves the arrival.
        """
        if stamp <= self._last:
            self._offsets.clear()  # it was started again, or it has none
        self._last = stamp
        stamp_ns = round(stamp * self._tick_ns)
        self._offsets.append(arrival_ns - stamp_ns)
        return stamp_ns + min(self._offsets)


class SoftwareTrigger:
    """Says when to trigger, so that mid-exposure falls ``camera.trigger_lead_s`` before the next tick."""

    def __init__(self, config: Config, ticks: TickFollower, clock: Clock) -> None:
        """Follow ticks that another thread updates."""
        self._ticks, self._clock = ticks, clock
        before_s = config.controller.tick_s - config.camera.trigger_lead_s
        self._before_ns, self._camera = round(before_s * S), config.camera
        self.exposure_s = config.camera.exposure_s  # of the next image
        self._triggered = ticks.newest

    def wait(self, running: Any) -> bool:
        """Return at the next trigger's instant; False when ``running()`` no longer holds."""
        while running():
            tick = self._ticks.newest
            if tick != self._triggered:
                self._triggered = tick
                at_ns = self._ticks.instant(tick) + self._before_ns - start_to_middle_ns(self._camera, self.exposure_s)
                if self._clock.now_ns() <= at_ns + _LATEST_TRIGGER_NS:
                    self._clock.sleep_until(at_ns)
                    return True
            self._clock.sleep_until(self._clock.now_ns() + _POLL_NS)
        return False


class _Nodes:
    """A camera's settings, under the names that old and new models give them."""

    def __init__(self, camera: Any, genicam: Any, identity: str) -> None:
        self._camera, self._genicam, self._identity = camera, genicam, identity

    def apply(self, camera: CameraSettings) -> None:
        """Write all of them; CameraError names the one that the camera does not take over."""
        self._put("Mono8 images", "Mono8", "PixelFormat")
        for size, offset, pixels in ("Width", "OffsetX", camera.width), ("Height", "OffsetY", camera.height):
            self._put_if_there(0, offset)
            self._put(f"camera.{size.lower()}", pixels, size)
        for name in ("ExposureAuto", "GainAuto"):
            self._put_if_there("Off", name)
        self._put("camera.exposure_s", camera.exposure_s * 1e6, *_TIMES)
        self._put("camera.basler.gain", camera.basler.gain, *_GAINS)
        self._put_if_there("FrameStart", "TriggerSelector")
        if camera.trigger == "tick":
            self._put("camera.basler.trigger_source", camera.basler.trigger_source, "TriggerSource")
            self._put("camera.trigger", "On", "TriggerMode")
        else:
            self._put_if_there("Off", "TriggerMode")
            self._put_if_there(True, "AcquisitionFrameRateEnable")
            self._put("camera.rate_hz", camera.rate_hz, "AcquisitionFrameRate", "AcquisitionFrameRateAbs")

    def find(self, *names: str) -> Any:
        """Return the first of these nodes that the camera has; None where it has none of them."""
        nodes = (self._camera.GetNodeMap().GetNode(name) for name in names)
        return next((node for node in nodes if self._genicam.IsWritable(node)), None)

    def _put_if_there(self, value: Any, name: str) -> None:
        if (node := self.find(name)) is not None:
            node.Value = value

    def _put(self, setting: str, value: Any, *names: str) -> None:
        """Write the first of these nodes that the camera has, and read it back."""
        node = self.find(*names)
        if node is None:
            raise CameraError(f"{self._identity} has no {' or '.join(names)} to set: {setting} cannot be kept")
        try:
            node.Value = type(node.Value)(value)
        except self._genicam.GenericException as error:
            raise CameraError(f"{self._identity} does not accept {setting}: {value}: {error}") from error
