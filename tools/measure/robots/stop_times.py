"""How long and how far each kind of robot drives on at full speed, after what should stop it.

    python -m tools.measure.robots.stop_times

Simulated time: the driver process with its gate, the driver, a twin of the robot's firmware, wheels that are alike and
do not slip. Times count from the event; of messages that cease, from the newest number that they echoed. They end when
the robot is slower than 1 mm/s. A dead man's process is taken to be as slow as ``dead_man_figures`` found it at worst.
The worst of eight moments between two commands.
"""

import math
import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest.mock import patch

from robofleet.bus.bus import MemoryBus
from robofleet.config.troubles import LineFault
from robofleet.core.clock import MS, S
from robofleet.drivers.dead_man import SILENT_S, DeadMan
from robofleet.drivers.dead_man_process import AGAIN_S
from robofleet.nodes.unit.driver import DriverProcess
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.nodes.unit.state_store import MemoryStateStore
from robofleet.safety.latches import Latch
from robofleet.testing import DriverBench, DriverSubject
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.readings import TruePose
from tests.process_fixtures import Bench, Stand
from tools.measure.program import program

SUBJECTS = {
    "simulated": DriverSubject("simulated", twin=None),
    "gternal": DriverSubject("gternal", twin="gternal", encoders=False),
    "arduino_bridge": DriverSubject(
        "arduino_bridge", twin="arduino_bridge", vehicle="arduino", settings={"counts_per_turn": 2248}
    ),
    "rfp": DriverSubject("rfp", twin="rfp", vehicle="rfp", settings={"counts_per_turn": 2248}),
    "create2": DriverSubject("create2", twin="create2", vehicle="create2"),
}
EVENTS = {
    "latched": "its gate is latched",
    "silent": "commands and permissions cease",
    "killed": "its driver process is killed",
    "frozen": "its driver process is frozen",
    "gone": "its computer dies",
    "cut": "its computer dies in the middle of a line",
}
_DEAD_MAN_S = {"killed": 0.007, "frozen": SILENT_S}
_SETTLE_NS, _LONGEST_MS = S, 4000
_STANDS_M_S, _STANDS_NS = 1e-3, S // 10
_TICK_NS, _PERMISSION_NS, _MOMENTS = 33 * MS, 40 * MS, 8


class Stop(NamedTuple):
    """Until the robot stands."""

    seconds: float
    metres: float


NEVER = Stop(math.inf, math.inf)


class _Road(Bench):
    """A driver process alone, whose robot moves while time passes."""

    def __init__(self, robot: DriverBench) -> None:
        self._robot, self.config, self.clock = robot, robot.config, robot.clock
        self.bus = MemoryBus(self.config.arena.name, self.clock, 0)
        self._messages: list[tuple[str, bytes]] = []
        self.bus.tap(self._messages.append)

    def run(self, node: Any, ns: int, *others: tuple[int, Callable[[], None]]) -> None:
        due = [self.now_ns for _ in others]

        def step(now_ns: int) -> int:
            for k, (period_ns, act) in enumerate(others):
                if due[k] <= now_ns:
                    act()
                    due[k] += period_ns
            return min([int(node.step(now_ns)), *due])

        self._robot.run(step, ns / S)


class _Robot:
    """A robot at full speed, straight on."""

    def __init__(self, bench: DriverBench, dead_men: list[tuple[int, bytes]]) -> None:
        self.bench, self.road, self._dead_men = bench, _Road(bench), dead_men
        drivers = ConfiguredDrivers(bench.config, bench.clock.now_ns)
        self.process = DriverProcess(
            bench.config, "r1", self.road.bus, bench.clock, lambda _: None, 77, 0, MemoryStateStore(), drivers
        )
        if bench.twin is None:
            bench.driver = SimpleNamespace(truth=self._truth)
        self.stand = Stand(self.road, self.process, {})
        drive = bench.believed
        wheel = min(drive.max_wheel_speed, drive.max_speed / drive.wheel_radius)
        self._wheels, self._limit, self._radius = WheelSpeeds(wheel, wheel), drive.max_wheel_speed, drive.wheel_radius
        self.stand.acquire("r1")

    def _truth(self) -> TruePose:
        truths = self.process._robots.truths()
        assert truths is not None
        return TruePose(*truths[0].item()[1:])

    def drive(self, ns: int) -> None:
        command = partial(self.stand.command, "r1", wheels=self._wheels)
        enable = partial(self.stand.enable, "r1", limit=self._limit)
        self.road.run(self.process, ns, (_TICK_NS, command), (_PERMISSION_NS, enable))

    def stop(self, event: str) -> Stop:
        """Let something happen, and time it."""
        if event == "cut":
            self.bench.strike()
            self.drive(_TICK_NS)
        began_ns, before = self.bench.now_ns, self.bench.angles.left
        if event == "latched":
            self.stand.enable("r1", latch=Latch.EMERGENCY_STOP)
        if event == "silent":
            before -= self._wheels.left * (began_ns - self.stand.seen["r1"]) / S
            began_ns = self.stand.seen["r1"]
        stop_s = _DEAD_MAN_S.get(event, math.inf)
        stood_ns = None
        for k in range(_LONGEST_MS):
            last = self.bench.angles.left
            if k * 1e-3 >= stop_s:
                stop_s += AGAIN_S
                for descriptor, stop in self._dead_men:
                    os.write(descriptor, stop)
            if event in ("latched", "silent"):
                self.road.run(self.process, MS)
            else:
                self.bench.let_pass(1e-3)
            moves = abs(self.bench.angles.left - last) * self._radius > _STANDS_M_S * 1e-3
            stood_ns = None if moves else stood_ns or self.bench.now_ns
            if stood_ns is not None and self.bench.now_ns - stood_ns > _STANDS_NS:
                return Stop((stood_ns - began_ns) / S, (self.bench.angles.left - before) * self._radius)
        return NEVER


def measure(subject: DriverSubject, event: str, moment: float = 0.0) -> Stop:
    """Return how a robot stops; ``moment``: of the event, as a share of the time between two commands."""
    faults = [LineFault(kind="line_cut", robot="r1", share=1.0, at_s=0.0)] if event == "cut" else []
    dead_men: list[tuple[int, bytes]] = []
    begin = DeadMan.__init__

    def noted(dead_man: DeadMan, descriptor: int, stop: bytes) -> None:
        dead_men.append((descriptor, stop))
        begin(dead_man, descriptor, stop)

    with patch.object(DeadMan, "__init__", noted), DriverBench(subject, *faults) as bench:
        robot = _Robot(bench, dead_men)
        try:
            robot.drive(_SETTLE_NS + round(moment * _TICK_NS))
            return robot.stop(event)
        finally:
            with suppress(ExceptionGroup):
                robot.process.close()


def worst(subject: DriverSubject, event: str) -> Stop:
    """Return the longest time and the longest way."""
    stops = [measure(subject, event, k / _MOMENTS) for k in range(_MOMENTS)]
    return Stop(*map(max, zip(*stops, strict=True)))


def main() -> None:
    program(__doc__).parse_args()
    for kind, subject in SUBJECTS.items():
        for event, words in EVENTS.items():
            seconds, metres = worst(subject, event)
            print(f"{kind}: {words}: {1000 * seconds:.0f} ms, {1000 * metres:.0f} mm", flush=True)


if __name__ == "__main__":
    main()
