"""The extra ``mujoco``: loaded when a plant or a renderer is made, and refused with one line where it is missing."""

import math
from importlib.util import find_spec
from typing import Any

from robofleet.core.refusal import how_to_install


def missing(*packages: str) -> str:
    """Return what is not installed, and how to install it; nothing where all is there."""
    lacking = [package for package in packages if find_spec(package) is None]
    return f"{', '.join(lacking)} is not installed: {how_to_install('mujoco')}" if lacking else ""


def mujoco() -> Any:
    import mujoco as package  # noqa: PLC0415 - an extra

    return package


def turned(psi: float) -> list[float]:
    """Return the quaternion of a turn about the vertical [rad; CCW +]."""
    return [math.cos(psi / 2.0), 0.0, 0.0, math.sin(psi / 2.0)]
