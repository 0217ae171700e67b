"""Fleets of which a camera sees only some: the others are told beside them, as if it did."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robofleet.config.load import ConfigError
from robofleet.core.clock import S
from robofleet.runs.check import refusals
from tests.nodes.tracker_stand import TrackerStand
from tests.robots import stalls

pytestmark = pytest.mark.long

Make = Callable[..., Any]
MIXED = Path(__file__).parents[2] / "configs" / "mixed.yaml"
VIRTUAL = ["robots.1.reality=simulated", "robots.3.reality=simulated"]  # r2 and r4
ALONE = f"'{__name__}:Alone'"
LENS = f"'{__name__}:Lens'"


class Alone:
    """A robot that exists: nobody knows the truth of it."""


class Lens:
    """A camera that exists."""


class Floor(TrackerStand):
    def errors(self, frames: list[Any]) -> dict[int, np.ndarray]:
        """Return pose minus truth at mid-exposure of each tag's robot, (n, 3)."""
        robots = {robot.tag: robot for robot in self.bench.config.robots}
        return {
            tag: np.array(
                [
                    np.subtract(pose[3:], self.pose(robot, frame.exposure_ns))
                    for frame in frames
                    for pose in frame.poses
                    if pose.tag == tag
                ]
            )
            for tag, robot in robots.items()
        }


@pytest.fixture(scope="module")
def floor_of(bench_of: Make, platoon_of: Make) -> Callable[..., Floor]:
    return lambda *overrides: Floor(bench_of(platoon_of(*VIRTUAL, *overrides)))


def test_robots_in_no_image_are_told_with_each_image_as_of_its_exposure(floor_of: Make) -> None:
    floor = floor_of("tracker.truth={}")
    frames = floor.run(S)[3:]
    assert len(frames) > 20
    assert all({pose.tag for pose in frame.poses} == {1, 2, 3, 4} for frame in frames)
    errors = floor.errors(frames)
    assert max(np.abs(errors[tag]).max() for tag in (2, 4)) < 1e-9, "merged as they are, nobody measured them"
    assert min(np.abs(errors[tag]).max() for tag in (1, 3)) > 1e-6, "found in the image"


def test_they_have_the_noise_and_the_gaps_that_the_configuration_states(floor_of: Make) -> None:
    floor = floor_of("tracker.truth={position_noise_m: 0.002, heading_noise_rad: 0.03, dropout: 0.25}")
    frames = floor.run(5 * S)[3:]
    errors = floor.errors(frames)
    for tag in (2, 4):
        assert errors[tag].std(axis=0) == pytest.approx([0.002, 0.002, 0.03], rel=0.2)
        assert len(errors[tag]) / len(frames) == pytest.approx(0.75, abs=0.1)
    assert all(len(errors[tag]) == len(frames) and np.abs(errors[tag]).max() < 0.01 for tag in (1, 3))


def test_without_an_image_they_are_gone_too(floor_of: Make) -> None:
    floor = floor_of("camera.simulated={outages: [{kind: stalled, at_s: 0.0, duration_s: 100}]}")
    assert floor.run(S) == []


def test_a_fleet_of_both_drives_as_one_platoon(lockstep: Make) -> None:
    s = lockstep(*VIRTUAL, "run.duration_s=12")
    assert (s["outcome"], s["cause"], s["stops"], s["tracker"]["false_ids"]) == ("completed", None, [], 0)
    assert s["tracker"]["measured_fraction"] > 0.98
    assert s["control_error_mm"]["mean"] <= 1.0
    assert s["min_gap_mm"] > 50


def test_a_robot_in_no_image_can_be_lost_as_any_other(lockstep: Make) -> None:
    faults = "faults=[{robot: r2, kind: pose_dropout, at_s: 2, duration_s: 2}]"
    s = lockstep(*VIRTUAL, "run.duration_s=6", faults)
    assert "r2" in {stop["robot"] for stop in s["stops"]}


def test_a_simulated_robot_that_comes_too_near_is_kept_off_a_real_one(lockstep: Make) -> None:
    """r2 is sent after r1, which stands again and again: one barrier for both."""
    s = lockstep(*VIRTUAL, "run.duration_s=12", stalls("r1", 3, 12))
    assert s["filtered_fraction"] > 0.01, "else nobody came near"
    assert s["min_gap_mm"] > 0


SIMULATED = "robots.1.reality=simulated"


@pytest.mark.parametrize(
    ("overrides", "path", "message"),
    [
        ([f"robots.1.driver={ALONE}", SIMULATED], "robots.1.reality", "nobody knows where r2 is"),
        ([f"robots.1.driver={ALONE}", "tracker.source=truth"], "robots.1.driver", "take tracker.source camera"),
        ([f"robots.1.driver={ALONE}"], "robots.1.driver", "a simulated camera cannot see r2"),
        ([f"camera.source={LENS}", *VIRTUAL, "robots.0.reality=simulated"], "robots.2.reality", "write simulated"),
        ([f"robots.{k}.reality=simulated" for k in range(4)], "tracker.source", "take truth"),
    ],
)
def test_a_robot_that_nobody_would_see_is_refused(
    platoon_of: Make, overrides: list[str], path: str, message: str
) -> None:
    ((where, refusal),) = refusals(platoon_of(*overrides))
    assert where == path
    assert message in refusal


@pytest.mark.parametrize("overrides", [VIRTUAL, [*VIRTUAL, "tracker.source=truth"], ["tracker.source=truth"]])
def test_robots_that_say_where_they_are_may_be_in_the_image_or_not(platoon_of: Make, overrides: list[str]) -> None:
    assert refusals(platoon_of(*overrides)) == []


def test_a_simulated_cameras_trouble_with_a_robot_that_it_does_not_see_is_refused(platoon_of: Make) -> None:
    cover = "camera.simulated={covers: [{robot: r2, at_s: 1, duration_s: 1}]}"
    platoon_of(cover)
    with pytest.raises(ConfigError, match=r"covers.0.robot: r2 is in no image"):
        platoon_of(cover, *VIRTUAL)


def test_a_twin_in_the_arena_leads_a_robot_that_only_the_computer_has(real_run: Make) -> None:
    robots = json.dumps(yaml.safe_load(MIXED.read_text())["robots"][:2])
    run = real_run("--set", f"robots={robots}", "--set", "groups.0.robots=[r1, r2]", "--set", "run.duration_s=4")
    assert run.ended() == 0, run.said
    s = run.summary
    assert (s["outcome"], s["stops"], s["estimated"], s["tracker"]["false_ids"]) == ("completed", [], [], 0)
    assert s["tracker"]["measured_fraction"] > 0.95
    assert s["control_error_mm"]["mean"] <= 3.0
    assert s["min_gap_mm"] > 50
    assert run.nothing_is_left()
