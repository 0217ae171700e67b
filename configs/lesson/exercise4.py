"""Exercise 4: a formation without a leader. Each robot knows the way to its two neighbours, and nothing else."""

import numpy as np

from robofleet.behaviours import Behaviour, Decision, Figure, Situation


class Square(Behaviour):
    """Four robots that form a square."""

    class Settings(Behaviour.Settings):
        """Keys of `settings`."""

        side_m: float
        gain_per_s: float

    figures = (Figure("control_error", "m", "mm", "From the corner of the square around the robots' middle."),)

    def decide(self, now: Situation) -> Decision:
        points = now.points(self.team.point_ahead)  # (4, 2): where the robots are [m]
        corners = self.settings.side_m / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # (4, 2) [m]
        velocities = np.zeros_like(points)
        for i in range(4):
            for j in ((i - 1) % 4, (i + 1) % 4):  # the neighbours of robot i
                velocities[i] += self.settings.gain_per_s * (points[j] - points[i])  # CHANGE THIS: now all meet

        off = points - points.mean(axis=0) - corners
        return Decision(velocities, figures={"control_error": np.linalg.norm(off, axis=1)})
