"""Configurations, lockstep runs, and a bench: one process alone on a bus without delay."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.bus import keys, messages
from robofleet.bus.bus import MemoryBus, Wake
from robofleet.bus.keys import Topic, key
from robofleet.config.load import load_config
from robofleet.config.slices import drawn_id
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.core.compiling import on_stderr
from robofleet.nodes.node import Node
from robofleet.nodes.unit.driver import LOOP_NS, DriverProcess
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.nodes.unit.state_store import MemoryStateStore
from robofleet.runs import table
from robofleet.safety.gate import LeaseAction
from robofleet.safety.supervisor import Phase
from robofleet.simulation.faults import Schedule
from robofleet.testing import FakeDriver, run_lockstep
from robofleet.vehicles.interface import WheelSpeeds
from tests.bus import alone as of_one
from tests.runs.realrun import RealRun
from tests.shipped import PLATOON

ONE_BY_ONE = "drivers.robots_per_process=1"
LAYOUTS: dict[Topic, Any] = {
    keys.COMMAND: of_one.WHEEL_COMMAND,
    keys.STATUS: of_one.ROBOT_STATUS,
    keys.ENABLE: of_one.ENABLE,
    keys.STATE: messages.RUN_STATE,
    keys.BUSY: messages.BUSY_MACHINE,
    keys.TRUTH: of_one.TRUTH,
    keys.POSES: messages.FLEET_POSES,
    keys.TICK: messages.TICK_RECORD,
    keys.NEWS: messages.TRACKER_NEWS,
    keys.RECORDER: messages.RECORDER_STATUS,
    keys.PICTURE: messages.PICTURE,
}


@pytest.fixture(scope="session")
def platoon_of() -> Callable[..., Config]:
    """Return the shipped platoon with keys changed; each robot has a driver process, as robots that exist have."""
    return lambda *overrides: load_config(PLATOON, [ONE_BY_ONE, *overrides])


@pytest.fixture(scope="session")
def lockstep() -> Callable[..., dict[str, Any]]:
    """Return the summary of a lockstep run of the shipped platoon with keys changed."""

    return lambda *overrides: dict(run_lockstep(load_config(PLATOON, overrides)).summary)


@pytest.fixture(scope="session")
def truth(lockstep: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """Return the summary of a lockstep run without pixels."""
    return lambda *overrides: lockstep("tracker.source=truth", *overrides)


class Bench:
    """A process alone: what the others would say is said by the test, what it says is kept."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.clock = SimulatedClock()
        self.clock.advance_to(S)  # 0 means "never" in many fields
        self.bus = MemoryBus(config.arena.name, self.clock, 0)
        self.woken: list[int] = []
        self._messages: list[tuple[str, bytes]] = []
        self.bus.tap(self._messages.append)

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns()

    def made(self, row: table.Row, wake: Wake = lambda _: None, faults: Schedule | None = None) -> Node:
        """Put a process together as a real run does, on this bench."""
        assert row.make is not None
        rng, state_store = np.random.default_rng(1), MemoryStateStore()
        return row.make(
            table.Edges(
                self.config, self.bus, self.clock, wake, rng, state_store, on_stderr(), faults=faults, real_time=True
            )
        )

    def wait(self, ns: int) -> None:
        self.clock.advance_to(self.now_ns + ns)

    def say(self, topic: Topic, message: Any, name: str = "") -> None:
        """Say it on a topic; ``name``: of a robot, which is alone in its unit, where units speak or listen."""
        self.bus.publisher(topic, name)(LAYOUTS[topic].encode(message))

    def heard(self, topic: Topic, name: str = "") -> list[Any]:
        """Return every message of a topic so far; ``name``: of a robot, where units speak or listen."""
        layout, unit = LAYOUTS[topic], self.config.unit_of.get(name, name)
        full = key(self.config.arena.name, topic, unit)
        payloads = [payload for full_key, payload in self._messages if full_key == full]
        if not isinstance(layout, of_one.Alone):
            return [layout.decode(payload) for payload in payloads]
        row = self.config.units[unit].index(name)
        return [layout.of(payload, row) for payload in payloads]

    def run(self, node: Node, ns: int, *others: tuple[int, Callable[[], None]]) -> None:
        """Step a process whenever it asks to be, and after every act of ``others``: (period [ns], act)."""
        end_ns = self.now_ns + ns
        due = [self.now_ns for _ in others]
        next_ns = node.step(self.now_ns)
        while (instant_ns := min([next_ns, *due])) <= end_ns:
            self.clock.advance_to(max(instant_ns, self.now_ns))
            for k, (period_ns, act) in enumerate(others):
                if due[k] <= self.now_ns:
                    act()
                    due[k] += period_ns
            next_ns = node.step(self.now_ns)
            assert next_ns > self.now_ns, "a step asked for a step in the past"
        self.clock.advance_to(end_ns)


@pytest.fixture(scope="session")
def bench_of() -> Callable[[Config], Bench]:
    return Bench


@pytest.fixture
def fake_driver() -> Iterator[type[FakeDriver]]:
    """Return the class of fake drivers."""
    FakeDriver.reset()
    yield FakeDriver
    FakeDriver.reset()


@pytest.fixture(scope="session")
def recorded() -> Callable[..., list[str]]:
    """Return what gives robots of the platoon fake drivers, in one unit: config changes."""
    driver = "driver='robofleet.testing:FakeDriver'"
    return lambda *rows: [
        change for row in rows for change in (f"robots.{row}.{driver}", f"robots.{row}.unit=r{rows[0] + 1}")
    ]


@pytest.fixture(scope="session")
def driver_of() -> Callable[..., DriverProcess]:
    """Return what starts a driver process on a bench, for the robots of a unit."""

    def start(bench: Bench, *robots: str, seed: int = 1, **keys: Any) -> DriverProcess:
        drivers = ConfiguredDrivers(bench.config, bench.clock.now_ns)
        keys = {"wake": lambda _: None, "state_store": MemoryStateStore(), "drivers": drivers, **keys}
        unit = bench.config.unit_of[robots[0]]
        assert bench.config.units[unit] == robots
        rng = np.random.default_rng(seed)
        drawn = {"boot_id": drawn_id(rng, 64), "phase_ns": int(rng.integers(LOOP_NS))}
        return DriverProcess(bench.config, unit, bench.bus, bench.clock, **drawn, **keys)

    return start


FORWARD = WheelSpeeds(3.0, 4.0)


class Stand:
    """A driver process on a bench, a controller that holds its leases, a supervisor: each can be silenced."""

    SESSION = 99

    def __init__(self, bench: Bench, node: DriverProcess, made: dict[str, FakeDriver]) -> None:
        self.bench, self.node, self.made = bench, node, made
        self.seen: dict[str, int] = {}  # nonce that the newest command echoed
        self._seq = 0
        self._limits: dict[str, float] = {}  # that robots are permitted

    def newest(self, robot: str) -> Any:
        statuses = self.bench.heard(keys.STATUS, robot)
        return statuses[-1] if statuses else None

    def ask(self, robot: str, action: LeaseAction = LeaseAction.ACQUIRE, session: int = SESSION) -> Any:
        """Ask for a robot's unit; returns the answer for the robot, or None if there was none."""
        unit, row = self._place(robot)
        answer = self.bench.bus.ask(
            keys.LEASE, unit, messages.LEASE_REQUEST.encode(messages.LeaseRequest(session, action))
        )
        self.node.step(self.bench.now_ns)
        payload = answer.take()
        return None if payload is None else of_one.LEASE_ANSWER.of(payload, row)

    def acquire(self, robot: str) -> None:
        assert self.ask(robot).granted == 1
        self.bench.run(self.node, 25 * MS)  # a status tells the epoch

    def command(self, *robots: str, wheels: WheelSpeeds = FORWARD, exposure_ns: int = 77, age: int = 1) -> None:
        """Command robots of a unit as the controller does, and say nothing to its others; ``age`` 2 echoes the status
        before the newest."""
        unit, _ = self._place(robots[0])
        newest_of = {robot: self.bench.heard(keys.STATUS, robot)[-age:] for robot in self.bench.config.units[unit]}
        if statuses := newest_of[robots[0]]:
            self._seq += 1
            status = statuses[0]
            self.seen.update(dict.fromkeys(robots, status.nonce))
            head = messages.UnitCommand(self._seq, self.SESSION, status.boot_id, status.nonce, exposure_ns, ())
            nothing = messages.WheelCommand(0, 0.0, 0.0)
            commands = [
                messages.WheelCommand(newest_of[r][0].epoch, *wheels) if r in robots else nothing for r in newest_of
            ]
            self.bench.bus.publisher(keys.COMMAND, unit)(
                messages.UNIT_COMMAND.encode(head._replace(robots=tuple(commands)))
            )

    def enable(self, *robots: str, limit: float = 12.5, latch: int = 0, clear: int = 0) -> None:
        """Say what the supervisor says of robots of a unit; of its others it says what it said before."""
        unit, _ = self._place(robots[0])
        if (status := self.newest(robots[0])) is not None:
            self._seq += 1
            epochs = {robot: self.newest(robot).epoch for robot in self.bench.config.units[unit]}
            for robot in robots:
                self._limits[robot] = 0.0 if latch else limit
            permissions = tuple(
                messages.Enable(epoch, latch, clear, limit)
                if robot in robots
                else messages.Enable(epoch, 0, 0, self._limits.get(robot, 0.0))
                for robot, epoch in epochs.items()
            )
            permission = messages.UnitEnable(self._seq, status.boot_id, status.nonce, Phase.RUNNING, permissions)
            self.bench.bus.publisher(keys.ENABLE, unit)(messages.UNIT_ENABLE.encode(permission))

    def _place(self, robot: str) -> tuple[str, int]:
        """Return the robot's unit, and its place there."""
        unit = self.bench.config.unit_of[robot]
        return unit, self.bench.config.units[unit].index(robot)

    def run(self, ns: int, *, commands: bool = True, enables: bool = True, robot: str = "r1") -> None:
        """Let a robot drive."""
        if robot not in self.seen:
            self.seen[robot] = 0
            self.acquire(robot)
        others = []
        if commands:
            others.append((33 * MS, lambda: self.command(robot)))
        if enables:
            others.append((40 * MS, lambda: self.enable(robot)))
        self.bench.run(self.node, ns, *others)


@pytest.fixture
def stand(
    platoon_of: Callable[..., Config],
    recorded: Callable[..., list[str]],
    fake_driver: type[FakeDriver],
    driver_of: Callable[..., DriverProcess],
) -> Iterator[Stand]:
    """Return two robots of one driver process, r1 and r2."""
    bench = Bench(platoon_of(*recorded(0, 1)))
    node = driver_of(bench, "r1", "r2")
    yield Stand(bench, node, fake_driver.instances)
    with suppress(ExceptionGroup):  # of robots that a test broke; nobody seeks them any more
        node.close()


@pytest.fixture
def disk_of(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Return what mounts a small disk of its own, for example of ``256k``."""
    disk = tmp_path / "disk"

    def mount(size: str) -> Path:
        disk.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("only root may mount a disk that fills up")
        return disk

    yield mount
    if disk.is_mount():
        subprocess.run(["umount", "--lazy", disk], check=True)


@pytest.fixture
def real_run(alone: None, tmp_path: Path) -> Iterator[Callable[..., RealRun]]:
    """Return what starts a run with real processes; nothing of it is left afterwards."""
    runs: list[RealRun] = []

    def start(*arguments: str, **how: Any) -> RealRun:
        runs.append(RealRun(tmp_path, *arguments, **how))
        return runs[-1]

    yield start
    for run in runs:
        run.clean_up()
