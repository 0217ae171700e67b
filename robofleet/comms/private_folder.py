"""The folder that is this user's alone: the bus's socket, the twins' ports, and the file by which a run is found."""

import os
import stat
from pathlib import Path


class PlaceError(OSError):
    """A folder or an endpoint that cannot be used; the message is a line that says how to mend it."""


def temporary_folder() -> Path:
    """Return where every user of this computer may leave files."""
    return Path(os.environ.get("TMPDIR") or "/tmp").absolute()


def private_folder() -> Path:
    """Return ``$XDG_RUNTIME_DIR/robofleet``, else ``/tmp/robofleet-UID``, made if need be; PlaceError if spoiled."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime).absolute() / "robofleet" if runtime else temporary_folder() / f"robofleet-{os.geteuid()}"
    try:
        folder.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        pass  # it is seen below what it is
    except OSError as error:
        raise PlaceError(f"{folder}: {error.strerror}: set XDG_RUNTIME_DIR to a folder of yours") from error
    check_private(folder)
    return folder


def check_private(folder: Path, variable: str = "XDG_RUNTIME_DIR") -> None:
    """Raise PlaceError unless a folder is a real one, and nobody but this user reaches what is in it.

    ``variable``: of the environment, which names another folder.
    """
    try:
        found = folder.lstat()
    except OSError as error:
        raise PlaceError(f"{folder}: {error.strerror}: make it with `mkdir -m 700 {folder}`") from error
    if not stat.S_ISDIR(found.st_mode):
        raise PlaceError(f"{folder} is not a folder but a link or a file: remove it, or set {variable} to another one")
    if found.st_uid != os.geteuid():  # in /tmp anybody may have made it
        raise PlaceError(f"{folder} belongs to somebody else: set {variable} to a folder of yours")
    if found.st_mode & 0o077:
        raise PlaceError(f"{folder} is open to others: close it with `chmod 700 {folder}`")
