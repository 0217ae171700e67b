"""What the recorder costs the controller: lateness and computing time of its ticks with a recorder and without.

    python -m tools.measure.runs.recorder_cost --turns 6 --seconds 10

One running fleet, real processes over Zenoh, without pixels. The recorder is started and killed in turns, so that both
sides see the same machine. The spread over the turns of one side is the noise.
"""

import os
import signal
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Stream
from robofleet.bus.keys import TICK, key
from robofleet.bus.messages import TICK_RECORD
from robofleet.core.clock import MS, S
from robofleet.recording.log import FILE
from tools.measure.fleet import CLOCK, Fleet, pair
from tools.measure.program import program

_STREAM = 1 << 14
_SETTLED_NS = S  # after a process was started or killed
FIGURES = ("late, us", "computing, us")


def ticks(fleet: Fleet, stream: Stream, seconds: float) -> NDArray[np.float64]:
    """Return lateness and computing time of the ticks of some seconds (K, 2) [us]."""
    fleet.drive()
    CLOCK.sleep_until(CLOCK.now_ns() + _SETTLED_NS)
    return heard(stream, seconds)


def heard(stream: Stream, seconds: float) -> NDArray[np.float64]:
    """Return lateness and computing time of the ticks that come in some seconds (K, 2) [us]."""
    stream.drain()
    CLOCK.sleep_until(CLOCK.now_ns() + round(seconds * S))
    heads = [TICK_RECORD.decode_head(payload) for _, _, payload in stream.drain()]
    return np.array([(head.lateness_ns, head.compute_ns) for head in heads if head is not None]) * 1e3 / MS


def measured(fleet: Fleet, folder: Path, turns: int, seconds: float) -> dict[str, list[NDArray[np.float64]]]:
    """Return the ticks of every turn, without the recorder and with it."""
    stream = fleet.bus.stream(key(fleet.config.arena.name, TICK), capacity=_STREAM)
    found: dict[str, list[NDArray[np.float64]]] = {"without": [], "with": []}
    for _ in range(turns):
        found["without"].append(ticks(fleet, stream, seconds))
        fleet.start("recorder")
        found["with"].append(ticks(fleet, stream, seconds))
        fleet.signal("recorder", signal.SIGKILL)
        (folder / FILE).unlink()
    return found


def main() -> None:
    arguments = program(__doc__, turns=(6, "of each side"), seconds=(10.0, "of each turn")).parse_args()
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = name
        fleet = Fleet(Path(name), pair())
        try:
            found = measured(fleet, Path(name), arguments.turns, arguments.seconds)
        finally:
            fleet.close()
    print_table("recorder", found)


def print_table(title: str, found: dict[str, list[NDArray[np.float64]]]) -> None:
    """Print what was heard of ticks (K, 2) in each turn of each side."""
    print(f"{title:<10}{'of a tick':<16}{'p50':>8}{'p99':>8}{'max':>9}   p99 of each turn")
    for side, turns in found.items():
        for column, figure in enumerate(FIGURES):
            p50, p99, most = np.percentile(np.concatenate(turns)[:, column], (50, 99, 100))
            each = " ".join(f"{np.percentile(turn[:, column], 99):.0f}" for turn in turns)
            print(f"{side:<10}{figure:<16}{p50:>8.0f}{p99:>8.0f}{most:>9.0f}   {each}")


if __name__ == "__main__":
    main()
