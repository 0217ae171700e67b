"""A closed gate stops a robot for good, and a stopped robot is in the summary."""

from collections.abc import Callable
from typing import Any

import numpy as np

from robofleet.clock import MS, S
from robofleet.comms.keys import COMMAND, ENABLE, STATUS
from robofleet.comms.messages import Enable, WheelCommand
from robofleet.processes.driver import DriverProcess
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.interface import STOP

Make = Callable[..., Any]


def test_the_stop_is_repeated_while_the_gate_is_closed(
    bench_of: Make, platoon_of: Make, recorded: Make, recording_driver: Any
) -> None:
    bench = bench_of(platoon_of(*recorded(0)))
    node = DriverProcess(bench.config, ("r1",), bench.bus, bench.clock, lambda _: None, np.random.default_rng(1))
    bench.run(node, S // 10)
    seen = bench.heard(STATUS, "r1")[-1]
    bench.say(COMMAND, WheelCommand(1, 1, seen.boot_id, seen.nonce, 0, 3.0, 3.0), "r1")
    bench.say(ENABLE, Enable(1, 1, seen.boot_id, seen.nonce, Phase.RUNNING), "r1")
    bench.run(node, 50 * MS)
    driver = recording_driver.made["r1"]
    assert driver.target != STOP
    bench.run(node, 250 * MS)  # nobody says anything any more
    stops = [at for at, wheels in driver.writes if wheels == STOP and at > seen.nonce + 120 * MS]
    assert len(stops) >= 10
    assert max(np.diff(stops)) <= 10 * MS


def test_a_robot_that_is_not_seen_is_listed_as_stopped(truth: Make) -> None:
    figures = truth("run.duration_s=3", "camera.trigger=free", "camera.rate_hz=1", "controller.filter.lost_after_s=0.3")
    assert {stop["robot"] for stop in figures["stops"]} == {"r1", "r2", "r3", "r4"}
    assert {stop["cause"] for stop in figures["stops"]} == {"not seen by the tracker"}
