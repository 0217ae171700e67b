"""Consensus: all robots meet, and each knows its neighbours only.

The agreement protocol x_i' = -k sum_j (x_i - x_j) over the neighbours j, for the points ahead (Mesbahi and Egerstedt,
Graph Theoretic Methods in Multiagent Networks, 2010, chapter 3). On a connected graph it leads all points to one, and
the sum of |x_i - x_j|^2 over the edges never grows, also where a robot is slowed. The barrier keeps the bodies apart.
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from robofleet.behaviours import Behaviour, Bound, Decision, Figure, Refusal, Situation, Team
from robofleet.behaviours.graphs import GraphSettings
from robofleet.behaviours.limits import point_speeds, slowed
from robofleet.core.settings import within


class Consensus(Behaviour):
    """Robots that meet."""

    class Settings(GraphSettings):
        """The neighbours, the gain, and the highest speed."""

        gain_per_s: Annotated[float, within(1e-3, 100)] = 0.5
        """Speed of a robot, by its distance from a neighbour (k)."""
        speed_m_s: Annotated[float, within(1e-3, 10)] = 0.08
        """Highest speed of a robot. Who asks for less than half of its top speed may wait for others, and is not taken
        for blocked by them."""

    figures = (Figure("disagreement", "m", "mm", "Distance from the middle of the group."),)

    def __init__(self, settings: Settings, team: Team) -> None:
        """Know who is whose neighbour."""
        super().__init__(settings, team)
        self._laplacian = settings.laplacian(team.robots)

    def decide(self, now: Situation) -> Decision:
        """Return the agreement protocol's velocities."""
        points = now.points(self.team.point_ahead)
        velocities = -self.settings.gain_per_s * self._laplacian @ points
        disagreement = np.linalg.norm(points - points.mean(axis=0), axis=1)
        return Decision(slowed(velocities, self.settings.speed_m_s), figures={"disagreement": disagreement})

    def bounds(self) -> Iterator[Bound]:
        """Yield whether the wheels can do it."""
        yield from point_speeds(self.team, "settings.speed_m_s", self.settings.speed_m_s)

    def refusals(self) -> Iterator[Refusal]:
        """Yield what is wrong with the graph."""
        yield from self.settings.refusals(self.team.robots)
