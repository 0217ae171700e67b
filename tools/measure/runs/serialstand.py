"""A real driver process that is commanded over a real bus; its robot is a firmware at the end of a pseudo-terminal.

The pseudo-terminal has no baud rate: what is measured is the software, not the line.
"""

import json
import os
import select
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import yaml

from robofleet.bus.keys import COMMAND, ENABLE, LEASE, STATUS
from robofleet.bus.messages import LEASE_REQUEST, LeaseRequest
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config import slices
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.core.plugins import load
from robofleet.nodes.node import ahead_of_others
from robofleet.runs.children import Children
from robofleet.safety.gate import LeaseAction
from robofleet.safety.supervisor import Phase
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.serial_line import SerialLine
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.bus.alone import ENABLE as ENABLE_LAYOUT
from tests.bus.alone import LEASE_ANSWER, ROBOT_STATUS, WHEEL_COMMAND, Enable, RobotStatus, WheelCommand
from tests.endpoints import own_endpoint
from tests.runs.realrun import own_folders
from tests.shipped import PLATOON

CLOCK = WallClock()
TICK_NS = 33 * MS
MOTION = {"gternal": b'"v"', "arduino_bridge": b"m ", "create2": b"\x91"}  # what only a motion command has in it
_VEHICLES = {"arduino_bridge": "arduino"}
_SETTINGS: dict[str, dict[str, Any]] = {"arduino_bridge": {"counts_per_turn": 2248}}
_PRIORITY = 30  # above every process of a run: a robot's own electronics wait for nobody
_SESSION = 7


class FarEnd(threading.Thread):
    """The robot: a firmware that answers, and when each motion command came [ns]."""

    def __init__(self, config: Config, driver: str, port: Path) -> None:
        super().__init__(daemon=True)
        s = slices.simulation(config, config.robots[0], None)
        self._period_ns = round(s.imperfections.loop_period * S)
        self._plant = Plant(s.drive, s.imperfections, s.start, s.rng, now_ns=CLOCK.now_ns())
        self._hardware = Hardware(s.drive, s.imperfections, self._plant)
        self._firmware = load("robofleet.twins", driver)(self._hardware)
        self._motion = MOTION[driver]
        self._line = SerialLine(port)
        self.commanded_ns: list[int] = []
        self.ended = threading.Event()

    def run(self) -> None:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        loop_ns, was_open = CLOCK.now_ns(), False
        while not self.ended.is_set():
            wait_s = max(0.0, (loop_ns - CLOCK.now_ns()) / S)
            readable = self._line.descriptor
            select.select([] if readable is None else [readable], [], [], min(0.01, wait_s))
            data, now_ns = self._line.read(), CLOCK.now_ns()
            if self._motion in data:
                self.commanded_ns.append(now_ns)
            if self._line.open and not was_open:
                self._firmware.opened(now_ns)
            was_open = self._line.open
            answer = self._firmware.receive(data, now_ns) if data else b""
            if now_ns >= loop_ns:
                loop_ns = now_ns + self._period_ns
                answer += self._firmware.loop(now_ns)
                self._plant.write(self._hardware.command)
                self._plant.advance(now_ns)
            self._line.write(answer)
        self._line.unplug()


class Commander:
    """What a controller and a supervisor say to one robot."""

    def __init__(self, config: Config, bus: ZenohBus) -> None:
        self._bus, self._seq = bus, 0
        self._statuses = bus.newest(STATUS, "r1")
        self._command, self._enable = bus.publisher(COMMAND, "r1"), bus.publisher(ENABLE, "r1")
        self._limit = config.robots[0].vehicle.max_wheel_speed_rad_s
        self.status: RobotStatus | None = None

    def acquire(self) -> None:
        """Take the robot's lease."""
        request = LEASE_REQUEST.encode(LeaseRequest(_SESSION, LeaseAction.TAKE_OVER))
        answer = self._bus.ask(LEASE, "r1", request)
        while (payload := answer.take()) is None:
            CLOCK.sleep_until(CLOCK.now_ns() + MS)
        granted = LEASE_ANSWER.decode(payload)
        assert granted is not None
        assert granted.granted

    def look(self) -> RobotStatus:
        """Return the newest status."""
        while (payload := self._statuses.take()) is not None or self.status is None:
            self.status = self.status if payload is None else ROBOT_STATUS.decode(payload)
        return self.status

    def command(self, wheels: WheelSpeeds) -> int:
        """Permit and command it; returns when the command was given to the bus [ns]."""
        status = self.look()
        self._seq += 1
        echo = status.boot_id, status.nonce
        self._enable(ENABLE_LAYOUT.encode(Enable(status.epoch, self._seq, *echo, Phase.RUNNING, 0, 0, self._limit)))
        CLOCK.sleep_until(CLOCK.now_ns() + MS)
        at_ns = CLOCK.now_ns()
        self._command(WHEEL_COMMAND.encode(WheelCommand(status.epoch, self._seq, _SESSION, *echo, 0, *wheels)))
        return at_ns


@contextmanager
def commanded(driver: str, folder: Path) -> Iterator[tuple[Commander, FarEnd, int]]:
    """Give a robot to command, its far end, and its driver process's id."""
    vehicle = _VEHICLES.get(driver, driver)
    port = folder / "r1.tty"
    robot = yaml.safe_load(PLATOON.read_text())["robots"][0]
    robot |= {"driver": driver, "vehicle": vehicle, "settings": {"port": str(port), **_SETTINGS.get(driver, {})}}
    endpoint = own_endpoint()
    keys = f"robots={json.dumps([robot])}", 'groups.0.robots=["r1"]', f"bus.endpoint={endpoint}"
    config = load_config(PLATOON, keys)
    (folder / "config.yaml").write_text(resolved_yaml(config))
    fleet = Children(folder, folder / "config.yaml")
    ahead_of_others()
    with ExitStack() as stack:
        stack.enter_context(patch.dict(os.environ, own_folders(folder)))
        far = FarEnd(config, driver, port)
        far.start()
        stack.callback(far.join)
        stack.callback(far.ended.set)
        stack.callback(fleet.reap, CLOCK)
        fleet.start("router", "router")
        fleet.wait_ready(CLOCK, lambda: None)
        child = fleet.start("driver-r1", "driver", "--robots", "r1")
        fleet.wait_ready(CLOCK, lambda: None)
        bus = ZenohBus(config.arena.name, endpoint, "commander", CLOCK)
        stack.callback(bus.close)
        commander = Commander(config, bus)
        commander.look()
        commander.acquire()
        CLOCK.sleep_until(CLOCK.now_ns() + S // 10)
        yield commander, far, child.process.pid


def ticks(seconds: float, act: Callable[[], Any]) -> None:
    """Do something every 33 ms."""
    at_ns, end_ns = CLOCK.now_ns(), CLOCK.now_ns() + round(seconds * S)
    while at_ns < end_ns:
        act()
        at_ns += TICK_NS
        CLOCK.sleep_until(at_ns)
