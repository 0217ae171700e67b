"""Bad input of a command: exit code 2, and one line a fault."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile

from robofleet.core.errors import BadInputError
from robofleet.core.sentences import wrapped

WEB_PACKAGES = ("jinja2", "segno", "starlette", "uvicorn", "websockets")  # the operator's page; of the extra ``lab``
# of the extra ``lab``, as they are imported
LAB_MODULES = (
    "cryptography",
    "cv2",
    "foxglove_schemas_protobuf",
    "google",
    "matplotlib",
    "mcap",
    "mcap_protobuf",
    "numba",
    "scipy",
    *WEB_PACKAGES,
    "zstandard",
)


class RefusedError(BadInputError):
    """Raised where a command refuses its input: one line for each fault."""


@contextmanager
def bad_input() -> Iterator[None]:
    """End with exit code 2 and one line a fault."""
    import typer  # noqa: PLC0415 - the processes of a run are no commands

    try:
        yield
    except BadInputError as error:
        print(wrapped(str(error), sys.stderr), file=sys.stderr)
        raise typer.Exit(2) from error


def need_extra(extra: str, *packages: str) -> None:
    """Refuse a command whose packages are not installed."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        raise RefusedError(f"this needs {', '.join(missing)}: {how_to_install(extra)}")


def how_to_install(extra: str) -> str:
    """Return the command that brings an extra: to a checkout, or to an installed wheel."""
    if (Path(__file__).parents[2] / "pyproject.toml").exists():
        return f"{sys.executable} -m pip install -e '.[{extra}]' in robofleet's folder"
    return f"{sys.executable} -m pip install 'robofleet[{extra}]'"


def new_folder(folder: Path, named: str = "--out") -> None:
    """Make a folder for what a command leaves; one that holds something already is refused."""
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise RefusedError(f"{named}: {folder} exists already and is not empty: name another folder")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedError(f"{named}: {folder} cannot be made: {error.strerror}: name another folder") from error


def unkept(error: OSError) -> RefusedError:
    """Return the refusal of a place where drivers cannot keep what they must remember."""
    return RefusedError(
        f"{error.filename}: {error.strerror}: what robots must remember is kept there: "
        "make room, make it writable, or name another folder in XDG_STATE_HOME"
    )


def new_place(option: str, folder: Path) -> None:
    """Make a folder that an option names, where there is none; RefusedError if nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        why = os.strerror(error.errno or 0)
        raise RefusedError(f"{option}: {folder} cannot be written to: {why}: name another folder") from error


def new_file(option: str, file: Path) -> None:
    """Refuse a file that an option names and that cannot be written; its folder is made."""
    if file.is_dir():
        raise RefusedError(f"{option}: {file} is a folder: name a file")
    new_place(option, file.parent)
