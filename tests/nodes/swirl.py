"""A behaviour of a test: robots on a circle round the arena's middle."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from robofleet.behaviours.interface import Behaviour, Decision, Dots, Figure, Line, Shape, Situation
from robofleet.core.settings import Model, within


class Swirl(Behaviour):
    """Every robot drives along a circle."""

    class Settings(Model):
        """Its settings."""

        radius_m: Annotated[float, within(0.1, 10)]
        """Radius of the circle."""

    settings: Settings
    figures = (
        Figure("radius_error", "m", "mm", "distance of p from the circle"),
        Figure("turned", "rad", "deg", "bearing from the circle's middle"),
        Figure("secret", live=False),
    )

    def decide(self, now: Situation) -> Decision:
        """Drive along the circle, and back to it."""
        points = now.points(self.team.point_ahead)
        radius = np.hypot(*points.T)
        outwards = points / np.maximum(radius, 1e-9)[:, None]
        off = self.settings.radius_m - radius
        along = np.column_stack([-outwards[:, 1], outwards[:, 0]])
        figures = {"radius_error": np.abs(off), "turned": np.arctan2(outwards[:, 1], outwards[:, 0])}
        wanted = 0.05 * along + off[:, None] * outwards
        return Decision(wanted, references=outwards * self.settings.radius_m, figures=figures)

    def shapes(self) -> Sequence[Shape]:
        """Return the circle, and a mark for each robot."""
        turn = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
        circle = self.settings.radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
        return Line("circle", circle, closed=True), Dots("marks", circle[: len(self.team)])
