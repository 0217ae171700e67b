"""Commands of ROS 2 nodes: each robot does its own as long as that is fresh, and no longer."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.behaviours.interface import Wish, WishKind
from robofleet.behaviours.ros2 import Ros2
from robofleet.config import groups
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.testing import situation

CONFIG = load_config(SHIPPED / "ros2.yaml")
TEAM = groups.team(CONFIG, CONFIG.groups[0])
N = len(TEAM)
SITUATION = situation(np.zeros((N, 3)))
SILENT_S = 0.15


def decided(age: float, own: list[float], commanded: list[bool], kind: WishKind = WishKind.BODY) -> np.ndarray:
    values = np.column_stack([np.full(N, 0.1), np.full(N, 0.5), own])
    is_commanded = np.array(commanded)
    values = np.where(is_commanded[:, None], values, 0.0)
    wish = Wish(kind=kind, values=values, told=is_commanded, order=0, age=age, epoch=1, seq=1)
    decision = Ros2(Ros2.Settings(), TEAM).decide(replace(SITUATION, wish=wish))
    assert decision.of == "body" and decision.hold is None
    return np.asarray(decision.velocities)


AGES = st.lists(st.floats(-TEAM.tick, 1.0), min_size=N, max_size=N)


@given(st.floats(0.0, 0.5), AGES, st.lists(st.booleans(), min_size=N, max_size=N))
def test_a_robot_does_what_is_fresh_and_stands_else(age: float, own: list[float], commanded: list[bool]) -> None:
    for row, velocity in enumerate(decided(age, own, commanded)):
        fresh = commanded[row] and age + own[row] <= SILENT_S
        if abs(age + own[row] - SILENT_S) > 1e-6:
            assert velocity == pytest.approx((0.1, 0.5) if fresh else (0.0, 0.0))


@pytest.mark.parametrize("kind", WishKind)
def test_no_command_is_younger_than_a_sender_can_know_and_nothing_else_is_done(kind: WishKind) -> None:
    assert not decided(SILENT_S + 2 * TEAM.tick, [-1e5] * N, [True] * N, kind).any()
    assert decided(0.0, [0.0] * N, [True] * N, kind).any() == (kind is WishKind.BODY)


def test_the_robots_stand_while_nothing_was_commanded() -> None:
    assert not np.any(Ros2(Ros2.Settings(), TEAM).decide(SITUATION).velocities)
