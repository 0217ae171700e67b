"""What the controls of a V4L2 camera are set to before it measures, and why.

The values follow from the configuration and from the camera's own ranges alone, so a camera that is plugged in again,
or was used by another program, gets the values that it was calibrated with. Each is written, read back, and read again
when images come: a start of the stream may bring a camera's habits back. uvcvideo answers from its memory for most
controls: a camera that lies to it is found by its images alone.
"""

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Literal, NamedTuple

from robofleet.config.camera import CameraSettings
from robofleet.config.faults import did_you_mean
from robofleet.tracking.cameras.v4l2_device import Device
from robofleet.tracking.sources import CameraError

EXPOSURE_UNIT_S = 1e-4  # of V4L2_CID_EXPOSURE_ABSOLUTE
EXPOSURE_TIME, GAIN, FOCUS = 0x009A0902, 0x00980913, 0x009A090A
DYNAMIC_RATE = 0x009A0903
_ROUNDED = {EXPOSURE_TIME: 0.05}  # drivers round to what the sensor can do
_KEYS = {EXPOSURE_TIME: "camera.exposure_s", GAIN: "camera.v4l2.gain", FOCUS: "camera.v4l2.focus"}


class Row(NamedTuple):
    """A control, the value that it gets, and why."""

    control: int  # V4L2_CID of linux/v4l2-controls.h
    name: str
    value: int | Literal["least", "most", "default"]
    why: str


_MOVES = "it moves the image"
_GREY = "it changes the grey of the same paper"
_REPLUGGED = "a camera that is plugged in again has it"

TABLE = (  # what switches others off comes first; before it what a camera may accept only while that is on
    Row(DYNAMIC_RATE, "exposure_dynamic_framerate", 0, "it lowers the rate in the dark"),
    Row(0x009A0901, "auto_exposure", 1, "exposure times must be known"),  # V4L2_EXPOSURE_MANUAL
    Row(0x00980912, "gain_automatic", 0, _GREY),
    Row(0x009A0918, "iso_sensitivity_auto", 0, _GREY),
    Row(0x00980920, "brightness_automatic", 0, _GREY),
    Row(
        0x009A090C,
        "focus_automatic_continuous",
        0,
        "a lens that moves ends the calibration: take a camera whose focus is fixed or can be set",
    ),
    Row(0x0098090C, "white_balance_automatic", 0, _GREY),
    Row(0x009A0915, "wide_dynamic_range", 0, "it mixes exposures of different times"),
    Row(0x009A0924, "hdr_sensor_mode", 0, "it mixes exposures of different times"),
    Row(0x0098091C, "backlight_compensation", "least", _GREY),
    Row(0x009A0916, "image_stabilization", 0, _MOVES),
    Row(0x009A091A, "scene_mode", 0, "it sets other controls"),
    Row(0x0098091B, "sharpness", "least", "it draws a bright and a dark line along each edge"),
    Row(0x00980918, "power_line_frequency", "least", "it rounds exposure times to a lamp's period"),
    Row(FOCUS, "focus_absolute", "default", "the calibration belongs to it"),
    Row(0x009A090D, "zoom_absolute", "least", "the calibration belongs to it"),
    Row(0x009A0908, "pan_absolute", "default", _MOVES),
    Row(0x009A0909, "tilt_absolute", "default", _MOVES),
    Row(0x00980914, "horizontal_flip", "default", "a mirrored tag is not read"),
    Row(0x00980915, "vertical_flip", "default", "a mirrored tag is not read"),
    Row(0x00980922, "rotate", "default", _MOVES),
    Row(0x0098091A, "white_balance_temperature", "default", _REPLUGGED),
    Row(0x00980900, "brightness", "default", _REPLUGGED),
    Row(0x00980901, "contrast", "default", _REPLUGGED),
    Row(0x00980910, "gamma", "default", _REPLUGGED),
    Row(0x009D0903, "compression_quality", "most", "a strong compression draws blocks"),
)
_DENOISING = ("noise", "3dnr", "tnr")  # in names of drivers' own controls


class Setpoint(NamedTuple):
    """A control, the value that it gets, the key of the configuration or the control that it is for, and why."""

    control: int
    value: int
    setting: str
    why: str = ""


class CameraControls:
    """The controls of one camera, all set. ``refused``: what it did not take over, in words."""

    def __init__(self, device: Device, camera: CameraSettings) -> None:
        """Set them. OSError where the device is gone, CameraError where the configuration names no control of it."""
        self._device, self.of_device = device, device.controls()
        setpoints = tuple(self._chosen(camera))
        self._kept = tuple(point for point in setpoints if point.control not in (EXPOSURE_TIME, GAIN))
        self._write(setpoints)
        self.refused = self._differing(setpoints)

    def keep(self) -> list[str]:
        """Write again what a stream that began brought back; return what is refused. Exposure and gain follow light."""
        if self._differing(self._kept):
            self._write(self._kept)
        return self._differing(self._kept)

    def value(self, control: int) -> int | None:
        """Return what a control is; None where the camera has none, or does not tell."""
        try:
            return self._device.get(control)
        except OSError:
            return None

    def adjust(self, control: int, value: int) -> int:
        """Set exposure time or gain; return what the camera made of it."""
        self._device.set(control, value)
        return self._device.get(control)

    def summary(self) -> str:
        """Return what is kept, in words."""
        return ", ".join(f"{point.setting} {point.value}" for point in self._kept)

    def _write(self, setpoints: Iterable[Setpoint]) -> None:
        for point in setpoints:
            with suppress(OSError):  # what it did not take is read back
                self._device.set(point.control, point.value)

    def _differing(self, setpoints: Iterable[Setpoint]) -> list[str]:
        words = []
        for control, value, setting, why in setpoints:
            got = self.value(control)
            if got is None or not math.isclose(got, value, rel_tol=_ROUNDED.get(control, 0.0)):
                unit = EXPOSURE_UNIT_S if control == EXPOSURE_TIME else 1
                has = "none" if got is None else f"{got * unit:g}"
                words.append(f"{setting} {value * unit:g} (it has {has})" + (f": {why}" if why else ""))
        return words

    def _chosen(self, camera: CameraSettings) -> Iterator[Setpoint]:
        """Yield what is to be set, in an order that the kernel accepts; also exposure and gain that it lacks."""
        own = dict(self._own_values(camera))
        denoising = (
            Row(control.id, control.name, "least", "it mixes images of different times")
            for control in self.of_device.values()
            if any(word in control.name for word in _DENOISING)
        )
        for row in (*TABLE, *denoising):
            control = self.of_device.get(row.control)
            if row.control == FOCUS and camera.v4l2.focus is not None:
                yield Setpoint(FOCUS, camera.v4l2.focus, _KEYS[FOCUS])
            elif control is not None and row.control not in own:
                ends = {"least": control.low, "most": control.high, "default": control.default}
                value = ends[row.value] if isinstance(row.value, str) else row.value
                yield Setpoint(row.control, value, row.name, row.why)
        for number, chosen in own.items():
            if chosen is not None:
                yield Setpoint(number, chosen, f"camera.v4l2.controls.{self.of_device[number].name}")
        yield Setpoint(EXPOSURE_TIME, max(1, round(camera.exposure_s / EXPOSURE_UNIT_S)), _KEYS[EXPOSURE_TIME])
        if camera.v4l2.gain is not None:
            yield Setpoint(GAIN, camera.v4l2.gain, _KEYS[GAIN])

    def _own_values(self, camera: CameraSettings) -> Iterator[tuple[int, int | None]]:
        """Yield ``camera.v4l2.controls``; a name is the device's, or that of newer kernels in the table."""
        known = {row.name: row.control for row in TABLE if row.control in self.of_device}
        known |= {control.name: control.id for control in self.of_device.values()}
        for name, value in camera.v4l2.controls.items():
            if name not in known:
                raise CameraError(f"camera.v4l2.controls: there is no {name}: {did_you_mean(name, known)}")
            if known[name] in _KEYS and value is not None:
                raise CameraError(f"camera.v4l2.controls: write {_KEYS[known[name]]} instead of {name}")
            yield known[name], value
