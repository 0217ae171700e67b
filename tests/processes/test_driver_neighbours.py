"""Several robots in one driver process: none pays for another one's robot."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.clock import MS, S
from robofleet.comms.keys import COMMAND, ENABLE, STATUS
from robofleet.comms.messages import Enable, WheelCommand
from robofleet.processes.driver import DriverProcess
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.interface import STOP, WheelSpeeds

Make = Callable[..., Any]


def test_a_slow_robot_gives_its_neighbour_no_time(
    bench_of: Make, platoon_of: Make, recorded: Make, recording_driver: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = bench_of(platoon_of(*recorded(0, 1)))
    node = DriverProcess(bench.config, ("r1", "r2"), bench.bus, bench.clock, lambda _: None, np.random.default_rng(1))
    bench.run(node, S // 10)
    status = bench.heard(STATUS, "r2")[-1]
    monkeypatch.setattr(recording_driver.made["r1"], "write", lambda _: bench.wait(130 * MS))
    for name in ("r1", "r2"):
        seen = bench.heard(STATUS, name)[-1]
        bench.say(COMMAND, WheelCommand(1, 1, seen.boot_id, seen.nonce, 0, 3.0, 3.0), name)
        bench.say(ENABLE, Enable(1, 1, seen.boot_id, seen.nonce, Phase.RUNNING), name)
    node.step(bench.now_ns)
    assert bench.now_ns - status.nonce >= 130 * MS
    assert recording_driver.made["r2"].writes[-1][1] == STOP != WheelSpeeds(3.0, 3.0)


def test_a_robot_that_cannot_be_opened_leaves_none_open(
    bench_of: Make, platoon_of: Make, recorded: Make, recording_driver: Any
) -> None:
    bench = bench_of(platoon_of(*recorded(0), "robots.1.driver='builtins:open'"))
    with pytest.raises(TypeError):
        DriverProcess(bench.config, ("r1", "r2"), bench.bus, bench.clock, lambda _: None, np.random.default_rng(1))
    assert recording_driver.made["r1"].closed == 1
