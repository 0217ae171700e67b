"""Coverage: the robots spread so that every place is near to one of them, and places that count more are nearer.

Each robot moves to the middle of its Voronoi cell: the places that it is the nearest robot to, weighed by a density.
This is Lloyd's algorithm (Cortes, Martinez, Karatas and Bullo, 2004). It goes down the locational cost: the mean
squared distance from a place to its nearest robot.

Start it with: python configs/examples/voronoi_coverage.py
"""

from pathlib import Path

import numpy as np

from robofleet import Fleet

K = 0.8  # [1/s]
PEAK, WIDTH = np.array([0.7, -0.3]), 0.45  # what counts most: its place and its standard deviation [m]

with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    length, width = fleet.config.arena.size_m
    x, y = np.meshgrid(np.linspace(-length / 2, length / 2, 64), np.linspace(-width / 2, width / 2, 40))
    places = np.column_stack([x.ravel(), y.ravel()])
    density = np.exp(-((places - PEAK) ** 2).sum(axis=1) / (2 * WIDTH**2))
    density /= density.sum()
    costs = []
    for _ in fleet.ticks(25):
        p = fleet.points
        squared = ((places[:, None] - p) ** 2).sum(axis=2)  # (places, N)
        cell = np.eye(len(p))[squared.argmin(axis=1)] * density[:, None]  # whose each place is, and how much it counts
        middles = cell.T @ places / cell.sum(axis=0)[:, None]
        fleet.move(K * (middles - p))
        fleet.mark("middles of the cells", middles)
        costs.append(density @ squared.min(axis=1))
    fleet.keep(cost_before_m2=costs[0], cost_after_m2=costs[-1])

print(f"the locational cost fell from {costs[0]:.4f} to {costs[-1]:.4f} m2")
