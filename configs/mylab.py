"""A behaviour of one's own, in a file beside the configuration that names it: swirl.yaml."""

import numpy as np

from robofleet.behaviours import Behaviour, Decision, Figure, Situation


class Swirl(Behaviour):
    """The robots drive around the arena's centre."""

    class Settings(Behaviour.Settings):
        """Keys of `settings`: an unknown one, or a wrong value, is refused at its line."""

        radius_m: float = 0.6
        speed_m_s: float = 0.1

    figures = (Figure("off_circle", "m", shown="mm", meaning="distance from the circle"),)

    def decide(self, now: Situation) -> Decision:
        """Return how fast each robot's point ahead is to move: along the circle, and towards it."""
        points = now.points(self.team.point_ahead)
        outwards = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-6)
        off = self.settings.radius_m * outwards - points
        around = outwards @ [[0.0, 1.0], [-1.0, 0.0]]
        return Decision(self.settings.speed_m_s * around + off, figures={"off_circle": np.linalg.norm(off, axis=1)})
