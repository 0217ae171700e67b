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
UNITS = ("gate.c", "rfp.c", "memory.c", "robot.c", "board_host.c")
_HEADERS = ("robot.h", "board_host.h")  # they include the others
FLAGS: tuple[str, ...] = ("-std=c11", "-O2", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror")


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
    compiler = shutil.which("cc")
    if compiler is None:
        raise NoCompilerError("NO C COMPILER: the firmware's twin needs cc: apt install gcc")
    flags = (*FLAGS, *flags, *(f"-DRFP_{name}={value}" for name, value in sorted(built_in.items())))
    content = [repr((compiler, flags)).encode(), *(file.read_bytes() for file in sorted(sources.glob("*.[ch]")))]
    target = compiled("firmware", content, partial(_compile, compiler, flags, sources))
    ffi = FFI()
    ffi.cdef((target / "declarations.h").read_text())
    return Library(ffi, ffi.dlopen(str(target / "firmware.so")))


def _compile(compiler: str, flags: tuple[str, ...], sources: Path, folder: Path) -> None:
    for name in ("stdint.h", "stdbool.h"):  # cffi knows what stands in them
        (folder / name).touch()
    headers = "".join(f'#include "{name}"\n' for name in _HEADERS)
    declare = [compiler, "-E", "-P", "-nostdinc", f"-I{folder}", f"-I{sources}", "-xc", "-"]
    units = [str(sources / unit) for unit in UNITS]
    try:
        declarations = subprocess.run(declare, input=headers, capture_output=True, text=True, check=True).stdout
        make = [compiler, *flags, *units, "-o", str(folder / "firmware.so")]
        subprocess.run(make, capture_output=True, text=True, check=True, cwd=folder)
    except subprocess.CalledProcessError as error:
        raise NoCompilerError(f"the firmware cannot be compiled: {error.stderr.strip()}") from error
    (folder / "declarations.h").write_text(declarations)
