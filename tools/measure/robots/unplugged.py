"""Pull a robot's serial line out of a running fleet, plug it in again, and start once more.

    python -m tools.measure.robots.unplugged [--robots r1,r2,r3] [--seconds 8] [CONFIG]

Real processes without a launcher, so that nothing ends them. When the robot stands is its twin's word; when its status
says that it cannot be reached, and what the supervisor names, is what the bus brought.
"""

import argparse
import math
import os
import tempfile
from pathlib import Path

from robofleet.bus.arena_file import twin_port
from robofleet.bus.bus import Inbox
from robofleet.bus.keys import STATE, STATUS, TRUTH
from robofleet.bus.messages import RUN_STATE, RunState
from robofleet.bus.requests import asked
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, WallClock
from robofleet.recording.causes import run_cause
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.interface import RobotFault
from tests.bus.alone import ROBOT_STATUS
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.endpoints import own_endpoint
from tests.runs.realrun import own_folders
from tools.measure.robots.noisy_lines import SERIAL
from tools.measure.runs.kills import wait
from tools.measure.runs.unlaunched import started

CLOCK = WallClock()
_DRIVEN_S = 3.0
_STANDS_M_S, _STANDS_RAD_S = 1e-3, 1e-2
_START_WITHIN_S = 60.0


class Pulled:
    """A fleet, one of whose lines is pulled out some seconds after it first ran."""

    def __init__(self, config_file: Path, robot: str, seconds: float, folder: Path) -> None:
        fault = f"{{kind: unplugged, robot: {robot}, at_s: {_DRIVEN_S}, duration_s: {seconds}}}"
        endpoint = own_endpoint()
        self.config = load_config(
            config_file, ["drivers.robots_per_process=1", f"bus.endpoint={endpoint}", f"faults=[{fault}]"]
        )
        self.port = twin_port(self.config.arena.name, robot)
        self._children = started(self.config, folder, CLOCK)
        self.bus = ZenohBus(self.config.arena.name, endpoint, "unplugged", CLOCK)
        self._states = Inbox(self.bus.newest(STATE), RUN_STATE.decode)
        self._statuses = Inbox(self.bus.newest(STATUS, robot), ROBOT_STATUS.decode)
        self._truths = Inbox(self.bus.newest(TRUTH, robot), TRUTH_LAYOUT.decode)
        self.state: RunState | None = None
        self.pulled_ns = self.stood_ns = self.told_ns = math.inf
        self.cause = ""

    def listen(self) -> None:
        """Take what came, and note when what happened for the first time after the line was pulled out."""
        now_ns = CLOCK.now_ns()
        self.state = self._states.take() or self.state
        status, truth = self._statuses.take(), self._truths.take()
        if not self.port.is_symlink():
            self.pulled_ns = min(self.pulled_ns, now_ns)
        if math.isinf(self.pulled_ns):
            return
        if status is not None and status.faults & RobotFault.UNREACHABLE:
            self.told_ns = min(self.told_ns, now_ns)
        if truth is not None and abs(truth.v_m_s) < _STANDS_M_S and abs(truth.omega_rad_s) < _STANDS_RAD_S:
            self.stood_ns = min(self.stood_ns, truth.stamp_ns)
        if self.state is not None and self.state.phase == Phase.FAULT:
            self.cause = self.cause or run_cause(self.state, self.config.groups[0].robots)

    def phase(self) -> int | None:
        """Listen, and return the fleet's phase."""
        self.listen()
        return None if self.state is None else self.state.phase

    def run(self) -> None:
        """Reset what is to be reset, start, and wait until the fleet runs."""

        def runs() -> bool:
            phase = self.phase()
            if phase in (Phase.IDLE, Phase.FAULT):
                asked(self.bus, CLOCK, "supervisor", b"start" if phase == Phase.IDLE else b"reset", self.listen)
            return phase == Phase.RUNNING

        wait(runs, _START_WITHIN_S, f"a run; {self.state}")

    def close(self) -> None:
        """End every process."""
        self._children.reap(CLOCK)
        self.bus.close()


def pull(config_file: Path, robot: str, seconds: float, folder: Path) -> str:
    """Return what happened, in a line."""
    fleet = Pulled(config_file, robot, seconds, folder)
    try:
        fleet.run()
        wait(lambda: fleet.phase() == Phase.FAULT, _DRIVEN_S + 2.0, "a fault")
        wait(lambda: fleet.phase() is not None and fleet.port.is_symlink(), seconds + 1.0, "the line's return")
        fleet.run()
        again_ns = CLOCK.now_ns() + round(_DRIVEN_S * S)
        wait(lambda: fleet.phase() != Phase.RUNNING or CLOCK.now_ns() > again_ns, _DRIVEN_S + 1.0, "the way on")
        again = "runs again" if fleet.phase() == Phase.RUNNING else "did not run again"
    finally:
        fleet.close()
    told_ms, stood_ms = ((at_ns - fleet.pulled_ns) / MS for at_ns in (fleet.told_ns, fleet.stood_ns))
    return f"{robot}: status after {told_ms:.0f} ms, stands after {stood_ms:.0f} ms, {again}; cause: {fleet.cause}"


def main() -> None:
    """Pull out each robot's line once."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", nargs="?", type=Path, default=SERIAL, metavar="CONFIG")
    parser.add_argument("--robots", default="r1,r2,r3")
    parser.add_argument("--seconds", type=float, default=8.0, help="for which the line is out")
    asked_for = parser.parse_args()
    for robot in asked_for.robots.split(","):
        with tempfile.TemporaryDirectory() as folder:
            os.environ.update(own_folders(Path(folder)))
            print(pull(asked_for.config, robot, asked_for.seconds, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
