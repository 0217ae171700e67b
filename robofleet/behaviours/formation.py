"""Formation: a rigid shape moves along a closed path, and each robot keeps its place in it.

The shape's frame moves along the path r(gamma t) with its x axis along the tangent, or in a fixed direction. Robot i's
place is r_i(t) = r + R(theta) offset_i. Its point ahead follows r_i by the Newton-Raphson flow (eq. 31); no robot needs
to know of another.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours import laps
from robofleet.behaviours.interface import (
    Behaviour,
    Bound,
    Decision,
    Figure,
    Line,
    Measure,
    Past,
    Pose,
    Refusal,
    Situation,
    Team,
)
from robofleet.behaviours.limits import clear_of_each_other, inside, wheels
from robofleet.behaviours.paths import PathFile
from robofleet.control.point import PointFlow
from robofleet.control.trajectory import Trajectory, demanded
from robofleet.core.arrays import Array
from robofleet.core.settings import ROBOTS, Coordinate, Degrees, within

_CHECK_STEP_S = 0.01  # between the instants that are looked at before a run
_SAMPLES_PER_SIDE = 256  # of the path, to turn it into ways of the robots


class Formation(Behaviour):
    """A shape that moves."""

    class Settings(Behaviour.Settings):
        """The path, its rate, and the shape."""

        path: PathFile
        """Path of the shape's origin."""
        path_rate: Annotated[float, within(1e-6, 100)]
        """Speed of the shape's origin, in sides of the path per second."""
        offsets_m: Annotated[
            tuple[Annotated[tuple[Coordinate, Coordinate], Field(strict=False)], ...],
            Field(min_length=1, max_length=ROBOTS, strict=False),
        ]
        """Place of each robot in the shape, in the group's order: forwards and to the left of the origin."""
        heading_deg: Degrees | None = None
        """Direction of the shape [world frame]. Without it the shape turns with the path."""

    figures = (
        Figure("control_error", "m", "mm", "Distance of the predicted point from its reference (|r - g|)."),
        Figure("shape_error", "m", "mm", "Distance from the place in the shape, wherever the whole shape is."),
    )

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._flow = PointFlow(len(team), team.flow.alpha, team.flow.horizon, team.tick, team.flow.integrator)
        self._frame = Trajectory.path(settings.path.path(), settings.path_rate, 0.0)

    def restart(self) -> None:
        self._flow.u[:] = 0.0

    def by_point_flow(self) -> bool:
        return True

    def changed(self, velocities: Array) -> None:
        self._flow.u[:] = velocities

    def decide(self, now: Situation) -> Decision:
        points = now.points(self.team.point_ahead)
        here, ahead = self._at(np.array([now.t, now.t + self.team.flow.horizon])).transpose(1, 0, 2)
        u, error = self._flow.update(points, ahead, now.driving, now.disturbance)
        off = points - here
        shape = np.linalg.norm(off - off.mean(axis=0), axis=1)
        return Decision(u, references=here, figures={"control_error": error, "shape_error": shape})

    def places(self) -> list[Pose] | None:
        """Return centres from which the points ahead are at their places, and move ahead."""
        if any(self.refusals()):
            return None
        length, soon = self.team.point_ahead, self._at(np.array([0.0, 1e-3]))
        way = soon[:, 1] - soon[:, 0]
        psi = np.arctan2(way[:, 1], way[:, 0])
        centres = soon[:, 0] - length * np.column_stack([np.cos(psi), np.sin(psi)])
        return [(x, y, heading) for (x, y), heading in zip(centres.tolist(), psi.tolist(), strict=True)]

    def refusals(self) -> Iterator[Refusal]:
        if len(self.settings.offsets_m) != len(self.team):
            message = f"has {len(self.settings.offsets_m)} places for {len(self.team)} robots: write one for each"
            yield Refusal("settings.offsets_m", message)

    def bounds(self) -> Iterator[Bound]:
        """Yield whether all ways are in the arena, slow enough for the wheels, and clear of each other."""
        if any(self.refusals()):
            return
        path, rate = self.settings.path.path(), self.settings.path_rate
        cusp = laps.no_cusp(laps.drive_lap(path, rate, self.team.point_ahead, centre_tracked=True), "settings.path")
        yield cusp
        if not cusp.holds:
            return
        centres, step = [], _CHECK_STEP_S
        for i, way in enumerate(self._ways()):
            t, v, omega, centre = demanded(way, self.team.point_ahead, _CHECK_STEP_S)
            centres.append(centre)
            where, step = partial(self._where, t), float(t[1] - t[0])
            yield from inside(self.team, i, "settings.path", way.position(t), where)
            yield from wheels(self.team, i, "settings.path_rate", (v, omega), where, self._slower)
        mend = "move their offsets apart"
        yield from clear_of_each_other(self.team, "settings.offsets_m", np.array(centres), step, mend)

    def shapes(self) -> list[Line]:
        """Return the path, and each robot's way."""
        t = np.linspace(0.0, self._frame.end, 400, endpoint=False)
        ways = zip(self.team.robots, self._at(t), strict=True)
        return [
            Line("path", self._frame.position(t), True, True),
            *(Line(robot, way, True, True) for robot, way in ways),
        ]

    def measures(self, past: Past) -> list[Measure]:
        """Return how far the true points are from where they are to be."""
        off = past.points - self._at(past.t).transpose(1, 0, 2)
        error = np.where(past.known, np.linalg.norm(off, axis=-1), np.nan)
        meaning = "Distance of the true point from its reference at the same instant."
        return [Measure("timed_error", "m", error, self.team.robots, "mm", meaning, counts=past.spaced)]

    def _at(self, t: Array) -> Array:
        """Return every robot's place at instants (M,), shape (N, M, 2) [m]."""
        if self.settings.heading_deg is None:
            x, y = np.moveaxis(self._frame.velocity(t), -1, 0)
            c, s = (x, y) / np.maximum(np.hypot(x, y), np.finfo(np.float64).tiny)
        else:
            angle = math.radians(self.settings.heading_deg)
            c, s = np.full(t.shape, math.cos(angle)), np.full(t.shape, math.sin(angle))
        forwards, left = np.array(self.settings.offsets_m).T[:, :, None]
        return np.stack([forwards * c - left * s, forwards * s + left * c], axis=-1) + self._frame.position(t)

    def _ways(self) -> Iterator[Trajectory]:
        """Yield each robot's way: cubics through many of its places."""
        t = np.linspace(0.0, self._frame.end, self.settings.path.path().sides * _SAMPLES_PER_SIDE + 1)
        near = 1e-4 * t[1]
        velocities = (self._at(t + near) - self._at(t - near)) / (2 * near)
        for points, velocity in zip(self._at(t), velocities, strict=True):
            yield Trajectory.hermite(t, points, velocity, closed=True)

    def _where(self, t: Array, k: int) -> str:
        return f"at path parameter {t[k] * self.settings.path_rate:.2f}"

    def _slower(self, share: float) -> str:
        return f"path_rate {laps.rounded_down(share * self.settings.path_rate):g} fits"
