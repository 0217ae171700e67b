"""Where the operator's page can be opened: a browser here, and this machine's addresses for others."""

import fcntl
import os
import socket
import struct
import webbrowser
from collections.abc import Iterator

from robofleet.doctor.findings import Finding, Mark, ok
from robofleet.doctor.needs import Needs

_SIOCGIFADDR = 0x8915
_NAME = 256  # bytes of a request that begins with an interface's name
_DISPLAYS = "DISPLAY", "WAYLAND_DISPLAY"
_ELSEWHERE = (
    "open the page on another computer or a phone: `robofleet web --host ADDRESS`, with an address of `network`"
)


def browser(needs: Needs) -> Iterator[Finding]:
    """Whether a page can be opened on this machine."""
    if not needs.whole_run:
        return
    if not any(os.environ.get(display) for display in _DISPLAYS):
        yield Finding("browser", Mark.WARN, f"there is no display ({' and '.join(_DISPLAYS)} are empty)", _ELSEWHERE)
        return
    try:
        found = webbrowser.get()
    except webbrowser.Error:
        yield Finding("browser", Mark.WARN, "no browser is installed", f"install one, or {_ELSEWHERE}")
    else:
        yield ok("browser", getattr(found, "name", type(found).__name__))


def network(_needs: Needs) -> Iterator[Finding]:
    """The addresses by which others reach this machine."""
    found = [f"{address} ({name})" for name, address in addresses() if not address.startswith("127.")]
    if found:
        yield ok("network", f"{socket.gethostname()}: {', '.join(found)}; robofleet listens on this machine only")
    else:
        yield Finding(
            "network", Mark.WARN, "this machine has no address", "join a network, if a phone is to see the page"
        )


def addresses() -> list[tuple[str, str]]:
    """Return interfaces and their IPv4 addresses."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            request = struct.pack(f"{_NAME}s", name.encode())
            try:
                answer = fcntl.ioctl(asking.fileno(), _SIOCGIFADDR, request)
            except OSError:
                continue  # it has none
            found.append((name, socket.inet_ntoa(answer[20:24])))
    return found
