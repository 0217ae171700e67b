"""Who is whose neighbour: the settings of an undirected graph between the robots of a group."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import Array, Refusal
from robofleet.core.settings import MANY, Model, Name

Edge = Annotated[tuple[Name, Name], Field(strict=False)]


class GraphSettings(Model):
    """Which robots are neighbours."""

    graph: Literal["ring", "complete", "line"] = "ring"
    """``ring``: each robot and the next one of the group, the last one and the first. ``line``: the same without the
    last and the first. ``complete``: all robots."""
    edges: Annotated[tuple[Edge, ...], Field(min_length=1, max_length=MANY, strict=False)] | None = None
    """Pairs of robots, in the place of ``graph``."""

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

    def laplacian(self, robots: Sequence[str]) -> Array:
        """Return the graph's Laplacian L (N, N): (L x)_i is the sum of x_i - x_j over the neighbours j."""
        matrix = self.adjacency(robots)
        return np.asarray(np.diag(matrix.sum(axis=1)) - matrix)

    def refusals(self, robots: Sequence[str]) -> Iterator[Refusal]:
        """Yield edges of robots that are not there, and a graph that is in parts."""
        for k, edge in enumerate(self.edges or ()):
            for end, robot in enumerate(edge):
                if robot not in robots:
                    yield Refusal(f"settings.edges.{k}.{end}", f"{robot} is not in the group: name one that is")
            if edge[0] == edge[1]:
                yield Refusal(f"settings.edges.{k}", f"{edge[0]} is no neighbour of itself: name two robots")
        reached = np.linalg.matrix_power(np.eye(len(robots)) + self.adjacency(robots) / len(robots), len(robots))[0]
        if alone := [robot for robot, way in zip(robots, reached, strict=True) if way == 0.0]:
            message = f"no edges lead from {robots[0]} to {', '.join(alone)}: add one"
            yield Refusal("settings.edges", message)
