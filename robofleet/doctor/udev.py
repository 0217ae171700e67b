"""Rules that give a robot's port and a camera a name that stays, one line each, ready to paste."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

FILE = "/etc/udev/rules.d/71-robofleet.rules"  # behind 60-serial.rules, which reads the numbers
RELOAD = "udevadm control --reload && udevadm trigger"
_FTDI = 0x0403
_OURS = "/dev/robofleet/"


class Usb(NamedTuple):
    """What a camera's plug says."""

    vendor_id: int
    product_id: int
    serial_number: str
    socket: str


class Device(NamedTuple):
    """A port that the system has. What an adapter does not tell is empty."""

    path: str  # /dev/ttyUSB0
    says: str  # manufacturer and product
    vendor_id: int | None  # of USB; None: no USB device
    product_id: int | None
    serial_number: str
    location: str  # the USB socket: 1-2.1, with the interface where the device has several: 1-2.1:1.0
    links: tuple[str, ...]  # names that stay


def serial_rules(devices: Sequence[Device], names: Mapping[str, str]) -> dict[str, str]:
    """Return the rule of each USB port that has no name in /dev/robofleet yet, by its path.

    A chip without a number, or with one that another one has too, is named after its socket.
    """
    ports = Counter(_socket(device) for device in devices)
    alike = Counter(key for _, key in {(_socket(device), _number(device)) for device in devices})
    rules = {}
    for device in devices:
        if any(link.startswith(_OURS) for link in device.links) or not (device.serial_number or device.location):
            continue
        keys = ['SUBSYSTEM=="tty"', *_usb(device.vendor_id or 0, device.product_id or 0)]
        if device.serial_number and alike[_number(device)] == 1 and _plain(device.serial_number):
            keys.append(f'ENV{{ID_SERIAL_SHORT}}=="{device.serial_number}"')
        else:
            keys.append(f'KERNELS=="{_socket(device)}"')
        if ports[_socket(device)] > 1 and ":" in device.location:  # a chip with several ports
            keys.append(f'ENV{{ID_USB_INTERFACE_NUM}}=="{int(device.location.rpartition(".")[2]):02x}"')
        keys += ['GROUP="dialout"', 'MODE="0660"', 'TAG+="uaccess"', 'ENV{ID_MM_DEVICE_IGNORE}="1"']
        if device.vendor_id == _FTDI:
            keys.append('ATTR{device/latency_timer}="1"')  # [ms]; else it keeps what a robot says for 16
        rules[device.path] = ", ".join([*keys, f'SYMLINK+="robofleet/{names[device.path]}"'])
    return rules


def camera_rule(usb: Usb, name: str) -> str:
    """Return the rule of a camera: of its first node, which gives the images."""
    keys = ['SUBSYSTEM=="video4linux"', 'ATTR{index}=="0"', *_usb(usb.vendor_id, usb.product_id)]
    if usb.serial_number and _plain(usb.serial_number):
        keys.append(f'ENV{{ID_SERIAL_SHORT}}=="{usb.serial_number}"')
    else:
        keys.append(f'KERNELS=="{usb.socket}"')
    return ", ".join([*keys, 'GROUP="video"', 'MODE="0660"', 'TAG+="uaccess"', f'SYMLINK+="robofleet/{name}"'])


def _usb(vendor_id: int, product_id: int) -> tuple[str, str]:
    return f'ENV{{ID_VENDOR_ID}}=="{vendor_id:04x}"', f'ENV{{ID_MODEL_ID}}=="{product_id:04x}"'


def _socket(device: Device) -> str:
    return device.location.partition(":")[0]


def _number(device: Device) -> tuple[int | None, int | None, str]:
    return device.vendor_id, device.product_id, device.serial_number


def _plain(serial_number: str) -> bool:
    """Return whether udev keeps a number as it is, and takes no character of it for a pattern."""
    return all(character.isalnum() or character in "-_." for character in serial_number) and serial_number.isascii()
