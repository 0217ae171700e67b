"""How long an emergency stop takes: from the request to a target of zero, and to the robot's word that it is latched.

    python -m tests.processes.estop --times 100

A run of the shipped platoon in real time, without pixels. Each time the fleet drives, a client of the bus asks for the
emergency stop as `robofleet stop` does, then resets and starts it again. ``issued``: from the issue of the newest nonce
that the gate had accepted to a target of zero, on the driver's own clock (RobotStatus.target_after_ns): it counts the
age of the supervisor's enable too. ``asked``: from the request to the arrival of the first status that shows a latched
gate, on the client's clock: it counts the status's period of 20 ms too. The target was zero before either.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from robofleet.clock import MS, S, WallClock
from robofleet.comms.endpoint import bind_endpoint
from robofleet.comms.keys import STATE, STATUS
from robofleet.comms.messages import ROBOT_STATUS, RUN_STATE
from robofleet.comms.requests import asked
from robofleet.comms.zenoh_bus import ZenohBus
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.tree import Config
from robofleet.processes.estop import emergency_stop
from robofleet.processes.fleet import Fleet
from robofleet.safety.supervisor import Phase
from tests.processes.realrun import PLATOON

_CLOCK = WallClock()
_LATER_NS = 60 * MS  # until the statuses that tell of the stop are here
_DRIVES_NS = S  # between the start and the stop


class Tries:
    """A fleet that is started, stopped and started again."""

    def __init__(self, config: Config) -> None:
        self._arena, self._robots = config.arena.name, config.groups[0].robots
        self.bus = ZenohBus(self._arena, config.bus.endpoint, "estop", _CLOCK)
        self._state = self.bus.newest(STATE)
        self._statuses = [self.bus.newest(STATUS, robot) for robot in self._robots]

    def once(self) -> tuple[list[float], list[float]]:
        """Start the fleet and stop it; returns (issued, asked) of every robot [ms]."""
        self._ask(b"reset")
        self._ask(b"start")
        self._wait_running()
        _CLOCK.sleep_until(_CLOCK.now_ns() + _DRIVES_NS)
        stopped = emergency_stop(self.bus, _CLOCK, self._arena, self._robots)
        assert not stopped.silent, stopped.describe()
        _CLOCK.sleep_until(_CLOCK.now_ns() + _LATER_NS)
        newest = [ROBOT_STATUS.decode(statuses.take() or b"") for statuses in self._statuses]
        assert all(status is not None and status.latch for status in newest)
        return [status.target_after_ns / MS for status in newest if status], list(stopped.after_ms.values())

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


def measure(folder: Path, times: int) -> tuple[list[float], list[float]]:
    """Return (issued, asked) of every robot and time [ms]."""
    endpoint = bind_endpoint("tcp/127.0.0.1:0")
    config = load_config(PLATOON, ["tracker.source=truth", f"bus.endpoint={endpoint}"])
    (folder / "config.yaml").write_text(resolved_yaml(config))
    fleet = Fleet(folder, folder / "config.yaml")
    issued: list[float] = []
    asked_ms: list[float] = []
    try:
        fleet.start("router", "router")
        fleet.wait_ready(_CLOCK, lambda: None)
        for name in ("supervisor", "tracker", "controller"):
            fleet.start(name, name)
        for robot in config.platoon:
            fleet.start(f"driver-{robot.id}", "driver", "--robots", robot.id)
        fleet.wait_ready(_CLOCK, lambda: None)
        tries = Tries(config)
        try:
            for k in range(times):
                one, two = tries.once()
                issued += one
                asked_ms += two
                print(f"{k + 1:4d}: {max(one):5.1f} {max(two):5.1f} ms", file=sys.stderr)
        finally:
            tries.bus.close()
    finally:
        fleet.reap(_CLOCK)
    return issued, asked_ms


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=100)
    times = parser.parse_args().times
    with tempfile.TemporaryDirectory() as folder:
        for name, found in zip(("issued", "asked"), measure(Path(folder), times), strict=True):
            p50, p99 = np.percentile(found, (50, 99))
            print(f"{name:<7} p50 {p50:5.1f}  p99 {p99:5.1f}  worst {max(found):5.1f} ms, {len(found)} stops")


if __name__ == "__main__":
    main()
