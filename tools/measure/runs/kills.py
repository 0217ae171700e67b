"""Kill -9 and SIGSTOP the processes of a running fleet, one by one, and read how long its wheels went on.

    python -m tools.measure.runs.kills --times 25
    python -m tools.measure.runs.kills --times 20 --config configs/go-to.yaml --config configs/two-groups.yaml

Without ``--config`` the fleet has no launcher, and what was killed is started again. With it each strike is a run of
its own, of that configuration: a line tells also what was left over, and what was missing in its report.

Real processes over Zenoh. The times are the drivers' own (``RobotStatus``): from the issue of the newest nonce that
their last command and their last permission echoed, to a target of zero and to an output of zero.
"""

import os
import signal
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from robofleet.core.clock import MS, S
from tools.measure.fleet import CLOCK, Fleet, pair
from tools.measure.program import program
from tools.measure.runs import struck_runs

VICTIMS = ("controller", "router", "supervisor", "tracker")
TARGET_MS, OUTPUT_MS = 130.0, 230.0
_HELD_S = 0.7  # shorter than half a second is a hiccup: the fleet drives on by itself


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
    parser = program(__doc__, times=(25, "of each process"), seed=1)
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
        fleet = Fleet(Path(folder), pair())
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
        print(f"{victim:<12}{len(times) // len(fleet.statuses):>6}{_shown(target):>22}{_shown(output):>22}")
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
