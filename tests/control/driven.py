"""Paths, and a platoon of ideal robots that is driven by its law and its wheels alone, as the controller has them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import yaml

from robofleet.config.files.names import SHIPPED
from robofleet.control import wheels
from robofleet.control.path import Path
from robofleet.control.platoon import Column as Decided
from robofleet.control.platoon import PlatoonLaw, PlatoonSettings
from robofleet.core.arrays import Array, Flags
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.robots import GTERNAL

DRIVE = replace(GTERNAL, motor_lag=0.0)
PAPER = PlatoonSettings(
    alpha=45.0, horizon=0.6, point_ahead=0.08, spacing=0.25, path_rate=0.0455, tick=0.033, integrator="exact",
    track="point",
)  # fmt: skip
_ROWS = yaml.safe_load((SHIPPED / "paths" / "platoon.yaml").read_text())["knots"]
KNOTS = np.array([row["at_m"] for row in _ROWS]), np.array([row["derivative_m"] for row in _ROWS])
PLATOON_PATH = Path.hermite(*KNOTS)
_T = np.arange(8) * np.pi / 4
# Eight sides of x = sin t, y = sin(2t) / 2, which cross at parameters 0 and 4
FIGURE_EIGHT = Path.hermite(
    np.stack([np.sin(_T), np.sin(2 * _T) / 2], axis=1), np.stack([np.cos(_T), np.cos(2 * _T)], axis=1) * np.pi / 4
)


def any_path(seed: int) -> Path:
    """Return a random closed path, loops and cusps included."""
    rng = np.random.default_rng(seed)
    sides = int(rng.integers(2, 7))
    return Path.hermite(rng.uniform(-1, 1, (sides, 2)), rng.uniform(-4, 4, (sides, 2)))


class Column(IntEnum):
    """Columns of what a tick commands, one row a robot: the law's, with u as the wheels can do it, and the wheels'."""

    U_X = Decided.U_X
    U_Y = Decided.U_Y
    REFERENCE_X = Decided.REFERENCE_X
    REFERENCE_Y = Decided.REFERENCE_Y
    REFERENCE_PARAMETER = Decided.REFERENCE_PARAMETER
    CONTROL_ERROR = Decided.CONTROL_ERROR
    POINT_X = 6
    POINT_Y = 7
    LEFT = 8  # [rad/s]
    RIGHT = 9
    SATURATED = 10  # 1 where the wheels could not do all of it


WHEELS = slice(Column.LEFT, Column.RIGHT + 1)


class Platoon(PlatoonLaw):
    """A platoon whose decisions are commands."""

    def tick(self, t: float, poses: Array, driving: Flags, disturbance: Array | None = None) -> Array:
        """Return what all robots do in the next tick: (N, 11), columns as in Column."""
        decided = super().tick(t, poses, driving, disturbance)
        request = wheels.limited(
            decided[:, :2].copy(), np.zeros(len(poses), dtype=np.bool_), poses, self.settings.point_ahead,
            wheels.limits(self.vehicles), driving,
        )  # fmt: skip
        return np.column_stack([request.u, decided[:, 2:6], request.points, request.wheels, request.saturated])


def platoon_of(n: int = 4, path: Path = PLATOON_PATH, **settings: object) -> Platoon:
    """Return a platoon with the paper's settings but for those named."""
    return Platoon(path, replace(PAPER, **settings), (DRIVE,) * n)  # type: ignore[arg-type]


def line_up(sigma: Array, turned: Array | float = 0.0, path: Path = PLATOON_PATH) -> Array:
    """Return poses (N, 3) whose points p are on the path, turned off the tangent by an angle."""
    tangent = path.tangent(sigma)
    psi = np.arctan2(tangent[:, 1], tangent[:, 0]) + turned
    centre = path.position(sigma) - PAPER.point_ahead * np.stack([np.cos(psi), np.sin(psi)], axis=1)
    return np.column_stack([centre, psi])


@dataclass
class Moment:
    """A tick of a simulated run: everything is from before the robots move."""

    t: float
    poses: Array  # (N, 3)
    decisions: Array  # (N, 11)
    platoon: Platoon

    @property
    def points(self) -> Array:
        """Return the points p (N, 2) [m]."""
        return self.decisions[:, [Column.POINT_X, Column.POINT_Y]]

    @property
    def wheels(self) -> Array:
        """Return left and right (N, 2) [rad/s]."""
        return self.decisions[:, WHEELS]

    @property
    def gaps(self) -> Array:
        """Return the distances of the points p to their predecessors', (N - 1,) [m]."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1)


def drive_platoon(
    platoon: Platoon,
    poses: Array,
    seconds: float,
    driving: Callable[[float], Array] | None = None,
    blocked: Callable[[float], set[int]] = lambda t: set(),
) -> Iterator[Moment]:
    """Drive the closed loop with ideal robots, tick by tick; those that ``blocked`` names stand still."""
    poses, tick = poses.copy(), platoon.settings.tick
    for k in range(round(seconds / tick)):
        t = k * tick
        decisions = platoon.tick(t, poses, np.ones(len(poses), dtype=np.bool_) if driving is None else driving(t))
        yield Moment(t, poses.copy(), decisions, platoon)
        for i, pose in enumerate(poses):
            if i not in blocked(t):
                poses[i] = arc(
                    *pose, *body_from_wheels(*decisions[i, WHEELS], DRIVE.wheel_radius, DRIVE.wheel_base), tick
                )
