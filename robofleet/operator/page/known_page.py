"""Where a run's page is on this computer, for this user's other commands: a file in the private folder."""

import json
import os
import socket
from contextlib import closing, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from urllib.parse import urlsplit

from robofleet.bus.private_folder import private_folder
from robofleet.core.files import read_plain
from robofleet.operator.page.page_address import Addresses

_LARGEST = 4096  # [bytes]
_ANSWERS_WITHIN_S = 1.0


def keep(arena: str, at: Addresses) -> None:
    """Leave the addresses of a run's page; without a private folder nobody finds it there."""
    with suppress(OSError):
        descriptor = os.open(_file(arena), os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(at.line())


def forget(arena: str, at: Addresses) -> None:
    """Take away what ``keep`` has left; a newer run's stays."""
    with suppress(OSError):
        if _read(arena) == at:
            _file(arena).unlink()


def page_of(arena: str) -> Addresses | None:
    """Return the addresses of a run's page that is served on this computer, for it alone; None where there is none.

    The address for a browser's command line is a new one.
    """
    with suppress(OSError, ValueError, HTTPException):
        if (at := _read(arena)) is not None and not at.viewer:
            parts = urlsplit(at.page)
            headers = {"Origin": f"{parts.scheme}://{parts.netloc}", "X-Token": parts.query.removeprefix("token=")}
            with closing(HTTPConnection(parts.netloc, timeout=_ANSWERS_WITHIN_S)) as connection:
                connection.request("POST", "/once", headers=headers)
                return at._replace(once=str(json.loads(connection.getresponse().read(_LARGEST))))
    return None


def page_for_others(arena: str) -> str:
    """Return where a run's page is served to other computers, without what lets in; empty where it is not."""
    with suppress(OSError, ValueError):
        if (at := _read(arena)) is not None and at.viewer:
            parts = urlsplit(at.page)
            socket.create_connection((str(parts.hostname), parts.port or 0), _ANSWERS_WITHIN_S).close()
            return f"{parts.scheme}://{parts.netloc}"
    return ""


def _read(arena: str) -> Addresses | None:
    return Addresses.read(read_plain(_file(arena), _LARGEST).decode())


def _file(arena: str) -> Path:
    return private_folder() / f"{arena}.page"
