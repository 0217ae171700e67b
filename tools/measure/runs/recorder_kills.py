"""Kill -9 the recorder of a running fleet, mend what it left, and compare that with what another listener heard.

    python -m tools.measure.runs.recorder_kills --runs 50

Real processes over Zenoh. Each time the recorder records into a folder of its own, for up to three seconds, and is
killed. Everything that the listener had 0.25 s before the kill must be in the mended file, in the same order, and other
readers must find the file whole.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.reader import make_reader

from robofleet.bus.bus import Arrival, Stream
from robofleet.core.clock import MS, S
from robofleet.recording.channels import keys as recorded_keys
from robofleet.recording.log import FILE
from robofleet.recording.reading import read
from tools.measure.fleet import CLOCK, Fleet, pair
from tools.measure.program import program

LOST_MS = 250.0
_STREAM = 1 << 17
_SETTLED_NS = 50 * MS  # after it said that it is ready
_ON_ITS_WAY_NS = 300 * MS  # what was said before the kill is heard by then


class Outcome(NamedTuple):
    messages: int  # messages until the kill
    lost: int  # of these
    lost_ms: float  # how long before the kill the oldest of them was heard
    repaired: str  # what `robofleet repair` said


def strike(fleet: Fleet, stream: Stream, folder: Path, rng: np.random.Generator) -> Outcome:
    """Record, kill, mend and compare; AssertionError if the file is not whole or messages are out of order."""
    fleet.start("recorder")
    fleet.drive()
    CLOCK.sleep_until(CLOCK.now_ns() + _SETTLED_NS)
    stream.drain()
    began_ns = CLOCK.now_ns()
    CLOCK.sleep_until(began_ns + round(rng.uniform(0.0, 3.0) * S))
    killed_ns = CLOCK.now_ns()
    fleet.signal("recorder", signal.SIGKILL)
    CLOCK.sleep_until(killed_ns + _ON_ITS_WAY_NS)
    arrivals = stream.drain()
    assert not stream.dropped
    run = folder / "run"
    run.mkdir()
    (folder / FILE).rename(run / FILE)
    command = [sys.executable, "-m", "robofleet", "repair", str(run)]
    mended = subprocess.run(command, capture_output=True, text=True, check=True)
    lost = [arrival for arrival in missing(run, arrivals) if arrival.at_ns < killed_ns]
    shutil.rmtree(run)
    oldest_ms = (killed_ns - min(arrival.at_ns for arrival in lost)) / MS if lost else 0.0
    heard_before = sum(arrival.at_ns < killed_ns for arrival in arrivals)
    return Outcome(heard_before, len(lost), oldest_ms, mended.stdout.splitlines()[0])


def missing(run: Path, arrivals: list[Arrival]) -> list[Arrival]:
    """Return what was heard and is not in a mended file."""
    recording = read(run)
    assert recording.whole, recording.trouble
    with (run / FILE).open("rb") as file:
        index = make_reader(file).get_summary()
        assert index is not None
        assert index.statistics is not None
        assert index.statistics.message_count == sum(1 for _ in make_reader(file).iter_messages())
    said_on: dict[str, list[Arrival]] = defaultdict(list)
    for arrival in arrivals:
        said_on[arrival.key].append(arrival)
    lost = []
    for full, payloads in said_on.items():
        places = {payload: where for where, payload in recording.placed(full)}  # every message has a number
        found = [places.get(arrival.payload) for arrival in payloads]
        order = [where for where in found if where is not None]
        assert order == sorted(order), f"{full}: another order than what was said"
        lost += [arrival for arrival, where in zip(payloads, found, strict=True) if where is None]
    return lost


def main() -> None:
    """Kill so many recorders; exit 1 if one lost more than it may."""
    arguments = program(__doc__, runs=50, seed=1).parse_args()
    rng = np.random.default_rng(arguments.seed)
    outcomes = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["XDG_STATE_HOME"] = name
        fleet = Fleet(folder, pair())
        stream = fleet.bus.stream(*recorded_keys(fleet.config), capacity=_STREAM)
        try:
            for k in range(arguments.runs):
                outcomes.append(strike(fleet, stream, folder, rng))
                print(f"{k + 1} of {arguments.runs}: {outcomes[-1]}", file=sys.stderr)
        finally:
            fleet.close()
    worst = max(outcome.lost_ms for outcome in outcomes)
    count, lost = sum(outcome.messages for outcome in outcomes), sum(outcome.lost for outcome in outcomes)
    print(f"{len(outcomes)} recorders killed, {len(outcomes)} files mended; {lost} of {count} messages lost")
    print(f"the oldest lost one was heard {worst:.0f} ms before the kill (at most {LOST_MS:.0f})")
    if worst > LOST_MS:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
