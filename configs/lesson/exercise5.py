"""Exercise 5: a moving reference. A law that looks only at the error comes too late."""

import numpy as np

from robofleet.behaviours import Behaviour, Decision, Figure, Situation


class Follow(Behaviour):
    """The robot's point ahead follows a point on a circle."""

    class Settings(Behaviour.Settings):
        """Keys of `settings`."""

        radius_m: float
        speed_m_s: float
        gain_per_s: float

    figures = (Figure("control_error", "m", "mm", "From the reference now to the point ahead."),)

    def reference(self, t: float) -> np.ndarray:
        """Return where the point is to be at a time t [s]: (1, 2) [m]."""
        radius_m: float = self.settings.radius_m
        angle = self.settings.speed_m_s / radius_m * t
        return radius_m * np.array([[np.cos(angle), np.sin(angle)]])

    def decide(self, now: Situation) -> Decision:
        points = now.points(self.team.point_ahead)  # (1, 2) [m]
        error = self.reference(now.t) - points

        velocities = self.settings.gain_per_s * error  # CHANGE THIS: the law of the paper, or feed-forward

        distance = np.linalg.norm(error, axis=1)
        return Decision(velocities, references=self.reference(now.t), figures={"control_error": distance})
