"""A person's commands: limited, as long as they are fresh; the others follow the way of the robot ahead."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet import testing
from robofleet.behaviours.interface import Situation, Wish, WishKind
from robofleet.behaviours.teleop import Teleop
from robofleet.bus.keys import STATUS, key
from robofleet.bus.messages import UNIT_STATUS
from robofleet.config import groups
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase

CONFIG = load_config(SHIPPED / "teleop.yaml")
TEAM = groups.team(CONFIG, CONFIG.groups[0])
SETTINGS = Teleop.Settings.model_validate(CONFIG.groups[0].settings)
N, L = len(TEAM), TEAM.point_ahead
MOVES = WishKind.BODY, WishKind.RESCUE
SPEEDS = st.floats(-10.0, 10.0)


def situation(poses: np.ndarray, wish: Wish | None = None) -> Situation:
    return replace(testing.situation(poses), wish=wish)


def wish(v: float, omega: float, age: float = 0.0, own: float = 0.0, kind: WishKind = WishKind.BODY) -> Wish:
    values, is_commanded = np.zeros((N, 3)), np.arange(N) == 0
    values[0] = v, omega, own
    return Wish(kind=kind, values=values, told=is_commanded, order=0, age=age, epoch=1, seq=1)


def body(behaviour: Teleop, poses: np.ndarray, newest: Wish | None) -> np.ndarray:
    """Return v and omega of the first robot."""
    x, y = behaviour.decide(situation(poses, newest)).velocities[0]
    cos, sin = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    return np.array([x * cos + y * sin, (y * cos - x * sin) / L])


@given(SPEEDS, SPEEDS, st.floats(-np.pi, np.pi))
def test_the_first_robot_does_what_is_commanded_up_to_its_limits(v: float, omega: float, psi: float) -> None:
    poses = np.tile([0.0, 0.0, psi], (N, 1))
    most = SETTINGS.max_speed_m_s, SETTINGS.max_turn_rad_s
    done = body(Teleop(SETTINGS, TEAM), poses, wish(v, omega))
    assert done == pytest.approx(np.clip([v, omega], np.negative(most), most), abs=1e-9)


@given(st.floats(0.0, 0.5), st.floats(-TEAM.tick, 0.5))
def test_a_command_that_is_too_old_counts_for_nothing(age: float, own: float) -> None:
    done = body(Teleop(SETTINGS, TEAM), np.zeros((N, 3)), wish(0.05, 0.1, age, own))
    if abs(age + own - SETTINGS.silent_s) > 1e-6:
        assert done.any() == (age + own < SETTINGS.silent_s)


OTHERS = [wish(0.05, 0.1, kind=kind) for kind in WishKind if kind not in MOVES]


@pytest.mark.parametrize("newest", [None, *OTHERS, wish(0.05, 0.1, SETTINGS.silent_s + 0.01)])
def test_without_a_command_or_after_one_that_is_too_old_everybody_stands(newest: Wish | None) -> None:
    assert not strung_out(newest).any()
    assert strung_out(wish(0.05, 0.1, SETTINGS.silent_s)).any(axis=1).all()


def strung_out(newest: Wish | None) -> np.ndarray:
    """Return the velocities of robots that are twice their spacing apart, and on each other's ways."""
    behaviour, poses = Teleop(SETTINGS, TEAM), np.zeros((N, 3))
    poses[:, 0] = -2.0 * SETTINGS.spacing_m * np.arange(N)
    behaviour.decide(situation(poses, newest))
    return behaviour.decide(situation(poses, newest)).velocities


@pytest.mark.parametrize("row", range(N))
def test_the_one_robot_that_is_driven_out_crawls_and_no_other_follows(row: int) -> None:
    values, is_commanded = np.zeros((N, 3)), np.arange(N) == row
    values[row] = 5.0, 0.0, 0.0
    poses = np.column_stack([-0.5 * np.arange(N), np.zeros((N, 2))])
    behaviour = Teleop(SETTINGS, TEAM)
    behaviour.decide(situation(poses))
    decision = behaviour.decide(
        situation(poses, Wish(kind=WishKind.RESCUE, values=values, told=is_commanded, order=1, age=0.0, epoch=3, seq=7))
    )
    assert decision.velocities[row] == pytest.approx([SETTINGS.crawl_m_s, 0.0])
    assert not np.delete(decision.velocities, row, axis=0).any()
    assert (decision.figures["wish_epoch"], decision.figures["wish"]) == (3, 7), "a replay finds the command by it"


@pytest.mark.slow
def test_followers_take_the_way_of_the_robot_ahead_and_stop_behind_it() -> None:
    """Points that do as they are told: the leader's drives a corner, and waits."""
    behaviour, tick = Teleop(SETTINGS, TEAM), TEAM.tick
    points = np.column_stack([-0.3 * np.arange(N), np.zeros(N)])
    leads = [(0.1, 0.0)] * 300 + [(0.0, 0.1)] * 200 + [(0.0, 0.0)] * 300
    errors, trails = [], []
    for lead in leads:
        poses = np.column_stack([points - [L, 0.0], np.zeros(N)])
        decision = behaviour.decide(situation(poses, wish(0.0, 0.0)))
        decision.velocities[0] = lead
        errors.append(decision.figures["following_error"][1:])
        trails.append(points.copy())
        points = points + tick * decision.velocities
    gaps = np.hypot(*np.diff(points, axis=0).T)
    assert errors[-1] == pytest.approx(0.0, abs=1e-3)
    assert gaps[0] <= SETTINGS.spacing_m + 1e-6
    corner = np.array([points[0][0], 0.0])
    follower = np.array(trails)[:, 1]
    nearest = np.hypot(*(follower - corner).T).min()
    assert nearest < 0.08, "the follower came through the corner, and did not cut it"


def test_a_follower_stands_while_the_robot_ahead_is_near() -> None:
    behaviour = Teleop(SETTINGS, TEAM)
    poses = np.zeros((N, 3))
    poses[:, 0] = -0.8 * SETTINGS.spacing_m * np.arange(N)
    assert not behaviour.decide(situation(poses, wish(0.0, 0.0))).velocities[1:].any()


@pytest.mark.parametrize(
    ("keys", "broken"),
    [
        ({}, set()),
        ({"spacing_m": 0.05}, {"settings.spacing_m"}),
        ({"max_speed_m_s": 0.21}, {"settings.max_speed_m_s"}),
        ({"max_speed_m_s": 5.0}, {"settings.max_speed_m_s"}),
    ],
)
def test_what_no_robot_can_do_or_the_barrier_keeps_apart_is_refused(keys: dict[str, float], broken: set[str]) -> None:
    bounds = list(Teleop(SETTINGS.model_copy(update=keys), TEAM).bounds())
    assert {bound.path for bound in bounds if not bound.holds} == broken
    assert {bound.path for bound in bounds} == {"settings.spacing_m", "settings.max_speed_m_s"}


def test_in_a_run_nobody_moves_before_the_first_command() -> None:
    config = load_config(SHIPPED / "teleop.yaml", ["run.duration_s=1", "tracker.source=truth"])
    run = Lockstep(config)
    outputs: list[tuple[float, float]] = []
    statuses = [key(config.arena.name, STATUS, unit) for unit in config.units]

    def tap(message: tuple[str, bytes]) -> None:
        full, payload = message
        if (
            run.status.phase is Phase.RUNNING
            and full in statuses
            and (status := UNIT_STATUS.decode(payload)) is not None
        ):
            outputs.extend((gate.left_output_rad_s, gate.right_output_rad_s) for gate in status.robots)

    run.bus.tap(tap)
    assert run.run() == ("completed", None)
    assert len(outputs) > N * 40
    assert not np.any(outputs)
