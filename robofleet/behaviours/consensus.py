"""Consensus: all robots meet, and each knows its neighbours only.

The agreement protocol x_i' = -k sum_j (x_i - x_j) over the neighbours j, for the points ahead (Mesbahi and Egerstedt,
Graph Theoretic Methods in Multiagent Networks, 2010, chapter 3). On a connected graph it leads all points to one, and
the sum of |x_i - x_j|^2 over the edges never grows, also where a robot is slowed. The barrier keeps the bodies apart.
"""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robofleet.behaviours import Behaviour, Bound, Decision, Figure, Refusal, Situation, Team
from robofleet.behaviours.limits import point_speeds, slowed
from robofleet.core.arrays import Array
from robofleet.core.settings import MANY, Name, within

Edge = Annotated[tuple[Name, Name], Field(strict=False)]


class Consensus(Behaviour):
    """Robots that meet."""

    class Settings(Behaviour.Settings):
        """The neighbours, the gain, and the highest speed."""

        graph: Literal["ring", "complete", "line"] = "ring"
        """``ring``: each robot and the next one of the group, the last one and the first. ``line``: the same without
        the last and the first. ``complete``: all robots."""
        edges: Annotated[tuple[Edge, ...], Field(min_length=1, max_length=MANY, strict=False)] | None = None
        """Pairs of robots, in the place of ``graph``."""
        gain_per_s: Annotated[float, within(1e-3, 100)] = 0.5
        """Speed of a robot, by its distance from a neighbour (k)."""
        speed_m_s: Annotated[float, within(1e-3, 10)] = 0.08
        """Highest speed of a robot. Who asks for less than half of its top speed may wait for others, and is not taken
        for blocked by them."""

        def adjacency(self, robots: Sequence[str]) -> Array:
            """Return the matrix A (N, N): 1 where two robots are neighbours, else 0."""
            n = len(robots)
            pairs = {
                "ring": [(i, (i + 1) % n) for i in range(n)],
                "line": [(i, i + 1) for i in range(n - 1)],
                "complete": [(i, j) for i in range(n) for j in range(i)],
            }[self.graph]
            if self.edges is not None:
                pairs = [(robots.index(a), robots.index(b)) for a, b in self.edges if {a, b} <= set(robots)]
            matrix = np.zeros((n, n))
            for i, j in pairs:
                matrix[i, j] = matrix[j, i] = float(i != j)
            return matrix

    figures = (Figure("disagreement", "m", "mm", "Distance from the middle of the group."),)

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        adjacency = settings.adjacency(team.robots)
        self._laplacian = np.diag(adjacency.sum(axis=1)) - adjacency

    def decide(self, now: Situation) -> Decision:
        points = now.points(self.team.point_ahead)
        velocities = -self.settings.gain_per_s * self._laplacian @ points
        disagreement = np.linalg.norm(points - points.mean(axis=0), axis=1)
        return Decision(slowed(velocities, self.settings.speed_m_s), figures={"disagreement": disagreement})

    def bounds(self) -> Iterator[Bound]:
        yield from point_speeds(self.team, "settings.speed_m_s", self.settings.speed_m_s)

    def refusals(self) -> Iterator[Refusal]:
        """Yield edges of robots that are not there, and a graph that is in parts."""
        robots, n = self.team.robots, len(self.team)
        for k, edge in enumerate(self.settings.edges or ()):
            for end, robot in enumerate(edge):
                if robot not in robots:
                    yield Refusal(f"settings.edges.{k}.{end}", f"{robot} is not in the group: name one that is")
            if edge[0] == edge[1]:
                yield Refusal(f"settings.edges.{k}", f"{edge[0]} is no neighbour of itself: name two robots")
        reached = np.linalg.matrix_power(np.eye(n) + self.settings.adjacency(robots) / n, n)[0]
        if alone := [robot for robot, way in zip(robots, reached, strict=True) if way == 0.0]:
            message = f"no edges lead from {robots[0]} to {', '.join(alone)}: add one"
            yield Refusal("settings.edges", message)
