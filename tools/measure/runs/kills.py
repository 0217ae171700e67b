"""Kill -9 and SIGSTOP the processes of a running fleet, one by one, and read how long its wheels went on.

    python -m tools.measure.runs.kills --times 25
    python -m tools.measure.runs.kills --times 20 --config configs/go-to.yaml --config configs/two-groups.yaml

Without ``--config`` the fleet has no launcher, and what was killed is started again. With it each strike is a run of
its own, of that configuration: a line tells also what was left over, and what was missing in its report.

Real processes over Zenoh. The times are the drivers' own (``RobotStatus``): from the issue of the newest nonce that
their last command and their last permission echoed, to a target of zero and to an output of zero.
"""

import argparse
import os
import signal
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from robofleet.bus.bus import Inbox
from robofleet.bus.keys import STATE, STATUS
from robofleet.bus.messages import RUN_STATE, RunState
from robofleet.bus.requests import asked
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, WallClock
from robofleet.safety.supervisor import Phase
from tests.bus.alone import ROBOT_STATUS, RobotStatus
from tests.endpoints import own_endpoint
from tools.measure.runs import struck_runs
from tools.measure.runs.unlaunched import started, wait_ready

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
ROBOTS = ("r1", "r2")
VICTIMS = ("controller", "router", "supervisor", "tracker")
TARGET_MS, OUTPUT_MS = 130.0, 230.0
_WITHIN_S = 40.0
_HELD_S = 0.7  # shorter than half a second is a hiccup: the fleet drives on by itself
CLOCK = WallClock()


def wait(condition: Callable[[], Any], within_s: float, what: str) -> None:
    """Return as soon as the condition holds; AssertionError after a while."""
    deadline_ns = CLOCK.now_ns() + round(within_s * S)
    while not condition():
        assert CLOCK.now_ns() < deadline_ns, f"waited {within_s} s for {what}"
        CLOCK.sleep_until(CLOCK.now_ns() + 2 * MS)


class Fleet:
    """The processes of a run without a launcher: whoever kills one starts it again."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        endpoint = own_endpoint()
        robots = f"groups.0.robots=[{', '.join(ROBOTS)}]"
        config = load_config(
            PLATOON, ["drivers.robots_per_process=1", robots, f"bus.endpoint={endpoint}", "tracker.source=truth"]
        )
        self.config = config.model_copy(update={"robots": tuple(config.robot(robot) for robot in ROBOTS)})
        self._children = started(self.config, folder, CLOCK)
        self.bus = ZenohBus(config.arena.name, endpoint, "kills", CLOCK)
        self._state = Inbox(self.bus.newest(STATE), RUN_STATE.decode)
        self._inboxes = {robot: Inbox(self.bus.newest(STATUS, robot), ROBOT_STATUS.decode) for robot in ROBOTS}
        self.state: RunState | None = None
        self.statuses: dict[str, RobotStatus] = {}

    def start(self, name: str) -> None:
        """Start a process that was killed, or was not there yet, and wait until it does its work."""
        if any(child.name == name for child in self._children.children):
            self._children.start_again(name)
        else:
            self._children.start(name, name)
        wait_ready(self._children, CLOCK)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal; a killed process is gone when this returns."""
        if number == signal.SIGKILL:
            self._children.kill(name)
        else:
            self._children.signal(name, number)

    def listen(self) -> None:
        """Take what came."""
        self.state = self._state.take() or self.state
        for robot, inbox in self._inboxes.items():
            if (status := inbox.take()) is not None:
                self.statuses[robot] = status

    def ask(self, request: bytes) -> bytes:
        """Ask the supervisor."""
        return asked(self.bus, CLOCK, "supervisor", request)

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
        """End every process."""
        self._children.reap(CLOCK)
        self.bus.close()


def turns(status: RobotStatus) -> bool:
    """Whether the gate lets anything through to a wheel."""
    return bool(status.left_output_rad_s or status.right_output_rad_s)


def strike(
    fleet: Fleet, victim: str, number: signal.Signals, rng: np.random.Generator, held_s: float
) -> list[tuple[float, float]]:
    """Kill or stop a process of a running fleet; return each robot's times to zero target and output [ms].

    AssertionError if a wheel turns after the process is back, before somebody starts a run.
    """
    fleet.drive()
    CLOCK.sleep_until(CLOCK.now_ns() + round(rng.uniform(0.2, 0.6) * S))
    before = {robot: status.nonce for robot, status in fleet.statuses.items()}
    fleet.signal(victim, number)
    CLOCK.sleep_until(CLOCK.now_ns() + round(held_s * S))
    if number == signal.SIGKILL:
        fleet.start(victim)
    else:
        fleet.signal(victim, signal.SIGCONT)
    after_ns = {robot: nonce + round(held_s * S) for robot, nonce in before.items()}
    fleet.until(lambda: all(fleet.statuses[r].nonce > ns for r, ns in after_ns.items()), "news of the drivers")
    fleet.until(fleet.at_rest, "rest")
    angles = {robot: status.left_angle_rad for robot, status in fleet.statuses.items()}
    still_ns = CLOCK.now_ns() + S // 2
    while CLOCK.now_ns() < still_ns:
        fleet.listen()
        assert fleet.at_rest(), f"{victim}: a wheel turns again: {fleet.statuses}"
        CLOCK.sleep_until(CLOCK.now_ns() + 5 * MS)
    for robot, status in fleet.statuses.items():
        assert abs(status.left_angle_rad - angles[robot]) < 0.5, f"{victim}: {robot}'s wheel was turned"
    return [(s.target_after_ns / MS, s.output_after_ns / MS) for s in fleet.statuses.values()]


def main() -> None:
    """Strike every victim so many times; exit 1 if a wheel went on for too long."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=25, help="of each process")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--config", type=Path, action="append", default=[], help="of whole runs; again for more")
    parser.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=VALUE", help="of these runs"
    )
    parser.add_argument("--only", action="append", default=[], help="processes to strike; default: each")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    if arguments.config:
        good = [runs(config, arguments.settings, arguments.only, arguments.times, rng) for config in arguments.config]
        raise SystemExit(not all(good))
    worst: dict[str, list[tuple[float, float]]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder
        fleet = Fleet(Path(folder))
        try:
            for k in range(arguments.times):
                for victim in VICTIMS:
                    number = (signal.SIGKILL, signal.SIGSTOP)[int(rng.integers(2))]
                    worst[victim] += strike(fleet, victim, number, rng, float(rng.uniform(_HELD_S, 3.0)))
                print(f"{k + 1} of {arguments.times}", file=sys.stderr)
        finally:
            fleet.close()
    print(f"{'struck':<12}{'times':>6}{'to zero target, ms':>22}{'to zero output, ms':>22}")
    for victim, times in worst.items():
        target, output = np.array(times).T
        print(f"{victim:<12}{len(times) // len(ROBOTS):>6}{_shown(target):>22}{_shown(output):>22}")
    figures = np.array([time for times in worst.values() for time in times])
    if (figures > (TARGET_MS, OUTPUT_MS)).any():
        raise SystemExit(1)


def runs(config: Path, settings: list[str], only: list[str], times: int, rng: np.random.Generator) -> bool:
    """Strike each process of a configuration's runs so many times, killed and frozen; returns whether all was well."""
    print(
        f"{config.name:<24}{'times':>6}{'to zero target, ms':>22}{'to zero output, ms':>22}  left, missing", flush=True
    )
    good = True
    for victim in struck_runs.victims(config, settings):
        if only and victim.name not in only:
            continue
        for number in (signal.SIGKILL, signal.SIGSTOP):
            struck = [struck_runs.strike(config, settings, victim, number, rng) for _ in range(times)]
            target = np.array([ms for strike in struck for ms in strike.target_ms])
            output = np.array([ms for strike in struck for ms in strike.output_ms])
            wrong = Counter(what for strike in struck for what in strike.wrong)
            good = good and not wrong and not (target > TARGET_MS).any() and not (output > OUTPUT_MS).any()
            name = f"{victim.name} {'killed' if number == signal.SIGKILL else 'frozen'}"
            wrongs = ", ".join(f"{count} x {what}" for what, count in wrong.items()) or "nothing"
            print(f"{name:<24}{times:>6}{_shown(target):>22}{_shown(output):>22}  {wrongs}", flush=True)
    return good


def _shown(values: np.ndarray) -> str:
    if not len(values):
        return "-"
    return f"{np.median(values):.0f} (worst {values.max():.0f})"


if __name__ == "__main__":
    main()
