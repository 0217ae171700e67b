"""The serial ports of this machine: what is plugged in, who may open it, who has it open. None is opened here."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from serial.tools import list_ports

from robofleet.doctor import permission, udev
from robofleet.doctor.findings import Finding, Mark, Paste, ok
from robofleet.doctor.needs import Needs

_LINKS = Path("/dev/robofleet"), Path("/dev/serial/by-id"), Path("/dev/serial/by-path")
_PROCESSES = Path("/proc")


class Holder(NamedTuple):
    """A process that has a port open."""

    pid: int
    command: str


def devices() -> list[udev.Device]:
    """Return the ports, USB's first."""
    links: dict[str, list[str]] = {}
    for folder in _LINKS:
        for link in sorted(folder.glob("*")):
            links.setdefault(os.path.realpath(link), []).append(str(link))
    found = []
    for port in list_ports.comports():
        says = " ".join(dict.fromkeys(filter(None, (port.manufacturer, port.product)))) or "unnamed adapter"
        numbers = port.vid, port.pid or 0, port.serial_number or "", port.location or ""
        usb = None if port.vid is None else udev.Usb(*numbers)
        found.append(udev.Device(port.device, says, usb, tuple(links.get(os.path.realpath(port.device), ()))))
    return sorted(found, key=lambda device: (device.usb is None, device.path))


def holders(path: str) -> list[Holder]:
    """Return who has a port open, as far as this user may see."""
    wanted = os.path.realpath(path)
    found = []
    for process in _PROCESSES.glob("[0-9]*"):
        try:
            if any(_target(entry) == wanted for entry in (process / "fd").iterdir()):
                command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                found.append(Holder(int(process.name), command[:80]))
        except OSError:
            continue  # another user's, or ended
    return sorted(found)


def _target(link: Path) -> str:
    try:
        return str(link.readlink())
    except OSError:  # this descriptor was closed meanwhile
        return ""


def serial_ports(needs: Needs) -> Iterator[Finding]:
    """Every port of an adapter, and every one that the configuration names."""
    ports = devices()
    named = {os.path.realpath(port.path): port for port in needs.ports()}
    rules = udev.serial_rules(ports, _names(needs, ports))
    for device in ports:
        port = named.pop(os.path.realpath(device.path), None)
        if device.usb is not None or port is not None:
            yield _judged(device.path, _described(device), port.robot if port else None, rules.get(device.path))
    for port in named.values():
        yield _judged(port.path, "no USB adapter", port.robot, None)
    if any(device.usb is not None for device in ports):
        yield ok("which robot", "`robofleet doctor --ask all` opens the ports and says which robot answers at each")
    built_in = [candidate.path for candidate in ports if candidate.usb is None]
    if built_in:
        yield ok("built-in ports", f"{', '.join(built_in)}: checked only if a configuration names them")
    if not ports:
        yield ok("serial ports", "no adapter is plugged in")
    if shutil.which("brltty"):
        says = "it is installed, and takes the ports of CH340 and CP210x chips for itself"
        yield Finding("brltty", Mark.WARN, says, "`sudo apt remove brltty`, if nobody here uses a Braille display")


def _judged(path: str, says: str, robot: str | None, rule: str | None) -> Finding:
    """Return what is to be said of a port; ``robot`` is whose it is in the configuration, None if nobody's."""
    name = path if robot is None else f"{robot}'s port"
    says = says if robot is None else f"{path}, {says}"
    pastes = (Paste(udev.FILE, rule),) if rule else ()
    grave = Mark.MISSING if robot is not None else Mark.WARN
    if not Path(path).exists():
        cure = "switch the robot on, plug it in and paste its rule below, or mend settings.port"
        return Finding(name, grave, f"{path}: there is no such port", cure)
    if not Path(path).is_char_device():
        return Finding(name, grave, f"{path}: it is not a serial port", "mend settings.port")
    if not os.access(path, os.R_OK | os.W_OK):
        refused = f"{says}; {permission.user_name()} may not open it"
        return Finding(name, grave, refused, permission.cure(Path(path)), pastes)
    if using := holders(path):
        who = ", ".join(f"process {process.pid} ({process.command})" for process in using)
        cure = "" if robot is None else "end that program before a run"
        return Finding(name, Mark.OK if robot is None else grave, f"{says}; open in {who}", cure, pastes)
    return ok(name, f"{says}; free", *pastes)


def _described(device: udev.Device) -> str:
    parts = [device.says]
    if device.usb is not None:
        parts.append(f"{device.usb.vendor_id:04x}:{device.usb.product_id:04x}")
        parts.append(f"serial number {device.usb.serial_number}" if device.usb.serial_number else "no serial number")
    if device.links:
        parts.append(device.links[0])
    return ", ".join(parts)


def _names(needs: Needs, found: list[udev.Device]) -> dict[str, str]:
    """Return the robot that each port shall be named after: the configuration's; then r1, r2, ... in order."""
    names = {}
    ports = list(needs.ports())
    free = [port.robot for port in ports if not Path(port.path).exists()]
    count = 0
    for device in found:
        owners = [port.robot for port in ports if os.path.realpath(port.path) == os.path.realpath(device.path)]
        if owners:
            names[device.path] = owners[0]
        elif free:
            names[device.path] = free.pop(0)
        elif device.usb is not None:
            count += 1
            while f"r{count}" in {port.robot for port in ports}:
                count += 1
            names[device.path] = f"r{count}"
    return names
