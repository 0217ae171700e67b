"""The distances follow from each other: where the barrier lets robots come to rest, they can be armed again."""

from pathlib import Path

import pytest

from robofleet.config import barrier, slices
from robofleet.config.load import load_config
from robofleet.safety.distances import CLOSEST_M, apart, apart_at_rest, from_edge, least_room_m, room_m

CONFIGS = Path(__file__).parents[2] / "configs"
CLOSER = {"robotarium.yaml"}  # gap_m 0: its scripts come nearer, and then somebody moves the robots apart
SHIPPED = sorted(file.name for file in CONFIGS.glob("*.yaml") if file.name not in CLOSER)


@pytest.mark.parametrize("name", SHIPPED)
def test_each_distance_leaves_room_for_the_one_before(name: str) -> None:
    """Whatever way a robot heads: the barrier's point may be ``ahead`` nearer than its axle, or further."""
    config = load_config(CONFIGS / name)
    keepout = barrier.keepout(config)
    for robot in config.robots:
        body, drive = barrier.body(config, robot), slices.drive(robot)
        least = least_room_m(drive.wheel_radius)
        assert CLOSEST_M < least < room_m(drive.wheel_radius)
        assert least <= from_edge(keepout, body) - keepout.ahead - body.radius
        assert least <= apart_at_rest(keepout, body, body) - 2 * (keepout.ahead + body.radius)
        assert apart_at_rest(keepout, body, body) < apart(keepout, body, body)
