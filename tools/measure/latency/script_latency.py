"""How long a script's wish takes to the wheels, in real time, stage by stage.

    python -m tools.measure.latency.script_latency [--seconds 30] [--camera]

A run of its own with simulated robots, whose script drives at every tick. The stages: from the call of ``drive`` to the
controller's next tick, and from that tick to the wheels of each robot. The age of the images is not counted.
"""

import argparse
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet
from robofleet.core.clock import MS, WallClock
from robofleet.recording.reading import read
from robofleet.recording.run import Run

CONFIG = Path(__file__).parents[3] / "configs" / "script.yaml"
CLOCK = WallClock()


class Stages(NamedTuple):
    """Of each wish that came to some wheel first [ms]."""

    tick: NDArray[np.float64]  # from the tick whose poses the script read to the call of ``drive``
    waits: NDArray[np.float64]  # from there to the controller's next tick
    wheel: NDArray[np.float64]  # from that tick to the wheels
    whole: NDArray[np.float64]  # from the call of ``drive`` to the wheels


def measure(seconds: float, folder: Path, *settings: str) -> Stages:
    """Return the stages of a run."""
    sent: dict[int, int] = {}
    with Fleet(CONFIG, out=folder, settings=settings) as fleet:
        for k, _ in enumerate(fleet.ticks(seconds)):
            sent[fleet._seq + 1] = CLOCK.now_ns()
            fleet.drive(np.tile([0.03, 0.4 * (-1) ** (k % 2)], (4, 1)))
    run = Run(read(folder))
    stamps = run.ticks["stamp_ns"]
    wished = run.group_figures[0].figures["wish"][:, 0]
    found = []
    for status in run.statuses:
        applied = np.unique(status["applied_ns"][status["applied_ns"] > stamps[0]])
        for at_ns in applied.tolist():
            k = int(np.searchsorted(stamps, at_ns, side="right")) - 1
            seq = int(wished[k]) if np.isfinite(wished[k]) else 0
            if seq in sent and (k == 0 or wished[k - 1] != seq):
                since, tick = sent[seq], int(stamps[k])
                found.append((since - int(stamps[k - 1]), tick - since, at_ns - tick, at_ns - since))
    return Stages(*(np.array(found).T / MS))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--camera", action="store_true", help="with images, not with the truth")
    given = parser.parse_args()
    settings = [] if given.camera else ["tracker.source=truth"]
    with tempfile.TemporaryDirectory() as folder:
        stages = measure(given.seconds, Path(folder) / "run", *settings)
    for name, values in stages._asdict().items():
        p50, p99 = np.percentile(values, (50, 99))
        print(f"{name:6} p50 {p50:6.2f}, p99 {p99:6.2f}, worst {values.max():6.2f} ms of {len(values)}")


if __name__ == "__main__":
    main()
