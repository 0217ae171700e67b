"""Bad input of a command: exit code 2, and one line a fault."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import typer

WEB_PACKAGES = ("starlette", "uvicorn", "websockets")  # of the extra ``web``
# of the extra ``lab``, as they are imported
LAB_MODULES = (
    "cv2",
    "foxglove_schemas_protobuf",
    "google",
    "matplotlib",
    "mcap",
    "mcap_protobuf",
    "numba",
    "zstandard",
)


class RefusedError(Exception):
    """Bad input; one line a fault."""


@contextmanager
def bad_input() -> Iterator[None]:
    """End with exit code 2 and one line a fault."""
    from robofleet.config.load import ConfigError  # noqa: PLC0415

    try:
        yield
    except (ConfigError, RefusedError) as error:
        print(error, file=sys.stderr)
        raise typer.Exit(2) from error


def need_extra(extra: str, *packages: str) -> None:
    """Refuse a command whose packages are not installed."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        raise RefusedError(f"this needs {', '.join(missing)}: {how_to_install(extra)}")


def how_to_install(extra: str) -> str:
    """Return the command that brings an extra."""
    return f"{sys.executable} -m pip install -e '.[{extra}]' in robofleet's folder"


def new_folder(folder: Path) -> None:
    """Make a folder for what a command leaves; one that holds something already is refused."""
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise RefusedError(f"--out: {folder} is there already and not empty: name another folder")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedError(f"--out: {folder} cannot be made: {error.strerror}") from error
