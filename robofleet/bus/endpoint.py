"""Where the processes of an arena meet: a socket in a folder of this user's own, or, where that is asked for, TCP."""

import errno
import os
import socket
import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from robofleet.bus.private_folder import PlaceError, check_private, private_folder
from robofleet.core.patterns import LONGEST_SOCKET_PATH, PRIVATE, SOCKET, TCP

if TYPE_CHECKING:
    from robofleet.config.tree import Config

_SOCKETS = Path("/proc/net/unix")
_FLAGS, _LISTENS = 3, "00010000"  # a column of it, and what stands there


def settled(config: "Config", *, listen: bool) -> "Config":
    """Return the configuration with an endpoint that Zenoh takes; PlaceError where it cannot be used.

    ``listen``: for the one who brings the router: a port of 0 becomes a free one.
    """
    endpoint = config.bus.endpoint
    try:
        if endpoint == PRIVATE:
            endpoint = socket_endpoint(private_folder() / f"{config.arena.name}.sock")
        elif endpoint.startswith(SOCKET):
            check_private(_path(endpoint).parent)
        elif listen and config.bus.router == "run":
            endpoint = _bound(endpoint)
    except PlaceError as error:
        raise PlaceError(f"bus.endpoint: {error}") from error
    except OSError as error:
        raise _in_use(endpoint, error) from error
    return config.model_copy(update={"bus": config.bus.model_copy(update={"endpoint": endpoint})})


def check_router(config: "Config") -> None:
    """Raise PlaceError where a run could not have its router: its own, or the one that is there already."""
    if config.bus.router == "run":
        check_free(config)
    elif not _answers(config.bus.endpoint):
        raise PlaceError(
            f"bus.router: service, and no router listens at {config.bus.endpoint}: start "
            "`robofleet node router CONFIG`, or leave bus.router out, and each run starts its own"
        )


def _answers(endpoint: str) -> bool:
    with suppress(OSError):
        if endpoint.startswith(SOCKET):
            with socket.socket(socket.AF_UNIX) as probe:
                probe.connect(str(_path(endpoint)))
            return True
        host, _, port = endpoint.removeprefix(TCP).rpartition(":")
        with socket.create_connection((host.strip("[]"), int(port)), timeout=1.0):
            return True
    return False


def check_free(config: "Config") -> None:
    """Raise PlaceError where a router has the socket; what a killed one has left, the next one replaces."""
    endpoint = config.bus.endpoint
    path = _path(endpoint)
    if not endpoint.startswith(SOCKET) or not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise PlaceError(f"bus.endpoint: {path} exists and is not a socket: remove it")
    with socket.socket(socket.AF_UNIX) as probe, suppress(ConnectionRefusedError, FileNotFoundError):
        probe.connect(str(path))
        raise _in_use(endpoint, OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE)))


def listens(endpoint: str) -> bool | None:
    """Return whether somebody listens at a socket of this computer; None where the system does not say."""
    if not endpoint.startswith(SOCKET):
        return None
    try:
        lines = _SOCKETS.read_text(errors="replace").splitlines()
    except OSError:
        return None
    listening = (line.split(maxsplit=7) for line in lines if str(_path(endpoint)) in line)
    return any(len(columns) == 8 and columns[_FLAGS] == _LISTENS for columns in listening)


def _in_use(endpoint: str, error: OSError) -> PlaceError:
    cure = "end the run that has it, or leave the endpoint out for a socket of your own"
    return PlaceError(f"bus.endpoint: {endpoint} cannot be used ({os.strerror(error.errno or 0)}): {cure}")


def _path(endpoint: str) -> Path:
    return Path(endpoint.removeprefix(SOCKET))


def socket_endpoint(path: Path) -> str:
    """Return the endpoint of a Unix socket; PlaceError where the system or Zenoh takes no such path."""
    length = len(os.fsencode(path))
    if length > LONGEST_SOCKET_PATH:
        raise PlaceError(
            f"the path of its socket, {path}, has {length} bytes and may have {LONGEST_SOCKET_PATH}: "
            "set XDG_RUNTIME_DIR to a folder with a shorter name"
        )
    if set(str(path)) & set("?#; \n\t"):
        raise PlaceError(f"{path}: Zenoh takes no such name: set XDG_RUNTIME_DIR to a plain one")
    return f"{SOCKET}{path}"


def _bound(endpoint: str) -> str:
    """Return a TCP endpoint with its port settled; OSError if the port is in use."""
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((host.strip("[]"), int(port)))
        return f"tcp/{host}:{probe.getsockname()[1]}"
