"""Consensus: robots that know only their neighbours meet in the middle of all.

The agreement protocol is x' = -k L x, with the Laplacian L of the graph. The robots' distance from their common middle
shrinks at least as fast as exp(-k lambda t), where lambda is the second eigenvalue of L (the algebraic connectivity).
The script measures the rate. When the robots are near each other the barrier keeps their bodies apart.

Start it with: python configs/examples/consensus.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet

K = 0.06  # [1/s]


def ring(n: int) -> NDArray[np.float64]:
    """Return the Laplacian (n, n) of a ring: each robot knows the one before it and the one behind it."""
    to_next = np.roll(np.eye(n), 1, axis=1)
    return 2 * np.eye(n) - to_next - to_next.T


with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    laplacian = ring(len(fleet.robots))
    connectivity = np.linalg.eigvalsh(laplacian)[1]
    times, spreads = [], []
    for t in fleet.ticks(20):
        x = fleet.points
        fleet.move(-K * laplacian @ x)
        times.append(t)
        spreads.append(np.linalg.norm(x - x.mean(axis=0)))
    half = len(times) // 2  # later the bodies are in each other's way
    rate = np.log(spreads[0] / spreads[half]) / times[half]
    fleet.keep(rate_per_s=rate, spread_m=spreads[-1])

print(f"the robots came from {spreads[0]:.2f} m to {spreads[-1]:.2f} m of disagreement,")
print(f"at {rate:.3f} 1/s in the first {times[half]:.0f} s; the theory promises at least {K * connectivity:.3f} 1/s")
