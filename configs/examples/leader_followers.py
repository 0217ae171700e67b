"""Leader and followers: the first robot drives an oval, and each other one keeps a distance from the one before it.

A follower drives towards its predecessor with the predecessor's speed along their line, and closes the gap g:
v = (v_before . e + k (g - d)) e, which makes g' = -k (g - d). So the gap goes to d, whatever the leader does.

Start it with: python configs/examples/leader_followers.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet

GAP, K = 0.3, 1.0  # from point to point [m]; gain [1/s]
OVAL, PERIOD = np.array([0.9, 0.6]), 55.0  # half axes [m], time of a lap [s]


def oval(t: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the leader's point is to be at a time [m], and how fast it moves there [m/s]."""
    rate = 2 * np.pi / PERIOD
    s, c = np.sin(rate * t), np.cos(rate * t)
    return OVAL * [s, -c], OVAL * rate * [c, s]


with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    n = len(fleet.robots)
    fleet.go_to({robot: (-GAP * i, -OVAL[1], 0) for i, robot in enumerate(fleet.robots)})
    fleet.mark("the leader's way", [oval(t)[0] for t in np.linspace(0, PERIOD, 100)], closed=True)
    for t in fleet.ticks(30):
        x, v = fleet.points, np.zeros((n, 2))
        position, speed = oval(t)
        v[0] = speed + K * (position - x[0])
        for i in range(1, n):
            gap = np.linalg.norm(x[i - 1] - x[i])
            towards = (x[i - 1] - x[i]) / gap
            v[i] = (v[i - 1] @ towards + K * (gap - GAP)) * towards
        fleet.move(v)
    gaps = np.linalg.norm(np.diff(fleet.points, axis=0), axis=1)
    fleet.keep(gap_mm=1e3 * gaps)

print(f"the gaps are {np.round(1e3 * gaps)} mm, wanted are {1e3 * GAP:.0f} mm")
