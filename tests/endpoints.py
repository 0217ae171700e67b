"""Endpoints and folders of a test's own: short paths, a socket's has 107 bytes at most; no two tests meet."""

import atexit
import shutil
import socket
import tempfile
from pathlib import Path


def short_folder() -> Path:
    """Return a new folder that is this user's alone; it is removed at the end."""
    folder = Path(tempfile.mkdtemp(prefix="rf-", dir="/tmp"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def own_endpoint() -> str:
    """Return the endpoint of a socket that nobody else has."""
    return f"unixsock-stream/{short_folder() / 'bus.sock'}"


def free_port() -> int:
    """Return a port of this computer that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
