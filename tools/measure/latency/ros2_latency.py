"""How long a command of a ROS 2 node takes to the wheels, in real time.

    python -m tools.measure.latency.ros2_latency [--seconds 30] [--set KEY=VALUE ...]

A run with simulated robots, the gateway and a user's node, each in processes of their own. The node answers each pose
of its robot, then it commands whenever it likes, every 30 ms. The time counts from the call of ``publish`` to the
wheels. A command that a newer one overtakes before the controller's tick reaches no wheel and does not count.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.core.arrays import Array
from robofleet.core.clock import MS
from robofleet.recording.reading import read
from robofleet.recording.run import Run
from tests.gateways.ros2.user import speed
from tests.runs.realrun import RealRun
from tools.measure.program import program

CONFIG = Path(__file__).parents[3] / "configs" / "ros2.yaml"


def latencies(run: Run, sent: list[int]) -> Array:
    """Return from command to tick, from tick to wheel, and both (3, K) [ms], of the commands that reached a wheel."""
    radius = slices.drive(load_config(CONFIG).robot("r1")).wheel_radius
    stamps, commanded_m_s = run.ticks["stamp_ns"], run.items["left_rad_s"][:, 0] * radius
    numbers = np.round((commanded_m_s - speed(0)) / (speed(1) - speed(0))).astype(int)
    numbers[commanded_m_s <= 0.0] = -1
    applied = np.unique(run.statuses[0]["applied_ns"])
    found = []
    first, last = np.searchsorted(stamps, (sent[0], sent[-1]))
    for k in range(max(1, int(first)), int(last)):
        number, tick = int(numbers[k]), int(stamps[k])
        if 0 <= number < len(sent) and numbers[k - 1] != number and tick > sent[number]:
            at_ns = int(applied[np.searchsorted(applied, tick)])  # later ones are the same command once more
            found.append((tick - sent[number], at_ns - tick, at_ns - sent[number]))
    return np.array(found).T / MS


def main() -> None:
    parser = program(__doc__, seconds=30.0)
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    overrides = [word for setting in given.settings for word in ("--set", setting)]
    with tempfile.TemporaryDirectory() as folder:
        run = RealRun(Path(folder), *overrides, config=CONFIG)
        environment = run.environment | {
            "ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": folder,
        }  # fmt: skip
        gateway = None
        try:
            run.wait_until_running()
            gateway = subprocess.Popen([sys.executable, "-m", "robofleet", "ros2", "ros2"], env=environment)
            node = [sys.executable, "-m", "tests.gateways.ros2.user", "count", str(given.seconds)]
            sent = {
                how: json.loads(
                    subprocess.run([*node, how], env=environment, stdout=subprocess.PIPE, check=True).stdout
                )
                for how in ("answering", "free")
            }
            recorded = Run(read(run.folder))
        finally:
            run.launcher.kill()
            if gateway is not None:
                gateway.wait()
            run.clean_up()
    load = os.getloadavg()[0]
    for how, commands in sent.items():
        for name, values in zip(("to tick", "to wheel", "whole"), latencies(recorded, commands), strict=True):
            p50, p99 = np.percentile(values, (50, 99))
            print(f"{how:9} {name:8} p50 {p50:6.2f}, p99 {p99:6.2f}, worst {values.max():6.2f} ms of {len(values)}")
    print(f"load {load:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
