"""Files in folders that somebody else may have prepared: no link is followed, and nothing waits for a pipe.

What is written stands beside its place until it is whole, and then takes it: a link there is replaced, whatever it
leads to. Every complaint is an OSError whose ``filename`` is the file and whose ``strerror`` says what is wrong.
"""

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import BinaryIO

_KINDS = {
    stat.S_IFLNK: "a link",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def open_plain(file: Path) -> BinaryIO:
    """Open a file for reading; OSError where it is a link, a folder, a pipe or a device."""
    _refuse_other_than(file, os.lstat(file), stat.S_IFREG)
    descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        _refuse_other_than(file, os.fstat(descriptor), stat.S_IFREG)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_plain(file: Path, most: int) -> bytes:
    """Return what a file holds that is no link; OSError where it is more than so many bytes."""
    with open_plain(file) as stream:
        return _read(stream, file, most)


def read_named(file: Path, most: int) -> bytes:
    """Return what a file holds that the user named, be it a link or a pipe; OSError where it is more than ``most``."""
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)  # waits for no writer
    os.set_blocking(descriptor, True)
    with os.fdopen(descriptor, "rb") as stream:
        return _read(stream, file, most)


def write_text(file: Path, text: str) -> None:
    write_bytes(file, text.encode(errors="backslashreplace"))


def write_bytes(file: Path, data: bytes) -> None:
    with replaced(file) as stream:
        left = memoryview(data)
        while left:
            left = left[stream.write(left) :]


@contextmanager
def replaced(file: Path) -> Iterator[FileIO]:
    """Give a new file to write to, unbuffered, that takes the place of ``file`` in the end, if nothing is raised."""
    beside = file.with_name(f".{secrets.token_hex(8)}.new")
    try:
        with suppress(FileNotFoundError):
            _refuse_other_than(file, os.lstat(file), stat.S_IFREG, stat.S_IFLNK)
        try:
            with beside.open("xb", buffering=0) as stream:
                yield stream
            beside.replace(file)
        finally:
            with suppress(OSError):
                beside.unlink()
    except OSError as error:
        if error.filename not in (None, str(beside)):
            raise
        raise OSError(error.errno, error.strerror, str(file)) from error


def _read(stream: BinaryIO, file: Path, most: int) -> bytes:
    data = stream.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it has more than {most} bytes", str(file))
    return data


def _refuse_other_than(file: Path, found: os.stat_result, *kinds: int) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind not in kinds:
        raise OSError(errno.EINVAL, f"it is {_KINDS.get(kind, 'no file')}: name a file", str(file))
