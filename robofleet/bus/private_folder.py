"""The folder that is this user's alone: the bus's socket, the twins' ports, and the file by which a run is found."""

import os
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from robofleet.core.errors import BadInputError

_RUNTIME = Path("/run/user")  # where the system gives each user a folder


class PlaceError(BadInputError, OSError):
    """Raised where a folder or an endpoint cannot be used. The message is a line that says how to mend it."""


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


def users_folders() -> Iterator[tuple[Path, int]]:
    """Yield the private folders that are there, with their owners' numbers; no link is followed.

    Users' runtime folders lie beside each other, and so do the folders of those who have none.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    beside = Path(runtime).absolute().parent if runtime else _RUNTIME
    temporary = (folder for folder in _folders(temporary_folder()) if folder.name.startswith("robofleet-"))
    for folder in (*(folder / "robofleet" for folder in _folders(beside)), *temporary):
        with suppress(OSError):
            found = folder.lstat()
            if stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o077:
                yield folder, found.st_uid


def _folders(parent: Path) -> list[Path]:
    """Return the folders in a folder, none of them a link; none where it cannot be read."""
    with suppress(OSError), os.scandir(parent) as entries:
        return sorted(Path(entry.path) for entry in entries if entry.is_dir(follow_symlinks=False))
    return []


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
