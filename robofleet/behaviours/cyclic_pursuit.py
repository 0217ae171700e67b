"""Cyclic pursuit: each robot pursues the next one, and all end on a circle, equally spaced.

Every robot moves towards the next one of the group, turned outwards by an angle: x_i' = (v / c) R(-a_i) (x_i+1 - x_i),
for the points ahead (Marshall, Broucke and Francis, Formations of vehicles in cyclic pursuit, IEEE Trans. Automatic
Control 49(11), 2004). With a = pi / N all of them turn counter-clockwise on a circle on which the chord from one to the
next is c = 2 radius sin(pi / N). A robot that is nearer than c to the next one turns further outwards, one that is
further away turns inwards: a_i = pi / N + (c - |x_i+1 - x_i|) / c.
"""

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours import Behaviour, Bound, Decision, Figure, Line, Refusal, Situation
from robofleet.behaviours.limits import on_a_circle, point_speeds
from robofleet.core.settings import Coordinate, Length, within


class CyclicPursuit(Behaviour):
    """Robots on a circle."""

    class Settings(Behaviour.Settings):
        """The circle, and the speed."""

        radius_m: Length
        """Radius of the circle on which the points ahead end."""
        speed_m_s: Annotated[float, within(1e-3, 10)] = 0.1
        """Speed on the circle. A robot with a larger distance to the next one has up to 1.5 times as much."""
        centre_m: Annotated[tuple[Coordinate, Coordinate], Field(strict=False)] | None = None
        """Centre of the circle [world frame]. Without it the group's own middle is the centre."""

    figures = (
        Figure("radius_error", "m", "mm", "Distance from the circle about the group's middle, outwards."),
        Figure("spacing_error", "m", "mm", "Distance to the next robot, less what it is on the circle."),
    )

    def decide(self, now: Situation) -> Decision:
        s, points = self.settings, now.points(self.team.point_ahead)
        chord, middle = 2 * s.radius_m * math.sin(math.pi / len(points)), points.mean(axis=0)
        to_next, out = np.roll(points, -1, axis=0) - points, points - middle
        too_far = np.hypot(*to_next.T) - chord
        angle = math.pi / len(points) * (1 - np.clip(too_far / chord, -0.5, 0.5))
        turned = np.exp(-1j * angle) * (to_next @ [1, 1j]) / chord
        drawn = 0.0 if s.centre_m is None else (s.centre_m - middle) / s.radius_m
        velocities = s.speed_m_s * (np.column_stack([turned.real, turned.imag]) + drawn)
        velocities /= max(1.0, np.hypot(*velocities.T).max() / (1.5 * s.speed_m_s))
        figures = {"radius_error": np.hypot(*out.T) - s.radius_m, "spacing_error": too_far}
        return Decision(velocities, figures=figures)

    def bounds(self) -> Iterator[Bound]:
        """Yield whether the circle is in the arena, and wide enough for wheels and barrier."""
        s = self.settings
        yield from point_speeds(self.team, "settings.speed_m_s", 1.5 * s.speed_m_s)
        if len(self.team) > 1:
            yield from on_a_circle(self.team, s.radius_m, s.speed_m_s, s.centre_m or (0.0, 0.0))

    def refusals(self) -> Iterator[Refusal]:
        if len(self.team) == 1:
            yield Refusal("robots", "a pursuit needs two robots or more: add one")

    def shapes(self) -> list[Line]:
        """Return the circle, where its centre is given."""
        angle = np.linspace(0.0, math.tau, 100, endpoint=False)
        circle = self.settings.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        return [Line("circle", self.settings.centre_m + circle, closed=True)] if self.settings.centre_m else []
