"""Units: which robots share a driver process, and what is refused."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.config.load import ConfigError, load_config
from tests.shipped import PLATOON

TRUTH = "tracker.source=truth"
REAL = "robots.1.driver=gternal"


@pytest.mark.parametrize(
    ("overrides", "units"),
    [
        ((), {"r1": "r1 r2 r3 r4"}),
        (("drivers.robots_per_process=1",), {"r1": "r1", "r2": "r2", "r3": "r3", "r4": "r4"}),
        (("drivers.robots_per_process=3",), {"r1": "r1 r2 r3", "r4": "r4"}),
        ((REAL,), {"r1": "r1 r3 r4", "r2": "r2"}),
        (("robots.0.driver=gternal",), {"r1": "r1", "r2": "r2 r3 r4"}),
        (("robots.3.unit=b", "robots.1.unit=b"), {"r1": "r1 r3", "b": "r2 r4"}),
        (("robots.0.unit=b", "robots.3.unit=a", "robots.1.unit=a"), {"b": "r1", "a": "r2 r4", "r3": "r3"}),
        ((REAL, "robots.1.unit=r1", "robots.0.unit=r1"), {"r1": "r1 r2", "r3": "r3 r4"}),
        (("drivers.robots_per_process=2", "robots.1.unit=b"), {"r1": "r1 r3", "b": "r2", "r4": "r4"}),
    ],
)
def test_who_shares_a_process(overrides: tuple[str, ...], units: dict[str, str]) -> None:
    """In the order of their first robots, each unit's in the order of ``robots``."""
    config = load_config(PLATOON, [TRUTH, *overrides])
    assert list(config.units.items()) == [(name, tuple(robots.split())) for name, robots in units.items()]
    assert list(config.driven) == [f"driver-{name}" for name in units]
    for name, robots in config.units.items():
        for robot in robots:
            assert (config.unit_of[robot], config.driver_of(robot)) == (name, f"driver-{name}")


def test_a_copy_with_other_robots_has_other_units() -> None:
    config = load_config(PLATOON, [TRUTH])
    assert (config.units, config.unit_of["r1"], config.robot("r1").tag) == ({"r1": config.ids}, "r1", 1)
    robots = tuple(robot.model_copy(update={"unit": "a", "tag": 9}) for robot in config.robots[:2])
    changed = config.model_copy(update={"robots": robots})
    assert (changed.units, changed.unit_of["r1"], changed.robot("r1").tag) == ({"a": ("r1", "r2")}, "a", 9)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.lists(st.sampled_from([None, "a", "b", "r3", "r4"]), min_size=4, max_size=4), st.sampled_from(["null", 1, 2]))
def test_every_robot_is_in_one_unit(names: list[str | None], together: str | int) -> None:
    own = [f"robots.{row}.unit={name}" for row, name in enumerate(names) if name]
    try:
        config = load_config(PLATOON, [TRUTH, f"drivers.robots_per_process={together}", *own])
    except ConfigError as error:
        taken = str(error)
        assert taken.count("is the unit of the robot") == taken.count("\n") + 1 > 0
        return
    assert sorted(robot for robots in config.units.values() for robot in robots) == ["r1", "r2", "r3", "r4"]
    for robot, name in zip(config.robots, names, strict=True):
        assert name is None or robot.id in config.units[name]
