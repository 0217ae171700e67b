"""Formation: the robots form a line, a square and a wedge; each knows only its neighbours.

It is consensus about where each robot is beside its place in the shape: x' = -k L (x - shape). No robot is told where
the shape is to stand: it stands around the middle of all robots.

Start it with: python configs/examples/formation.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet

K, SPEED = 1.0, 0.1  # gain [1/s]; highest speed of a robot [m/s]
LAPLACIAN = np.array([[1, -1, 0, 0], [-1, 2, -1, 0], [0, -1, 2, -1], [0, 0, -1, 1]])  # r1 - r2 - r3 - r4
SHAPES = {  # places of r1 to r4 [m]
    "line": [(-0.6, 0.0), (-0.2, 0.0), (0.6, 0.0), (0.2, 0.0)],
    "square": [(-0.3, 0.3), (-0.3, -0.3), (0.3, 0.3), (0.3, -0.3)],
    "wedge": [(-0.4, 0.4), (-0.4, -0.4), (0.0, 0.2), (0.0, -0.2)],
}


def slowed(velocities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slow all robots together (N, 2), so that the fastest has SPEED at most: each keeps its direction."""
    fastest = float(np.linalg.norm(velocities, axis=1).max())
    return velocities / max(1.0, fastest / SPEED)


with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    for name, places in SHAPES.items():
        shape = np.array(places) - np.mean(places, axis=0)
        fleet.say(f"form a {name}")
        for _ in fleet.ticks(15):
            x = fleet.points
            fleet.move(slowed(-K * LAPLACIAN @ (x - shape)))
        x = fleet.points
        off = np.linalg.norm(x - x.mean(axis=0) - shape, axis=1)
        fleet.keep(**{f"{name}_error_mm": 1e3 * off})
        print(f"{name}: the robots are {np.round(1e3 * off, 1)} mm off their places")
