"""Coverage: the robots spread over the arena so that every place is near to one of them.

Each robot moves to the middle of its Voronoi cell, which is all places that it is the nearest robot to:
x_i' = k (C_i - x_i), for the points ahead (Lloyd's descent; Cortes, Martinez, Karatas and Bullo, Coverage control for
mobile sensing networks, IEEE Trans. Robotics and Automation 20(2), 2004). The locational cost, the mean of the squared
distances from places to their nearest robots, never grows. Places are a grid's cells; a density makes some count more.
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours import Behaviour, Bound, Decision, Dots, Figure, Situation, Team
from robofleet.behaviours.limits import point_speeds, slowed
from robofleet.core.arrays import Array
from robofleet.core.settings import Coordinate, Length, within


class Coverage(Behaviour):
    """Robots that spread."""

    class Settings(Behaviour.Settings):
        """The density, the gain, and the highest speed."""

        peak_m: Annotated[tuple[Coordinate, Coordinate], Field(strict=False)] | None = None
        """Place that counts most [world frame], with a Gaussian density around it. Without it all places are equal."""
        peak_width_m: Length = 0.5
        """Standard deviation of the Gaussian density."""
        gain_per_s: Annotated[float, within(1e-3, 100)] = 1.0
        """Speed of a robot, by its distance from the middle of its cell (k)."""
        speed_m_s: Annotated[float, within(1e-3, 10)] = 0.1
        """Highest speed of a robot."""
        cells: Annotated[int, within(8, 200)] = 64
        """Cells of the grid along the arena's longer side."""

    figures = (Figure("locational_cost", "m2", meaning="Mean squared distance from a place to the nearest robot."),)

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._places = places(team.arena, settings.cells)
        self._far = (self._places**2).sum(axis=1)  # squared distances from the origin
        far = 0.0 if settings.peak_m is None else ((self._places - settings.peak_m) ** 2).sum(axis=1)
        density = np.exp(-(far - np.min(far)) / 2 / settings.peak_width_m**2) * np.ones(len(self._places))
        self._density = density / density.sum()

    def decide(self, now: Situation) -> Decision:
        """Return velocities towards the middles of the cells."""
        points, s = now.points(self.team.point_ahead), self.settings
        squared = self._far[:, None] - 2.0 * self._places @ points.T + (points**2).sum(axis=1)
        nearest, weight = squared.argmin(axis=1), self._density
        mass, *moments = (np.bincount(nearest, weight * v, len(points)) for v in (1.0, *self._places.T))
        middles = np.where(mass[:, None] > 0, np.column_stack(moments) / np.maximum(mass, 1e-300)[:, None], points)
        cost = float(weight @ squared.min(axis=1))
        velocities = slowed(s.gain_per_s * (middles - points), s.speed_m_s)
        return Decision(velocities, references=middles, figures={"locational_cost": cost})

    def bounds(self) -> Iterator[Bound]:
        yield from point_speeds(self.team, "settings.speed_m_s", self.settings.speed_m_s)

    def shapes(self) -> list[Dots]:
        """Return the place that counts most."""
        return [Dots("peak", np.array([self.settings.peak_m]))] if self.settings.peak_m else []


def places(arena: tuple[float, float], cells: int) -> Array:
    """Return the middles of a grid's cells (M, 2) [m; world], of which ``cells`` lie along the arena's longer side."""
    cell = max(arena) / cells
    x, y = (side * ((np.arange(n) + 0.5) / n - 0.5) for side in arena for n in [max(1, round(side / cell))])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
