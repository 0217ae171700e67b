"""What a driver process costs its computer: its share of a core at 100 Hz while it is commanded, and its memory.

    python -m tools.measure.runs.driver_cost [--driver gternal|arduino_bridge|create2] [--seconds 20]

The memory is what is resident in the end; of the dead man's process, where there is one, it is said apart.
"""

import tempfile
from pathlib import Path

import psutil

from robofleet.core.clock import S
from robofleet.safety.latches import GateStatus
from robofleet.vehicles.interface import WheelSpeeds
from tools.measure.program import program
from tools.measure.runs.serialstand import CLOCK, MOTION, commanded, ticks

_WHEELS = WheelSpeeds(2.0, 2.5)
_SETTLED_S = 2.0
_MB = 1e6


def measure(driver: str, seconds: float, folder: Path) -> tuple[float, float, list[float]]:
    """Return the share of a core, the memory [MB], and that of each process that it has started."""
    with commanded(driver, folder) as (commander, _, pid):
        process = psutil.Process(pid)
        ticks(_SETTLED_S, lambda: commander.command(_WHEELS))
        began, began_ns = process.cpu_times(), CLOCK.now_ns()
        ticks(seconds, lambda: commander.command(_WHEELS))
        ended, ended_ns = process.cpu_times(), CLOCK.now_ns()
        assert commander.look().gate == GateStatus.OPEN, commander.status
        used_s = ended.user + ended.system - began.user - began.system
        children = [child.memory_info().rss / _MB for child in process.children()]
        return used_s * S / (ended_ns - began_ns), process.memory_info().rss / _MB, children


def main() -> None:
    parser = program(__doc__, seconds=20.0)
    parser.add_argument("--driver", choices=MOTION, default="gternal")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        share, memory_mb, children = measure(given.driver, given.seconds, Path(folder))
    others = "".join(f", and {mb:.0f} MB of its dead man's process" for mb in children)
    print(f"{given.driver}: {share:.1%} of a core, {memory_mb:.0f} MB{others}")


if __name__ == "__main__":
    main()
