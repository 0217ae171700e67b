"""The cameras of this machine: the kernel's (name, formats, sizes, rates) and Basler's."""

import os
import sys
from collections.abc import Iterator
from contextlib import closing
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path

from robofleet.config.camera import CameraSettings
from robofleet.doctor import permission, udev
from robofleet.doctor.elsewhere import NoAnswerError, run_apart
from robofleet.doctor.findings import Finding, Mark, Paste, ok
from robofleet.doctor.needs import Needs
from robofleet.tracking.cameras.v4l2_device import Device, Mode

_SYSFS = Path("/sys/class/video4linux")
_DEVICES = Path("/dev")
_BASLER = """
import json
from pypylon import pylon
found = pylon.TlFactory.GetInstance().EnumerateDevices()
print(json.dumps([(one.GetModelName(), one.GetSerialNumber()) for one in found]))
"""
_SHOWN_SIZES = 3  # of a format
_SAME_RATE = 0.01  # relative


def kernel_cameras(needs: Needs) -> Iterator[Finding]:
    """Every camera that the kernel has, and whether the configuration's is there and can do what it asks for."""
    wanted = {
        os.path.realpath(configured.v4l2.device): configured
        for configured in needs.cameras
        if configured.source == "v4l2"
    }
    found, others = set(), []
    for path in sorted(_DEVICES.glob("video*"), key=lambda path: (len(path.name), path.name)):
        match = wanted.get(str(path.resolve()))
        finding = _looked_at(path, match)
        if finding is not None:
            yield finding
            others.append(str(path))
            if match is not None:
                found.add(match.name)
    for camera in wanted.values():
        if camera.name not in found:
            names = ", ".join(others) or "none"
            says = f"{camera.v4l2.device} is not there, or is not a camera (there are: {names})"
            yield Finding("camera", Mark.MISSING, says, "plug it in, or name another one in camera.v4l2.device")


def _looked_at(path: Path, wanted: CameraSettings | None) -> Finding | None:
    """Return what is to be said of a device; None if it gives no images. ``wanted``: it is the configuration's."""
    grave = Mark.WARN if wanted is None else Mark.MISSING
    try:
        with closing(Device(str(path))) as device:
            if not device.gives_images:
                return None
            name, modes = device.name, device.modes()
    except PermissionError:
        refused = f"{permission.user_name()} may not open it"
        return Finding(str(path), grave, refused, permission.cure(path))
    except OSError as error:
        refused = f"it cannot be asked: {error.strerror}"
        return Finding(str(path), grave, refused, "end what uses it, or plug it in again")
    usb = usb_of(path)
    pastes = (Paste(udev.FILE, udev.camera_rule(usb, "camera")),) if usb is not None else ()
    number = f", serial number {usb.serial_number}" if usb is not None and usb.serial_number else ""
    says = f"{name}{number}: {shown(modes)}"
    if wanted is not None and (lacks := lacking(wanted, modes)):
        return Finding(str(path), Mark.MISSING, f"{says}; {lacks}", "take one of these in `camera:`", pastes)
    return ok(str(path), says, *pastes)


def lacking(wanted: CameraSettings, modes: tuple[Mode, ...]) -> str:
    """Return what a camera cannot do that a configuration asks for; nothing if it can."""
    letters = wanted.v4l2.format
    of_format = [mode for mode in modes if mode.format.rstrip() == letters]
    if not of_format:
        return f"it has no {letters}"
    of_size = [mode for mode in of_format if (mode.width, mode.height) == (wanted.width, wanted.height)]
    if not of_size:
        return f"its {letters} has no {wanted.width}x{wanted.height}"
    rates = [rate for mode in of_size for rate in mode.rates_hz]
    if rates and not any(abs(rate - wanted.rate_hz) <= _SAME_RATE * wanted.rate_hz for rate in rates):
        return f"its {letters} has {wanted.width}x{wanted.height} not at {wanted.rate_hz:g} Hz"
    return ""


def shown(modes: tuple[Mode, ...]) -> str:
    """Return formats with their largest sizes and the rates of each."""
    parts = []
    for letters, group in groupby(sorted(modes, key=lambda mode: mode.format), lambda mode: mode.format):
        sizes = sorted(group, key=lambda mode: mode.width * mode.height, reverse=True)
        words = [
            f"{size.width}x{size.height}"
            + (f" at {'/'.join(f'{rate:g}' for rate in size.rates_hz)} Hz" if size.rates_hz else "")
            for size in sizes[:_SHOWN_SIZES]
        ]
        more = f" and {len(sizes) - _SHOWN_SIZES} smaller" if len(sizes) > _SHOWN_SIZES else ""
        parts.append(f"{letters} {', '.join(words)}{more}")
    return "; ".join(parts) or "it tells no formats"


def usb_of(path: Path, sysfs: Path = _SYSFS) -> udev.Usb | None:
    """Return what the plug of a camera says; None where it is on no USB."""
    plug = (sysfs / path.name / "device").resolve().parent
    try:
        vendor, product = (int((plug / name).read_text(), 16) for name in ("idVendor", "idProduct"))
    except (OSError, ValueError):
        return None
    try:
        serial_number = (plug / "serial").read_text().strip()
    except OSError:
        serial_number = ""
    return udev.Usb(vendor, product, serial_number, plug.name)


def basler_cameras(needs: Needs) -> Iterator[Finding]:
    if find_spec("pypylon") is None:
        return  # `packages` says whether it is needed
    try:
        found = run_apart(_BASLER)
    except NoAnswerError as error:
        cure = f"`{sys.executable} -c 'from pypylon import pylon'` says why"
        yield Finding("Basler camera", Mark.WARN, f"their library could not be asked: {error}", cure)
        return
    for model, number in found:
        yield ok("Basler camera", f"{model}, serial number {number}")
    if not found and any(camera.source == "basler" for camera in needs.cameras):
        cure = "plug it in; one on Ethernet must be in this machine's network"
        yield Finding("Basler camera", Mark.MISSING, "none is found", cure)
