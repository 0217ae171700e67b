"""How long an emergency stop takes, from the request to the robot's word that its target is zero.

    python -m tests.processes.estop --times 100

A run of the shipped platoon in real time, without pixels. Each time the fleet drives, a client of the bus asks for the
emergency stop as `robofleet stop` does, then resets and starts it again, which takes about ten seconds. The figure is
the time from its request to the first status that shows a latched gate, by the status's own stamp: one host, one clock.
The target is zero then, and has been for up to the status's period of 20 ms.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from robofleet.clock import MS, S, WallClock
from robofleet.comms.keys import STATE, STATUS, key
from robofleet.comms.messages import ROBOT_STATUS, RUN_STATE
from robofleet.comms.requests import asked
from robofleet.comms.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.processes.estop import emergency_stop
from robofleet.safety.supervisor import Phase
from tests.endpoints import own_endpoint
from tests.processes.realrun import PLATOON
from tests.processes.unlaunched import started

_CLOCK = WallClock()
_DRIVES_NS = S  # between the start and the stop


class Tries:
    """A fleet that is started, stopped and started again."""

    def __init__(self, config: Config) -> None:
        self._arena, self._robots = config.arena.name, config.groups[0].robots
        self.bus = ZenohBus(self._arena, config.bus.endpoint, "estop", _CLOCK)
        self._state = self.bus.newest(STATE)

    def once(self) -> list[float]:
        """Start the fleet and stop it; returns the time of every robot [ms]."""
        self._ask(b"reset")
        self._ask(b"start")
        self._wait_running()
        _CLOCK.sleep_until(_CLOCK.now_ns() + _DRIVES_NS)
        statuses = self.bus.stream(key(self._arena, STATUS, "*"), capacity=4096)
        asked_ns = _CLOCK.now_ns()
        stopped = emergency_stop(self.bus, _CLOCK, self._robots)
        assert not stopped.silent, stopped.describe()
        after_ms: dict[str, float] = {}
        for _, full, payload in statuses.drain():
            status = ROBOT_STATUS.decode(payload)
            if status is not None and status.latch:
                after_ms.setdefault(full, (status.stamp_ns - asked_ns) / MS)
        assert len(after_ms) == len(self._robots)
        return list(after_ms.values())

    def _ask(self, what: bytes) -> None:
        """Ask until it is done: robots come to rest, and a supervisor that has just started knows nobody."""
        deadline_ns = _CLOCK.now_ns() + 10 * S
        while not (answer := asked(self.bus, _CLOCK, "supervisor", what)).startswith(b"ok"):
            assert _CLOCK.now_ns() < deadline_ns, answer
            _CLOCK.sleep_until(_CLOCK.now_ns() + 50 * MS)

    def _wait_running(self) -> None:
        deadline_ns, state = _CLOCK.now_ns() + 60 * S, None
        while state is None or state.phase != Phase.RUNNING:
            payload = self._state.take()
            state = state if payload is None else RUN_STATE.decode(payload)
            assert _CLOCK.now_ns() < deadline_ns, state
            assert state is None or state.phase != Phase.FAULT, state
            _CLOCK.sleep_until(_CLOCK.now_ns() + 5 * MS)


def measure(folder: Path, times: int) -> list[float]:
    """Return the time of every robot and try [ms]."""
    endpoint = own_endpoint()
    config = load_config(PLATOON, ["tracker.source=truth", f"bus.endpoint={endpoint}"])
    fleet = started(config, folder, _CLOCK)
    found: list[float] = []
    try:
        tries = Tries(config)
        try:
            for k in range(times):
                one = tries.once()
                found += one
                print(f"{k + 1:4d}: {max(one):5.1f} ms", file=sys.stderr)
        finally:
            tries.bus.close()
    finally:
        fleet.reap(_CLOCK)
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=100)
    times = parser.parse_args().times
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), times)
    p50, p99 = np.percentile(found, (50, 99))
    print(f"p50 {p50:.1f}, p99 {p99:.1f}, worst {max(found):.1f} ms of {times} stops of {len(found) // times} robots")


if __name__ == "__main__":
    main()
