"""How long a command takes from the bus to the bytes on the serial line.

    python -m tools.measure.latency.serial_latency [--driver gternal|arduino_bridge|create2] [--seconds 60]

A real driver process on a real bus, commanded every 33 ms. The figure is the time from the moment when the command is
given to the bus to the moment when its bytes are read at the other end of a pseudo-terminal, by the clock of the one
process that does both: both ends' wakings are in it.
"""

import tempfile
from bisect import bisect_left
from itertools import cycle
from pathlib import Path

import numpy as np

from robofleet.core.clock import MS
from robofleet.safety.latches import GateStatus
from robofleet.vehicles.interface import WheelSpeeds
from tools.measure.program import program
from tools.measure.runs.serialstand import MOTION, commanded, ticks

_WHEELS = WheelSpeeds(2.0, 2.5), WheelSpeeds(2.1, 2.4)  # in turn: what is no news need not be said
_SETTLED = 20  # commands until it drives


def measure(driver: str, seconds: float, folder: Path) -> list[float]:
    """Return the times of all commands [ms]."""
    with commanded(driver, folder) as (commander, far, _):
        sent = list[int]()
        wheels = cycle(_WHEELS)
        ticks(seconds, lambda: sent.append(commander.command(next(wheels))))
        assert commander.look().gate == GateStatus.OPEN, commander.status
    came = far.commanded_ns
    return [(came[bisect_left(came, at_ns)] - at_ns) / MS for at_ns in sent[_SETTLED:-1]]


def main() -> None:
    parser = program(__doc__, seconds=60.0)
    parser.add_argument("--driver", choices=MOTION, default="gternal")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = measure(given.driver, given.seconds, Path(folder))
    p50, p99 = np.percentile(found, (50, 99))
    print(f"{given.driver}: p50 {p50:.2f}, p99 {p99:.2f}, worst {max(found):.2f} ms of {len(found)} commands")


if __name__ == "__main__":
    main()
