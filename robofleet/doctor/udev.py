"""Rules that give a robot's port and a camera a name that stays, one line each, ready to paste."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

FILE = "/etc/udev/rules.d/71-robofleet.rules"  # behind 60-serial.rules, which reads the numbers
RELOAD = "udevadm control --reload && udevadm trigger"
_FTDI = 0x0403
_OURS = "/dev/robofleet/"


class Usb(NamedTuple):
    """What a plug says. What it does not tell is empty."""

    vendor_id: int
    product_id: int
    serial_number: str
    location: str  # the socket: 1-2.1, with the interface of a port where the device has several: 1-2.1:1.0

    @property
    def socket(self) -> str:
        """The socket alone."""
        return self.location.partition(":")[0]


class Device(NamedTuple):
    """A port that the system has."""

    path: str  # /dev/ttyUSB0
    says: str  # manufacturer and product
    usb: Usb | None  # None: no USB device
    links: tuple[str, ...]  # names that stay


def serial_rules(devices: Sequence[Device], names: Mapping[str, str]) -> dict[str, str]:
    """Return the rule of each USB port that has no name in /dev/robofleet yet, by its path.

    A chip without a number, or with one that another one has too, is named after its socket.
    """
    found = {device.path: device.usb for device in devices if device.usb is not None}
    named = {device.path for device in devices if any(link.startswith(_OURS) for link in device.links)}
    ports = Counter(usb.socket for usb in found.values())
    alike = Counter(usb[:3] for usb in {usb._replace(location=usb.socket) for usb in found.values()})
    rules = {}
    for path, usb in found.items():
        if path in named or not (usb.serial_number or usb.location):
            continue
        keys = ['SUBSYSTEM=="tty"', *_identity(usb, unique=alike[usb[:3]] == 1)]
        if ports[usb.socket] > 1 and ":" in usb.location:  # a chip with several ports
            keys.append(f'ENV{{ID_USB_INTERFACE_NUM}}=="{int(usb.location.rpartition(".")[2]):02x}"')
        keys += ['GROUP="dialout"', 'MODE="0660"', 'TAG+="uaccess"', 'ENV{ID_MM_DEVICE_IGNORE}="1"']
        if usb.vendor_id == _FTDI:
            keys.append('ATTR{device/latency_timer}="1"')  # [ms]; else it keeps what a robot says for 16
        rules[path] = ", ".join([*keys, f'SYMLINK+="robofleet/{names[path]}"'])
    return rules


def camera_rule(usb: Usb, name: str) -> str:
    """Return the rule of a camera: of its first node, which gives the images."""
    keys = ['SUBSYSTEM=="video4linux"', 'ATTR{index}=="0"', *_identity(usb, unique=True)]
    return ", ".join([*keys, 'GROUP="video"', 'MODE="0660"', 'TAG+="uaccess"', f'SYMLINK+="robofleet/{name}"'])


def _identity(usb: Usb, *, unique: bool) -> tuple[str, str, str]:
    """Return the keys of a device: by its number, where that is unique and udev keeps it as it is, else its socket.

    A character of a number may be one that udev replaces, or takes for a pattern.
    """
    plain = usb.serial_number.isascii() and all(c.isalnum() or c in "-_." for c in usb.serial_number)
    by_number = bool(usb.serial_number) and unique and plain
    own = f'ENV{{ID_SERIAL_SHORT}}=="{usb.serial_number}"' if by_number else f'KERNELS=="{usb.socket}"'
    return f'ENV{{ID_VENDOR_ID}}=="{usb.vendor_id:04x}"', f'ENV{{ID_MODEL_ID}}=="{usb.product_id:04x}"', own
