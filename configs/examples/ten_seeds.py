"""An experiment with ten seeds: how far do robots come from a circle, with feedback and without?

Each seed draws other robots: their wheels, their slip, and the noise of their poses. In lockstep a seed gives the same
run whenever it is used; the summary's "trace_hash" is the run's fingerprint.

Start it with: python configs/examples/ten_seeds.py
It leaves ten-seeds.svg in the folder from which it was started.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from robofleet import Fleet

CONFIG = Path(__file__).parents[1] / "script.yaml"
V, OMEGA, K = 0.1, 0.6, 1.0  # on the circle [m/s], [rad/s]; gain of the feedback [1/s]


def trial(seed: int, feedback: bool, seconds: float) -> tuple[list[float], list[float], str]:
    """Return times [s], the robots' mean distance from where they should be then [m], and the run's fingerprint."""
    times, errors = [], []
    with Fleet(CONFIG, lockstep=True, seed=seed, out=False, settings=["tracker.source=truth"]) as fleet:
        x, y, psi = fleet.poses.T
        first, centre = fleet.points @ [1, 1j], x + 1j * y + 1j * V / OMEGA * np.exp(1j * psi)
        for t in fleet.ticks(seconds):
            wanted = centre + (first - centre) * np.exp(1j * OMEGA * t)
            off = wanted - fleet.points @ [1, 1j]
            if feedback:
                velocity = 1j * OMEGA * (wanted - centre) + K * off
                fleet.move(np.column_stack([velocity.real, velocity.imag]))
            else:
                fleet.drive([[V, OMEGA]] * len(fleet.robots))
            times.append(t)
            errors.append(float(abs(off).mean()))
    return times, errors, fleet.summary["trace_hash"]


def plot(seeds: range, seconds: float, file: Path) -> None:
    """Draw the distances of all trials over time, and print the last ones."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="time [s]", ylabel="mean distance from the place [mm]", yscale="log")
    for feedback, colour, name in [(False, "tab:red", "without feedback"), (True, "tab:blue", "with feedback")]:
        runs = [trial(seed, feedback, seconds) for seed in seeds]
        times, errors = runs[0][0], 1e3 * np.array([errors for _, errors, _ in runs])
        axes.plot(times, errors.T, color=colour, alpha=0.3, linewidth=0.8)
        axes.plot(times, np.median(errors, axis=0), color=colour, linewidth=2, label=f"{name}, median")
        worst = errors[:, -1].max()
        print(f"{name}: after {times[-1]:.0f} s {np.median(errors[:, -1]):.1f} mm, at worst {worst:.1f} mm")
    axes.legend()
    figure.savefig(file)


if __name__ == "__main__":
    plot(range(10), 20.0, Path("ten-seeds.svg"))
