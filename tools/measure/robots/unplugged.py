"""Pull a robot's serial line out of a running fleet, plug it in again, and start once more.

    python -m tools.measure.robots.unplugged [--robots r1,r2,r3] [--seconds 8] [CONFIG]

Real processes without a launcher, so that nothing ends them. When the robot stands is its twin's word; when its status
says that it cannot be reached, and what the supervisor names, is what the bus brought.
"""

import math
import os
import tempfile
from pathlib import Path

from robofleet.bus.arena_file import twin_port
from robofleet.bus.bus import Inbox
from robofleet.bus.keys import TRUTH
from robofleet.core.clock import MS, S
from robofleet.recording.causes import run_cause
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.interface import RobotFault
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.runs.realrun import own_folders
from tools.measure.fleet import CLOCK, Fleet, configured, wait
from tools.measure.program import program
from tools.measure.robots.noisy_lines import SERIAL

_DRIVEN_S = 3.0
_STANDS_M_S, _STANDS_RAD_S = 1e-3, 1e-2


class Pulled(Fleet):
    """A fleet, one of whose lines is pulled out some seconds after it first ran."""

    def __init__(self, config_file: Path, robot: str, seconds: float, folder: Path) -> None:
        fault = f"{{kind: unplugged, robot: {robot}, at_s: {_DRIVEN_S}, duration_s: {seconds}}}"
        super().__init__(folder, configured(f"faults=[{fault}]", file=config_file))
        self.port, self._robot = twin_port(self.config.arena.name, robot), robot
        self._truths = Inbox(self.bus.newest(TRUTH, robot), TRUTH_LAYOUT.decode)
        self.pulled_ns = self.stood_ns = self.told_ns = math.inf
        self.cause = ""

    def listen(self) -> None:
        """Take what came, and note when what happened for the first time after the line was pulled out."""
        now_ns = CLOCK.now_ns()
        super().listen()
        status, truth = self.statuses.get(self._robot), self._truths.take()
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
        self.listen()
        return None if self.state is None else self.state.phase


def pull(config_file: Path, robot: str, seconds: float, folder: Path) -> str:
    fleet = Pulled(config_file, robot, seconds, folder)
    try:
        fleet.drive()
        wait(lambda: fleet.phase() == Phase.FAULT, _DRIVEN_S + 2.0, "a fault")
        wait(lambda: fleet.phase() is not None and fleet.port.is_symlink(), seconds + 1.0, "the line's return")
        fleet.drive()
        again_ns = CLOCK.now_ns() + round(_DRIVEN_S * S)
        wait(lambda: fleet.phase() != Phase.RUNNING or CLOCK.now_ns() > again_ns, _DRIVEN_S + 1.0, "the way on")
        again = "runs again" if fleet.phase() == Phase.RUNNING else "did not run again"
    finally:
        fleet.close()
    told_ms, stood_ms = ((at_ns - fleet.pulled_ns) / MS for at_ns in (fleet.told_ns, fleet.stood_ns))
    return f"{robot}: status after {told_ms:.0f} ms, stands after {stood_ms:.0f} ms, {again}; cause: {fleet.cause}"


def main() -> None:
    parser = program(__doc__, robots="r1,r2,r3", seconds=(8.0, "for which the line is out"))
    parser.add_argument("config", nargs="?", type=Path, default=SERIAL, metavar="CONFIG")
    asked_for = parser.parse_args()
    for robot in asked_for.robots.split(","):
        with tempfile.TemporaryDirectory() as folder:
            os.environ.update(own_folders(Path(folder)))
            print(pull(asked_for.config, robot, asked_for.seconds, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
