"""A one-time token opens the page once: every user of this computer can read a browser's command line.

Whoever else reads it there comes too late, or comes as another user: the system says whose a local connection is.
"""

import os
import secrets
import socket
from enum import Enum
from pathlib import Path

from robofleet.bus.permissions import OPERATOR

_TABLES = Path("/proc/net/tcp"), Path("/proc/net/tcp6")
_LOCAL, _REMOTE, _UID = 1, 2, 7  # columns of these tables


class Taker(Enum):
    """Who may take a token."""

    USER = (True, None)  # this user, as far as the system knows whose a connection is
    USER_HERE = (True,)  # this user, on this computer
    ANYBODY = ()


class OneTimeToken:
    """Is taken once, and gives a role."""

    def __init__(self, role: str = OPERATOR, taker: Taker = Taker.USER) -> None:
        self.secret = secrets.token_urlsafe(16)  # 128 bits, short enough for a QR code in 80 columns
        self.role = role
        self._taker, self._taken = taker, False

    def take(self, shown: str, client: tuple[str, int] | None, port: int) -> bool:
        """Return whether what is shown is the token, and nobody has taken it before."""
        if self._taken or not secrets.compare_digest(shown.encode(), self.secret.encode()):
            return False
        if self._taker is not Taker.ANYBODY:
            user = None if client is None else owner(client, port)
            if (None if user is None else user == os.geteuid()) not in self._taker.value:
                return False
        self._taken = True
        return True


def owner(client: tuple[str, int], port: int) -> int | None:
    """Return the user whose connection from this computer to a port that is; None for one from elsewhere."""
    addresses = {f"{address}:{client[1]:04X}" for address in _written(client[0])}
    for table in _TABLES:
        try:
            lines = table.read_text().splitlines()[1:]
        except OSError:
            continue
        for columns in map(str.split, lines):
            if columns[_LOCAL] in addresses and columns[_REMOTE].endswith(f":{port:04X}"):
                return int(columns[_UID])
    return None


def _written(address: str) -> list[str]:
    """Return an address as the tables have it; one of IPv4 may stand in both."""
    if ":" in address:
        return [_words(socket.inet_pton(socket.AF_INET6, address.partition("%")[0]))]
    four = socket.inet_pton(socket.AF_INET, address)
    return [_words(four), _words(bytes(10) + b"\xff\xff" + four)]


def _words(packed: bytes) -> str:
    """Return the 32-bit words in this computer's order of bytes (Linux writes them so), in hexadecimal."""
    return "".join(packed[k : k + 4][::-1].hex().upper() for k in range(0, len(packed), 4))
