"""The settings of a reference in time: a closed path at a rate, a table of t, x, y, or smoothed way points."""

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import Refusal
from robofleet.behaviours.laps import rounded_down
from robofleet.behaviours.paths import PathFile
from robofleet.control.trajectory import Trajectory, spline
from robofleet.core.arrays import Array
from robofleet.core.settings import MANY, Coordinate, Instant, Model, within
from robofleet.vehicles.differential_drive import DifferentialDrive

Waypoint = Annotated[tuple[Coordinate, Coordinate], Field(strict=False)]
Row = Annotated[tuple[Instant, Coordinate, Coordinate], Field(strict=False)]

_KINDS = {
    "path": ("path_rate", "path_start"),
    "csv": ("interpolation",),
    "waypoints_m": ("speed_m_s", "acceleration_m_s2", "closed"),
}
_NEEDED = {"path": ("path_rate",), "csv": (), "waypoints_m": ("speed_m_s",)}
_LEFT_TO_STEER = 0.9  # share of the wheels' speed that a way through way points uses: the law needs the rest


class Reference(Model):
    """A reference of one robot: one of ``path``, ``csv`` and ``waypoints_m``, and the keys that go with it."""

    path: PathFile | None = None
    """Closed path: a file of ``paths/`` by its name, or knots. It is repeated lap by lap."""
    path_rate: Annotated[float, within(1e-6, 100)] | None = None
    """Speed along the path, in sides per second."""
    path_start: Annotated[float, within(0, MANY)] = 0.0
    """Parameter of the path at which the run begins, in sides."""
    csv: Annotated[tuple[Row, ...], Field(min_length=2, max_length=MANY, strict=False)] | None = None
    """CSV file with the header ``t_s,x_m,y_m`` (a path from the configuration's folder), or its rows. Times count from
    the start of the run. After its last row the reference stays there."""
    interpolation: Literal["cubic", "linear"] = "cubic"
    """Between two rows of the CSV file: ``cubic`` has no jump in the velocity, ``linear`` is straight."""
    waypoints_m: Annotated[tuple[Waypoint, ...], Field(min_length=2, max_length=500, strict=False)] | None = None
    """Way points [world frame]. The way through them is a cubic spline."""
    speed_m_s: Annotated[float, within(1e-3, 10)] | None = None
    """Highest speed along the way points. In a bend it is lower if the wheels need that."""
    acceleration_m_s2: Annotated[float, within(1e-3, 100)] = 0.2
    """Highest acceleration along the way points."""
    closed: bool = False
    """``true``: the way leads from the last way point back to the first, lap by lap. ``false``: it ends at rest."""

    @property
    def kind(self) -> str:
        """The key that says where the reference is: ``path``, ``csv`` or ``waypoints_m``."""
        return next(name for name in _KINDS if getattr(self, name) is not None)

    def refusals(self, key: str) -> Iterator[Refusal]:
        """Yield what is wrong; ``key`` leads to the reference."""
        given = [name for name in _KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "has none of path, csv and waypoints_m"
            yield Refusal(key, f"{found}: write one of them")
            return
        for name in _NEEDED[given[0]]:
            if getattr(self, name) is None:
                yield Refusal(key, f"has {given[0]} without {name}: add it")
        for kind, names in _KINDS.items():
            for name in names:
                if kind != given[0] and getattr(self, name) != type(self).model_fields[name].default:
                    yield Refusal(f"{key}.{name}", f"belongs to {kind}, and this reference has {given[0]}: remove it")
        yield from self._unsorted(f"{key}.csv")
        yield from self._repeated(f"{key}.waypoints_m")

    @property
    def speed_key(self) -> str:
        """The key that says how fast it is."""
        return {"path": "path_rate", "csv": "csv", "waypoints_m": "speed_m_s"}[self.kind]

    def slower(self, share: float) -> str:
        """Return in words what fits, if only a share of its speed does."""
        if self.kind == "csv":
            return f"times {math.ceil(100 / share) / 100:g} times as long fit"
        return f"{self.speed_key} {rounded_down(share * getattr(self, self.speed_key)):g} fits"

    def trajectory(self, drive: DifferentialDrive, ahead: float) -> Trajectory:
        """Return the reference in time of a robot; ``ahead`` [m] in front of the axle is what follows it."""
        if self.path is not None and self.path_rate is not None:
            path = self.path.path()
            return Trajectory.path(path, self.path_rate, self.path_start % path.sides)
        if self.csv is not None:
            rows = np.array(self.csv)
            times = np.ascontiguousarray(rows[:, 0])
            return Trajectory.samples(times, rows[:, 1:], smooth=self.interpolation == "cubic")
        assert self.waypoints_m is not None and self.speed_m_s is not None, "refused before"
        return Trajectory.waypoints(
            np.array(self.waypoints_m), closed=self.closed, speed=self.speed_m_s, acceleration=self.acceleration_m_s2,
            most=lambda curvature: _LEFT_TO_STEER * _in_bends(drive, ahead, curvature),
        )  # fmt: skip

    def tightest_m(self) -> float | None:
        """Return the radius of the sharpest bend between way points [m]; None without way points."""
        if self.waypoints_m is None:
            return None
        sharpest = float(spline(np.array(self.waypoints_m), closed=self.closed).curvature.max())
        return 1.0 / sharpest if sharpest > 0.0 else math.inf

    def _unsorted(self, key: str) -> Iterator[Refusal]:
        for k, (before, row) in enumerate(itertools.pairwise(self.csv or ())):
            if row[0] <= before[0]:
                message = f"{row[0]:g} s does not come after {before[0]:g} s: sort the rows by time"
                yield Refusal(f"{key}.{k + 1}.0", message)
                return

    def _repeated(self, key: str) -> Iterator[Refusal]:
        places = self.waypoints_m or ()
        if self.closed and places and len(places) < 3:
            yield Refusal(key, "a closed way needs three way points or more: add one")
            return
        following = itertools.pairwise((*places, places[0]) if self.closed and places else places)
        for k, (point, other) in enumerate(following):
            if math.dist(point, other) < 1e-3:
                k_other = (k + 1) % len(places)
                yield Refusal(f"{key}.{k_other}", f"is where way point {k} is: remove one of them")


def fastest_along(drive: DifferentialDrive) -> float:
    """Return the highest speed along way points [m/s]: the wheels have some speed left to steer."""
    return _LEFT_TO_STEER * float(_in_bends(drive, 0.0, np.zeros(1))[0])


def _in_bends(drive: DifferentialDrive, ahead: float, curvature: Array) -> Array:
    """Return the speed [m/s] that the wheels allow to a followed point in bends of a curvature (M,) [1/m].

    A point ahead of the axle has a second bound, that of any direction: its heading lags behind in a sharp bend.
    """
    slower = 1.0 + curvature * drive.wheel_base / 2.0
    if ahead > 0.0:
        slower = np.minimum(slower, math.hypot(1.0, drive.wheel_base / (2.0 * ahead)))
    return np.asarray(np.minimum(drive.max_speed, drive.wheel_radius * drive.max_wheel_speed / slower))
