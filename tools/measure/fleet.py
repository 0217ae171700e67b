"""Real processes of a run without a launcher, for the programs that kill, freeze, unplug and stop them."""

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robofleet.bus.bus import Inbox
from robofleet.bus.keys import STATE, STATUS
from robofleet.bus.messages import RUN_STATE, RunState
from robofleet.bus.requests import asked
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.runs import table
from robofleet.runs.children import Children
from robofleet.safety.supervisor import Phase
from tests.bus.alone import ROBOT_STATUS, RobotStatus
from tests.endpoints import own_endpoint
from tests.shipped import PLATOON

CLOCK = WallClock()
_WITHIN_S = 60.0


def wait(condition: Callable[[], Any], within_s: float, what: str) -> None:
    """Return as soon as the condition holds; AssertionError after a while."""
    deadline_ns = CLOCK.now_ns() + round(within_s * S)
    while not condition():
        assert CLOCK.now_ns() < deadline_ns, f"waited {within_s} s for {what}"
        CLOCK.sleep_until(CLOCK.now_ns() + 2 * MS)


def configured(*changes: str, file: Path = PLATOON) -> Config:
    """Return a configuration with a bus of its own, and a driver process for each robot."""
    return load_config(file, ["drivers.robots_per_process=1", f"bus.endpoint={own_endpoint()}", *changes])


def pair() -> Config:
    """Return two robots of the platoon, seen without pixels."""
    config = configured("groups.0.robots=[r1, r2]", "tracker.source=truth")
    return config.model_copy(update={"robots": (config.robot("r1"), config.robot("r2"))})


def started(config: Config, file: Path, log: Path) -> Children:
    """Start all processes but the recorder, and wait until each does its work; whoever asked for them reaps them."""
    children = Children(log, file)
    try:
        for first in (True, False):
            for process in table.processes(config):
                if process.row.first is first and process.row is not table.RECORDER:
                    children.start(process.name, *process.command)
            children.wait_ready(CLOCK, lambda: None)
    except BaseException:
        children.reap(CLOCK)
        raise
    return children


class Fleet:
    """The processes of a run without a launcher: whoever kills one starts it again."""

    def __init__(self, folder: Path, config: Config) -> None:
        self.config = config
        file = folder / "config.yaml"
        file.write_text(resolved_yaml(config))
        self._children = started(config, file, folder)
        self.bus = ZenohBus(config.arena.name, config.bus.endpoint, "measure", CLOCK)
        self._state = Inbox(self.bus.newest(STATE), RUN_STATE.decode)
        self._inboxes = {robot: Inbox(self.bus.newest(STATUS, robot), ROBOT_STATUS.decode) for robot in config.units}
        self.state: RunState | None = None
        self.statuses: dict[str, RobotStatus] = {}

    def start(self, name: str) -> None:
        """Start a process that was killed, or was not there yet, and wait until it does its work."""
        if any(child.name == name for child in self._children.children):
            self._children.start_again(name)
        else:
            self._children.start(name, name)
        self._children.wait_ready(CLOCK, lambda: None)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal; a killed process is gone when this returns."""
        if number == signal.SIGKILL:
            self._children.kill(name)
        else:
            self._children.signal(name, number)

    def listen(self) -> None:
        self.state = self._state.take() or self.state
        for robot, inbox in self._inboxes.items():
            if (status := inbox.take()) is not None:
                self.statuses[robot] = status

    def ask(self, request: bytes) -> bytes:
        return asked(self.bus, CLOCK, "supervisor", request, self.listen)

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Listen until something is true."""

        def holds() -> bool:
            self.listen()
            return bool(condition())

        wait(holds, _WITHIN_S, f"{what}; state {self.state}, {self.statuses}")

    def drive(self) -> None:
        """Bring the fleet to where every wheel turns."""

        def started() -> bool:
            if self.state is None or self.state.phase in (Phase.FAULT, Phase.ESTOP):
                self.ask(b"reset")
            elif self.state.phase == Phase.HOLD:
                self.ask(b"stop")
            elif self.state.phase == Phase.IDLE:
                self.ask(b"start")
            CLOCK.sleep_until(CLOCK.now_ns() + 50 * MS)
            return self.state is not None and self.state.phase == Phase.RUNNING

        self.until(started, "a run")
        self.until(lambda: all(turns(status) for status in self.statuses.values()), "turning wheels")

    def at_rest(self) -> bool:
        """Whether every gate is closed and every output zero."""
        return all(status.gate != 0 and not turns(status) for status in self.statuses.values())

    def close(self) -> None:
        self._children.reap(CLOCK)
        self.bus.close()


def turns(status: RobotStatus) -> bool:
    """Whether the gate lets anything through to a wheel."""
    return bool(status.left_output_rad_s or status.right_output_rad_s)
