"""The robots' firmware (``drivers/firmware``), compiled for this computer: tests and a twin call it through cffi."""

import shutil
import subprocess
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.core.errors import RobofleetError
from robofleet.simulation.compiled_c import compiled

SOURCES = Path(__file__).parents[1] / "drivers" / "firmware"
UNITS = ("gate.c", "rfp.c", "memory.c", "robot.c", "board_host.c", "udp.c")
_HEADERS = ("robot.h", "board_host.h", "udp.h")  # they include the others
FLAGS: tuple[str, ...] = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror")


class NoCompilerError(RobofleetError):
    """Raised where the firmware cannot be compiled: there is no C compiler, no cffi, or an error in the sources."""


class Library(NamedTuple):
    """The compiled firmware, as cffi gives it: ``c.gate_step(...)``, ``ffi.new("struct gate *")``."""

    ffi: Any
    c: Any


def firmware_library(built_in: Mapping[str, object], sources: Path = SOURCES, *flags: str) -> Library:
    """Compile the firmware, or take what was compiled before.

    Args:
        built_in: Values of ``config.h``, by their names without ``RFP_``.
        sources: Folder of the sources.
        flags: More flags for the compiler.

    Raises:
        NoCompilerError: It cannot be compiled here.
    """
    try:
        from cffi import FFI  # noqa: PLC0415
    except ImportError as error:
        raise NoCompilerError("the firmware's twin needs cffi: pip install 'robofleet[lab]'") from error
    target = _made("firmware", sources, (*FLAGS, "-fPIC", "-shared", *flags), built_in)
    ffi = FFI()
    ffi.cdef((target / "declarations.h").read_text())
    return Library(ffi, ffi.dlopen(str(target / "firmware")))


def image_files() -> list[Path]:
    """Return the files that decide an image: all but guides and what was built."""
    found = (file for file in sorted(SOURCES.rglob("*")) if file.is_file() and file.suffix != ".md")
    return [file for file in found if "build" not in file.relative_to(SOURCES).parts]


def robot_program(built_in: Mapping[str, object]) -> Path:
    """Return a robot that is a process of its own, at a UDP port (``boards/host_udp.c``); as ``firmware_library``."""
    return _made("robot", SOURCES, FLAGS, built_in, "boards/host_udp.c") / "robot"


def _made(name: str, sources: Path, flags: tuple[str, ...], built_in: Mapping[str, object], *more_units: str) -> Path:
    """Return the folder of what was compiled: ``name``, and ``declarations.h`` for cffi."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise NoCompilerError("NO C COMPILER: the firmware's twin needs cc: apt install gcc")
    units = [sources / unit for unit in (*UNITS, *more_units)]
    build = [compiler, *flags, *(f"-DRFP_{key}={value}" for key, value in sorted(built_in.items())), *map(str, units)]
    content = [repr(build).encode(), *(file.read_bytes() for file in sorted({*sources.glob("*.[ch]"), *units}))]
    return compiled(name, content, partial(_compile, build, sources, name))


def _compile(build: list[str], sources: Path, target: str, folder: Path) -> None:
    for name in ("stdint.h", "stdbool.h"):  # cffi knows what stands in them
        (folder / name).touch()
    headers = "".join(f'#include "{name}"\n' for name in _HEADERS)
    declare = [build[0], "-E", "-P", "-nostdinc", f"-I{folder}", f"-I{sources}", "-xc", "-"]
    try:
        declarations = subprocess.run(declare, input=headers, capture_output=True, text=True, check=True).stdout
        make = [*build, "-o", str(folder / target)]
        subprocess.run(make, capture_output=True, text=True, check=True, cwd=folder)
    except subprocess.CalledProcessError as error:
        raise NoCompilerError(f"the firmware cannot be compiled: {error.stderr.strip()}") from error
    (folder / "declarations.h").write_text(declarations)
