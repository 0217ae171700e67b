"""How long an emergency stop takes, from the request to the robot's word that its target is zero.

    python -m tools.measure.latency.estop --times 100 [--supervisor frozen|killed|flooded]
    python -m tools.measure.latency.estop --cpu --times 20

A run of the shipped platoon in real time, without pixels. Each time the fleet drives, a client of the bus asks for the
emergency stop as `robofleet stop` does, then resets and starts it again, which takes about ten seconds. The figure is
the time from its request to the first status that shows a latched gate, by the status's own stamp: one host, one clock.
The target is zero then, and has been for up to the status's period of 20 ms. The supervisor can be stopped (SIGSTOP) or
killed just before the request, or two clients flood it with theirs; afterwards it goes on, or is started again.

``--cpu``: what `robofleet stop` itself takes until its request is out: seconds of the processors, modules, files.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from robofleet.bus.keys import REQUEST, STATUS, key
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.core.clock import MS, S
from robofleet.operator.estop import emergency_stop, urgent
from tests.bus.alone import ROBOT_STATUS
from tests.operator.asked_run import asked_run, until_asked
from tests.runs.realrun import own_folders
from tools.measure.fleet import CLOCK, Fleet, configured
from tools.measure.program import program

_DRIVES_NS = S  # between the start and the stop
_TROUBLED_NS = 50 * MS  # before the stop
_FLOODERS = 2
TROUBLES = ("frozen", "killed", "flooded")


class Tries:
    """A fleet that is started, stopped and started again; ``trouble`` is its supervisor's at each stop."""

    def __init__(self, fleet: Fleet, trouble: str | None) -> None:
        self._config, self._fleet, self._trouble = fleet.config, fleet, trouble
        self._arena, self._units = fleet.config.arena.name, fleet.config.units
        with urgent():  # its threads, as those of `robofleet stop`
            self.bus = ZenohBus(self._arena, fleet.config.bus.endpoint, "estop", CLOCK)

    def once(self) -> list[float]:
        """Start the fleet and stop it; returns the time of every robot [ms]."""
        self._fleet.drive()
        CLOCK.sleep_until(CLOCK.now_ns() + _DRIVES_NS)
        statuses = self.bus.stream(key(self._arena, STATUS, "*"), capacity=4096)
        with self._troubled():
            asked_ns = CLOCK.now_ns()
            with urgent():
                stopped = emergency_stop(self.bus, CLOCK, self._units)
        assert not stopped.silent, stopped.describe()
        after_ms: dict[str, float] = {}
        for _, full, payload in statuses.drain():
            status = ROBOT_STATUS.decode(payload)
            if status is not None and status.latch:
                after_ms.setdefault(full, (status.stamp_ns - asked_ns) / MS)
        assert len(after_ms) == len(self._units)
        return list(after_ms.values())

    @contextmanager
    def _troubled(self) -> Iterator[None]:
        """Bring the supervisor its trouble, for as long as a stop takes."""
        flooders: list[subprocess.Popen[bytes]] = []
        if self._trouble == "frozen":
            self._fleet.signal("supervisor", signal.SIGSTOP)
        elif self._trouble == "killed":
            self._fleet.signal("supervisor", signal.SIGKILL)
        elif self._trouble == "flooded":
            flood = "--flood", self._config.bus.endpoint, self._arena
            command = [sys.executable, "-m", "tools.measure.latency.estop", *flood]
            flooders = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(_FLOODERS)]
            for flooder in flooders:
                assert flooder.stdout is not None
                flooder.stdout.readline()
        try:
            CLOCK.sleep_until(CLOCK.now_ns() + _TROUBLED_NS)
            yield
        finally:
            for flooder in flooders:
                flooder.kill()
                flooder.wait()
            if self._trouble == "frozen":
                self._fleet.signal("supervisor", signal.SIGCONT)
            elif self._trouble == "killed":
                self._fleet.start("supervisor")


def flood(endpoint: str, arena: str) -> None:
    """Ask a supervisor for something as fast as a process can, until this one is killed."""
    bus = ZenohBus(arena, endpoint, "flooder", CLOCK)
    print("ready", flush=True)
    while True:
        bus.ask(REQUEST, "supervisor", b"status")


def measure(folder: Path, times: int, trouble: str | None = None) -> list[float]:
    """Return the time of every robot and try [ms]."""
    fleet = Fleet(folder, configured("tracker.source=truth"))
    found: list[float] = []
    try:
        tries = Tries(fleet, trouble)
        try:
            for k in range(times):
                attempt = tries.once()
                found += attempt
                print(f"{k + 1:4d}: {max(attempt):5.1f} ms", file=sys.stderr)
        finally:
            tries.bus.close()
    finally:
        fleet.close()
    return found


def print_cost(folder: Path, times: int) -> None:
    """Print what the command takes until it asks."""
    environment = own_folders(folder)
    with asked_run(environment):
        asking = [until_asked(["stop"], environment) for _ in range(times)]
    cpu_s = [attempt.cpu_s for attempt in asking]
    print(
        f"robofleet stop, until it asks: p50 {np.median(cpu_s):.3f} s of the processors, worst {max(cpu_s):.3f} s; ",
        end="",
    )
    print(f"{len(asking[0].modules)} modules, {len(asking[0].opened)} files")


def main() -> None:
    parser = program(__doc__, times=100, cpu=False)
    parser.add_argument("--supervisor", choices=TROUBLES)
    parser.add_argument("--flood", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.flood is not None:
        flood(*arguments.flood)
    times, trouble = arguments.times, arguments.supervisor
    with tempfile.TemporaryDirectory() as folder:
        if arguments.cpu:
            print_cost(Path(folder), times)
            return
        found = measure(Path(folder), times, trouble)
    p50, p99 = np.percentile(found, (50, 99))
    print(f"supervisor {trouble or 'well'}: ", end="")
    print(f"p50 {p50:.1f}, p99 {p99:.1f}, worst {max(found):.1f} ms of {times} stops of {len(found) // times} robots")


if __name__ == "__main__":
    main()
