"""The extra ``mujoco``: loaded when a plant or a renderer is made, and refused with one line where it is missing.

Beside that, what the worlds of both have in common.
"""

import math
from importlib.util import find_spec
from typing import Any

from robofleet.core.refusal import how_to_install
from robofleet.vehicles.interface import WorldObstacle

_WALL_M = 0.002  # half thickness of a polygon's side


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


def raise_walls(world: Any, obstacle: WorldObstacle, **how: Any) -> None:
    """Add an obstacle to a world: a disc as a cylinder, of a polygon its sides; ``how``: what MuJoCo's geoms are."""
    kinds, half = mujoco().mjtGeom, obstacle.height / 2.0
    if obstacle.radius:
        middle = [*obstacle.points[0], half]
        world.add_geom(type=kinds.mjGEOM_CYLINDER, size=[obstacle.radius, half, 0.0], pos=middle, **how)
        return
    corners = obstacle.points
    for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True):
        size = [math.dist((x0, y0), (x1, y1)) / 2.0, _WALL_M, half]
        middle, turn = [(x0 + x1) / 2.0, (y0 + y1) / 2.0, half], turned(math.atan2(y1 - y0, x1 - x0))
        world.add_geom(type=kinds.mjGEOM_BOX, size=size, pos=middle, quat=turn, **how)
