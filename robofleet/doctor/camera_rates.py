"""How many images a second a camera of the kernel's gives, set up as in a run, and what keeps it from more."""

import math
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robofleet.config.camera import CameraSettings
from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.doctor.examination import Look, finished
from robofleet.doctor.findings import Finding, Mark, Paste, ok
from robofleet.doctor.needs import Needs
from robofleet.tracking.cameras.v4l2_controls import DYNAMIC_RATE
from robofleet.tracking.cameras.v4l2_device import UVCVIDEO, sysfs_line
from robofleet.tracking.sources import CameraContext, CameraError, Exposure

if TYPE_CHECKING:
    from robofleet.tracking.cameras.v4l2 import V4L2Camera

_SYSFS = Path("/sys/class/video4linux")
_MODULE_OPTIONS = "/etc/modprobe.d/robofleet.conf"
_MEASURED_S = 1.5  # of the stamps
_MOST_IMAGES = 1000  # of a camera whose stamps stand still
_AT_MOST_S = 20.0  # OpenCV waits ten for an image
_ENOUGH = 0.95  # of the rate
_PIXEL_BYTES = {"GREY": 1.0, "NV12": 1.5, "YUYV": 2.0, "UYVY": 2.0, "Y10": 2.0, "Y16": 2.0}
# What USB carries [MB/s], by its speed in sysfs [Mbit/s]. 480: three packets of 1024 bytes in each of 8000 microframes.
_USB_MB_S = {"12": 1.0, "480": 24.6, "5000": 380.0}


class Measured(NamedTuple):
    """What a camera did."""

    rate_hz: float
    arrival_s: float  # from mid-exposure until an image is here
    exposure: Exposure
    dynamic_rate: str  # the name of the control that lowers the rate in the dark; empty: it is off


def camera_rates(needs: Needs) -> list[Finding]:
    """Let each camera of the kernel's give images, all at once: they may share a bus."""
    if find_spec("cv2") is None or needs.config is None or not needs.cameras:
        return []  # not needed, or said already
    looks = []
    for view in needs.config.views:
        if view.camera.source == "v4l2" and Path(view.camera.v4l2.device).exists():
            hangs = Finding(view.camera.v4l2.device, Mark.WARN, "it gives no images", "unplug it and plug it in again")
            looks.append(Look(partial(examined, view), hangs))
    return finished(looks, _AT_MOST_S)


def examined(
    config: Config, open_camera: Callable[[CameraContext], "V4L2Camera"] | None = None, sysfs: Path = _SYSFS
) -> Iterator[Finding]:
    """Yield what a configuration's camera does: its rate, its controls, its stamps."""
    from robofleet.tracking.cameras.v4l2 import V4L2Camera  # noqa: PLC0415 - it loads OpenCV

    settings, device = config.camera, config.camera.v4l2.device
    try:
        camera = (open_camera or V4L2Camera)(CameraContext.without_run(config, WallClock()))
        try:
            measured = measure(camera)
        finally:
            camera.close()
    except (CameraError, OSError) as error:
        yield Finding(f"{device} images", Mark.MISSING, str(error))
        return
    says = f"{measured.rate_hz:.1f} a second, here {1e3 * measured.arrival_s:.0f} ms after mid-exposure"
    if measured.rate_hz < _ENOUGH * settings.rate_hz:
        why, cure = slowed_by(settings, measured, sysfs)
        yield Finding(f"{device} images", Mark.WARN, f"{says}; camera.rate_hz is {settings.rate_hz:g}; {why}", cure)
    else:
        yield ok(f"{device} images", says)
    yield ok(f"{device} controls", camera.controls.summary())
    yield from stamps(settings, camera.stamp, camera.driver)


def measure(camera: "V4L2Camera") -> Measured:
    """Read images for a while; CameraError if none come."""
    clock = WallClock()
    first = last = camera.read()  # it may have waited long in a buffer
    arrivals_ns = []
    for _ in range(_MOST_IMAGES):
        last = camera.read()
        arrivals_ns.append(clock.now_ns() - last.exposure_ns)
        if last.exposure_ns - first.exposure_ns >= _MEASURED_S * S:
            break
    assert last.exposure is not None
    duration_s = max(last.exposure_ns - first.exposure_ns, 1) / S
    dynamic = camera.controls.of_device.get(DYNAMIC_RATE)
    on = dynamic.name if dynamic is not None and camera.controls.value(DYNAMIC_RATE) else ""
    arrivals_ns.sort()
    return Measured(len(arrivals_ns) / duration_s, arrivals_ns[len(arrivals_ns) // 2] / S, last.exposure, on)


def slowed_by(camera: CameraSettings, measured: Measured, sysfs: Path) -> tuple[str, str]:
    """Return what most likely slows a camera down, and the cure."""
    device, pixels = camera.v4l2.device, camera.v4l2.format
    period_s = 1 / camera.rate_hz
    if measured.exposure.time_s > period_s:
        why = f"it exposes for {1e3 * measured.exposure.time_s:.1f} ms, longer than a period"
        return why, f"set camera.exposure_s below {period_s:.4g}, and light the floor"
    if measured.dynamic_rate:
        why = f"its control {measured.dynamic_rate} is on, and lowers the rate in the dark"
        return why, f"take it out of camera.v4l2.controls, or `v4l2-ctl -d {device} -c {measured.dynamic_rate}=0`"
    plug = (sysfs / Path(device).resolve().name / "device").resolve().parent
    carried = _USB_MB_S.get(sysfs_line(plug / "speed"), math.inf)
    needed = _PIXEL_BYTES.get(pixels, 0.0) * camera.width * camera.height * camera.rate_hz / 1e6
    if needed > carried:
        why = f"{pixels} of this size and rate is {needed:.0f} MB/s, and its USB carries {carried:g}"
        return why, "set camera.v4l2.format to MJPG, take fewer pixels, or a socket and a cable of USB 3"
    if sysfs_line(plug / "power" / "control") == "auto":
        why = "no control explains it; its socket may save power"
        return why, f"`echo on | sudo tee {plug / 'power' / 'control'}`, then another socket, without a hub"
    return "no control explains it", "try another socket, without a hub and without other cameras; look into `dmesg`"


def stamps(camera: CameraSettings, stamp: str, driver: str, uvcvideo: Path = UVCVIDEO) -> Iterator[Finding]:
    """Yield which instant counts as an image's, how late that may be, and what uvcvideo does with broken images."""
    title = f"{camera.v4l2.device} stamps"
    by = f"{driver} stamps" if camera.v4l2.stamp is None else "camera.v4l2.stamp:"
    if stamp == "start":
        yield ok(title, f"{by} the start of the exposure")
    elif stamp == "end":
        readout = f"camera.readout_s, {1e3 * camera.readout_s:g} ms"
        yield ok(title, f"{by} the end of the transfer: the exposure began its length and {readout} before it")
    else:
        buffered = f"{1e3 / camera.rate_hz:.0f} ms if it keeps a whole image"
        latency = "`robofleet calibrate latency` measures it as a part of each robot's delay"
        counts = "counts as the end of its first row's exposure: late by what the camera does before it sends"
        yield ok(title, f"{by} an image's first packet, which {counts}, {buffered}. {latency}")
    if driver == "uvcvideo" and camera.v4l2.format != "MJPG" and sysfs_line(uvcvideo / "nodrop") in ("1", "Y"):
        yield Finding(
            f"{camera.v4l2.device} whole images", Mark.WARN,
            "uvcvideo hands out images of which a part was lost, with an older image in its place",
            "load it with nodrop=0: paste the line below, and start this computer again",
            (Paste(_MODULE_OPTIONS, "options uvcvideo nodrop=0"),),
        )  # fmt: skip
