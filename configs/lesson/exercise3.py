"""Exercise 3: a law that brings each robot to its goal."""

import numpy as np

from robofleet.behaviours import Behaviour, Decision, Figure, Situation


class GoThere(Behaviour):
    """Each robot's point ahead goes to a goal."""

    class Settings(Behaviour.Settings):
        """Keys of `settings`."""

        goals_m: list[list[float]]
        speed_m_s: float

    figures = (Figure("control_error", "m", "mm", "Distance to the goal."),)

    def decide(self, now: Situation) -> Decision:
        points = now.points(self.team.point_ahead)  # (N, 2): where the robots are [m]
        goals = np.array(self.settings.goals_m)  # (N, 2): where they are to be [m]

        velocities = np.zeros_like(points)  # CHANGE THIS: (N, 2) [m/s], at most settings.speed_m_s each

        distance = np.linalg.norm(goals - points, axis=1)
        return Decision(velocities, references=goals, figures={"control_error": distance})
