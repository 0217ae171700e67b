"""Paths, and a platoon of ideal robots that is driven without anything around it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path as File

import numpy as np
import pytest
import yaml

from robofleet.control.path import Path
from robofleet.control.platoon import PlatoonSettings
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.control.driven import WHEELS, Column, Platoon
from tests.robots import GTERNAL

CONFIGS = File(__file__).parent.parent.parent / "configs"
DRIVE = replace(GTERNAL, motor_lag=0.0)
PAPER = PlatoonSettings(
    alpha=45.0,
    horizon=0.6,
    point_ahead=0.08,
    spacing=0.25,
    path_rate=0.0455,
    tick=0.033,
    integrator="exact",
    track="point",
)


@pytest.fixture(scope="session")
def knots() -> tuple[np.ndarray, np.ndarray]:
    """Return the knots and derivatives of the platoon's path."""
    rows = yaml.safe_load((CONFIGS / "paths" / "platoon.yaml").read_text())["knots"]
    return np.array([row["at_m"] for row in rows]), np.array([row["derivative_m"] for row in rows])


@pytest.fixture(scope="session")
def platoon_path(knots: tuple[np.ndarray, np.ndarray]) -> Path:
    return Path.hermite(*knots)


@pytest.fixture(scope="session")
def figure_eight() -> Path:
    """Return eight sides of x = sin t, y = sin(2t) / 2, which cross at parameters 0 and 4."""
    t = np.arange(8) * np.pi / 4
    knots = np.stack([np.sin(t), np.sin(2 * t) / 2], axis=1)
    return Path.hermite(knots, np.stack([np.cos(t), np.cos(2 * t)], axis=1) * np.pi / 4)


@pytest.fixture(scope="session")
def any_path() -> Callable[[int], Path]:
    """Return random closed paths, loops and cusps included."""

    def make(seed: int) -> Path:
        rng = np.random.default_rng(seed)
        sides = int(rng.integers(2, 7))
        return Path.hermite(rng.uniform(-1, 1, (sides, 2)), rng.uniform(-4, 4, (sides, 2)))

    return make


@pytest.fixture(scope="session")
def platoon_of(platoon_path: Path) -> Callable[..., Platoon]:
    """Return platoons with the paper's settings but for those named."""

    def make(n: int = 4, path: Path = platoon_path, **settings: object) -> Platoon:
        return Platoon(path, replace(PAPER, **settings), (DRIVE,) * n)  # type: ignore[arg-type]

    return make


@pytest.fixture(scope="session")
def line_up(platoon_path: Path) -> Callable[..., np.ndarray]:
    """Return poses (N, 3) whose points p are on the path, turned off the tangent by an angle."""

    def make(sigma: np.ndarray, turned: np.ndarray | float = 0.0, path: Path = platoon_path) -> np.ndarray:
        tangent = path.tangent(sigma)
        psi = np.arctan2(tangent[:, 1], tangent[:, 0]) + turned
        centre = path.position(sigma) - PAPER.point_ahead * np.stack([np.cos(psi), np.sin(psi)], axis=1)
        return np.column_stack([centre, psi])

    return make


@dataclass
class Moment:
    """A tick of a simulated run: everything is from before the robots move."""

    t: float
    poses: np.ndarray  # (N, 3)
    decisions: np.ndarray  # (N, 11)
    platoon: Platoon

    @property
    def points(self) -> np.ndarray:
        """Return the points p (N, 2) [m]."""
        return self.decisions[:, [Column.POINT_X, Column.POINT_Y]]

    @property
    def wheels(self) -> np.ndarray:
        """Return left and right (N, 2) [rad/s]."""
        return self.decisions[:, WHEELS]

    @property
    def gaps(self) -> np.ndarray:
        """Return the distances of the points p to their predecessors', (N - 1,) [m]."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1)


@pytest.fixture(scope="session")
def drive_platoon() -> Callable[..., Iterator[Moment]]:
    """Return the closed loop with ideal robots, tick by tick; those that ``blocked`` names stand still."""

    def run(
        platoon: Platoon,
        poses: np.ndarray,
        seconds: float,
        driving: Callable[[float], np.ndarray] | None = None,
        blocked: Callable[[float], set[int]] = lambda t: set(),
    ) -> Iterator[Moment]:
        poses, tick = poses.copy(), platoon.settings.tick
        for k in range(round(seconds / tick)):
            t = k * tick
            allowed = np.ones(len(poses), dtype=np.bool_) if driving is None else driving(t)
            decisions = platoon.tick(t, poses, allowed)
            yield Moment(t, poses.copy(), decisions, platoon)
            wheels = decisions[:, WHEELS]
            for i, pose in enumerate(poses):
                if i not in blocked(t):
                    body = body_from_wheels(*wheels[i], DRIVE.wheel_radius, DRIVE.wheel_base)
                    poses[i] = arc(*pose, *body, tick)

    return run
