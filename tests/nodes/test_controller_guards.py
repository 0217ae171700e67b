"""What the controller must not believe: an image of the future, an unknown state."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, POSES, STATE, TICK
from robofleet.bus.messages import FleetPoses, RobotState, RunState, TagPose
from robofleet.core.clock import MS, S
from robofleet.nodes.controller import Controller
from robofleet.safety.supervisor import NOBODY, Phase

Make = Callable[..., Any]


def poses(tick: int, since_ns: int) -> FleetPoses:
    seen = tuple(TagPose(tag, 0, 0, 0.1 * tag, 0.0, 0.0) for tag in (1, 2, 3, 4))
    return FleetPoses(1, tick, 1, 0, 0, tick, since_ns, 0, 0, seen)


def test_an_image_of_the_future_does_not_blind_the_filter(bench_of: Make, platoon_of: Make) -> None:
    bench = bench_of(platoon_of())
    node = Controller(bench.config, bench.bus, bench.clock, np.random.default_rng(1))
    bench.run(node, S // 10)
    newest = bench.heard(TICK)[-1].tick
    bench.say(POSES, poses(newest, 10 * S), CAMERA)
    bench.run(node, S // 10)
    assert all(robot.lost for robot in bench.heard(TICK)[-1].robots)
    bench.say(POSES, poses(bench.heard(TICK)[-1].tick, 15 * MS), CAMERA)
    bench.run(node, S // 10)
    assert not any(robot.lost for robot in bench.heard(TICK)[-1].robots)


@pytest.mark.parametrize("phase", [99, Phase.POSITIONING, Phase.PARKING])
def test_a_state_that_this_run_cannot_be_in_is_dropped(bench_of: Make, platoon_of: Make, phase: int) -> None:
    """Nobody has a place to park, and all begin where they stand."""
    bench = bench_of(platoon_of())
    node = Controller(bench.config, bench.bus, bench.clock, np.random.default_rng(1))
    bench.say(STATE, RunState(1, 1, phase, 0, NOBODY, 0.0, 0, (RobotState(1, 1, 0),) * 4))
    bench.run(node, S // 10)
    assert bench.heard(TICK)[-1].phase == Phase.IDLE


def test_images_from_both_ends_of_time_are_used_for_nobody(bench_of: Make, platoon_of: Make) -> None:
    bench = bench_of(platoon_of())
    node = Controller(bench.config, bench.bus, bench.clock, np.random.default_rng(1))
    bench.run(node, S // 10)
    for since_ns in (2**63 - 1, -(2**63)):
        bench.say(POSES, poses(bench.heard(TICK)[-1].tick, since_ns), CAMERA)
        bench.run(node, S // 10)
        assert all(robot.lost for robot in bench.heard(TICK)[-1].robots)
    bench.say(POSES, poses(bench.heard(TICK)[-1].tick, 15 * MS), CAMERA)
    bench.run(node, S // 10)
    newest = bench.heard(TICK)[-1].robots
    assert not any(robot.lost for robot in newest)
    assert [round(robot.x_m, 3) for robot in newest] == [0.1, 0.2, 0.3, 0.4]
