"""To goals between obstacles: every robot changes sides, and none touches a disc, or another robot.

Each robot wants to drive straight to its goal. A filter then takes out of its velocity what would bring it too fast
towards an obstacle (a control barrier function with one constraint each, solved in closed form), and lets it slide to
the right instead. All pass each other on the same side, so nobody blocks anybody.

Start it with: python configs/examples/obstacles.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet

SPEED, K, GAMMA = 0.12, 1.0, 1.0  # highest [m/s]; gains of goal and filter [1/s]
DISCS = np.array([[0.0, 0.1], [0.5, -0.55]])  # centres of the obstacles [m]
KEEP = 0.25  # of a point ahead from a disc's centre, and from another point ahead [m]

Array = NDArray[np.float64]


def filtered(velocity: Array, point: Array, obstacle: Array) -> Array:
    """Return the velocity that keeps d' >= -gamma (d - keep), for the distance d from the obstacle."""
    d = float(np.linalg.norm(point - obstacle))
    away = (point - obstacle) / d
    lacking = float(-GAMMA * (d - KEEP) - velocity @ away)
    if lacking <= 0:
        return velocity
    right: Array = np.array([-away[1], away[0]])  # of who drives towards it
    return velocity + lacking * (away + right)


with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    goals = fleet.points * [-1, 1]
    fleet.mark("goals", goals)
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    for k, disc in enumerate(DISCS):
        fleet.mark(f"obstacle {k + 1}", disc + KEEP * np.column_stack([np.cos(angle), np.sin(angle)]), closed=True)
    nearest = np.inf
    for _ in fleet.ticks(40):
        x = fleet.points
        v = K * (goals - x)
        v *= np.minimum(1.0, SPEED / np.linalg.norm(v, axis=1, keepdims=True))
        for i in range(len(x)):
            for obstacle in [*DISCS, *np.delete(x, i, axis=0)]:
                v[i] = filtered(v[i], x[i], obstacle)
        fleet.move(v)
        nearest = min(nearest, np.linalg.norm(x[:, None] - DISCS, axis=2).min())
    off = np.linalg.norm(goals - fleet.points, axis=1)
    fleet.keep(from_goal_mm=1e3 * off, nearest_to_an_obstacle_mm=1e3 * nearest)

print(f"the robots are {np.round(1e3 * off, 1)} mm from their goals,")
print(f"and the nearest to an obstacle was {1e3 * nearest:.0f} mm away")
