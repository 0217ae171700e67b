"""Where the operator's page is: the address that it listens at, and what a terminal says of it."""

import os
import socket
from collections.abc import Mapping
from typing import NamedTuple, Self
from urllib.parse import quote, urlsplit

from robofleet.core.refusal import RefusedError

LOOPBACK = "127.0.0.1"
_LOCAL = LOOPBACK, "::1", "localhost"
_ANY = "0.0.0.0", "::"


class Addresses(NamedTuple):
    """Where the page is. Nobody else may see ``page`` and ``viewer``: they let in."""

    page: str  # an operator's; on this computer with its token, beyond it with a token that one browser takes
    once: str  # for the command line of a browser, which others may see: it opens the page once, for this user
    viewer: str = ""  # the page of who may only look, hold and stop; none on this computer
    fingerprint: str = ""  # SHA-256 of the page's certificate, where it has one

    def line(self) -> str:
        """Return them in one line, which ``read`` takes."""
        return " ".join(filter(None, self))

    @classmethod
    def read(cls, line: str) -> Self | None:
        """Return what ``line`` has written; None where that is not all of it."""
        words = line.split()
        return cls(*words) if len(words) in (2, len(cls._fields)) else None


def projector_address(page: str, name: str) -> str:
    """Return the address of a projector's page, by an address of the operator's page or of a one-time token."""
    if "/open?" in page:
        return f"{page}&projector={quote(name)}"
    return page.replace("/?", f"/projector?name={quote(name)}&", 1)


def is_local(host: str) -> bool:
    """Whether an address is reached from this computer only, and its page needs no keys."""
    return host in _LOCAL


def address_lines(at: Addresses, *, opened: bool, environment: Mapping[str, str] = os.environ) -> str:
    """Return the page's address and how it is reached."""
    line = f"the operator's page: {at.page}"
    if at.viewer:
        line += f"\n  for a viewer: {at.viewer}\n  each opens the page in one browser; SHA-256 of its certificate: "
        line += at.fingerprint
    if opened:
        return f"{line}\n  your browser opens it"
    if at.viewer:
        return line
    parts = urlsplit(at.page)
    if server := _reached_by_ssh(environment):
        forward = f"ssh -N -L {parts.port}:{parts.netloc} {server}"
        return f"{line}\n  from the computer in front of you: `{forward}`, then open it there"
    return f"{line}\n  open it in a browser of this computer; for a phone: --web-host {own_address() or 'ADDRESS'}"


def own_address() -> str | None:
    """Return this machine's address in its network; None where it has none. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address that nobody has (RFC 5737): it takes the way of all others
            address: str = probe.getsockname()[0]
        except OSError:
            return None
    return None if is_local(address) or address == "0.0.0.0" else address


def _reached_by_ssh(environment: Mapping[str, str]) -> str | None:
    """Return whom the user's ssh has called; None without ssh."""
    ends = environment.get("SSH_CONNECTION", "").split()
    return f"{environment.get('USER') or 'USER'}@{ends[2]}" if len(ends) == 4 else None


def listening(host: str, port: int, option: str) -> socket.socket:
    """Return a socket at one of this machine's addresses; RefusedError, which names the option, where it is none."""
    try:
        (family, _, _, _, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        if address[0] in _ANY:
            raise RefusedError(
                f"{option} {host}: name one of this machine's addresses{_for_example()}: "
                "the page answers to its own address only"
            )
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        why = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        named = f"{option} {host} --port {port}" if port else f"{option} {host}"
        raise RefusedError(
            f"{named}: {why}: name an address of this machine{_for_example()}"
            + (", and a port that is free" * bool(port))
        ) from error


def _for_example() -> str:
    address = own_address()
    return f", for example {address}" if address else ""
