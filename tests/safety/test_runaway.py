"""A wheel that turns by itself: by its encoders and by poses, each threshold from both sides."""

import math
import random
from collections.abc import Callable, Iterable
from itertools import pairwise, repeat

import pytest

from robofleet.safety import runaway
from robofleet.safety.runaway import (
    FASTER,
    ROLLED_M_S,
    SLOWER,
    TURNING_RAD_S,
    WINDOW_NS,
    Rolling,
    direction,
    turning_since_ns,
)
from robofleet.safety.view import RobotView

MS = 1_000_000
NOW = 1_000_000 * MS
LOOP_NS = 10 * MS
WHEEL_RADIUS, WHEEL_BASE = 0.016, 0.105  # of a GTernal
ROLLED_M = ROLLED_M_S * WINDOW_NS * 1e-9  # in a window
FAST = 6.1
Pose = tuple[float, float, float]


def looked(speeds: Iterable[float], outputs: Iterable[float] | None = None, every_ns: int = LOOP_NS) -> list[bool]:
    """Return whether a wheel runs by itself, at each look; without ``outputs`` it is commanded to stand."""
    since_ns, before, found = NOW, 0, []
    for k, (speed, output) in enumerate(zip(speeds, repeat(0.0) if outputs is None else outputs, strict=False)):
        looked_ns, now_ns = NOW + k * every_ns, NOW + (k + 1) * every_ns
        after = direction(output, speed)
        since_ns = turning_since_ns(since_ns, looked_ns, before, after, now_ns)
        before = after
        found.append(runaway.runs(since_ns, now_ns))
    return found


@pytest.mark.parametrize("speed", [FAST, -FAST, 0.51, -0.51, math.inf])
def test_a_wheel_that_never_rests_is_named_after_800_ms(speed: float) -> None:
    assert looked([speed] * 100).index(True) == 79
    assert all(looked([speed] * 300)[79:]), "it is told as long as it lasts"


@pytest.mark.parametrize("speed", [0.0, 0.5, -0.5, math.nan])
def test_a_wheel_that_is_no_faster_than_that_is_at_rest(speed: float) -> None:
    assert TURNING_RAD_S == 0.5
    assert not any(looked([speed] * 1000))


@pytest.mark.parametrize("output", [FAST, -FAST, 0.3, 12.5])
@pytest.mark.parametrize("share", [0.0, 0.2, 1.0, FASTER])
def test_a_wheel_that_turns_as_commanded_or_slower_may(output: float, share: float) -> None:
    assert not any(looked([share * output] * 1000, repeat(output)))


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("output", [0.0, 0.1, 4.0, 12.5])
def test_a_wheel_that_is_much_faster_than_commanded_or_turns_the_other_way_is_named(output: float, way: float) -> None:
    just = FASTER * output + TURNING_RAD_S
    assert not any(looked([way * just] * 1000, repeat(way * output)))
    assert looked([way * (just + 1e-6)] * 100, repeat(way * output)).index(True) == 79
    assert looked([-way * (TURNING_RAD_S + 1e-6)] * 100, repeat(way * output)).index(True) == 79


def test_a_wheel_that_swings_to_and_fro_is_not_named() -> None:
    """A control loop that is unstable, against a motor's lag: always the other way, never for long."""
    assert not any(looked(([9.0] * 70 + [-9.0] * 70) * 10, ([-9.0] * 70 + [9.0] * 70) * 10))


@pytest.mark.parametrize("lag_s", [0.03, 0.1, 0.15])
@pytest.mark.parametrize("slope", [2.0, 5.0, 10.0, 20.0, 40.0, 100.0, 300.0])
def test_a_wheel_that_lags_behind_while_it_brakes_is_not_named(lag_s: float, slope: float) -> None:
    """From 12.5 rad/s to zero and on to 12.5 backward, first order, 50 ms late, counting in steps of 0.8 rad/s."""
    outputs = [max(-12.5, 12.5 - max(0.0, 0.01 * k - 0.5) * slope) for k in range(2000)]
    speed, speeds = 12.5, []
    for k in range(2000):
        speed += (outputs[max(0, k - 5)] - speed) * (1.0 - math.exp(-0.01 / lag_s))
        speeds.append(0.8 * round(speed / 0.8))
    assert not any(looked(speeds, outputs))


def test_one_moment_of_rest_begins_anew() -> None:
    found = looked([*[FAST] * 79, 0.0, *[FAST] * 81])
    assert found.index(True) == 80 + 79
    assert looked([*[FAST] * 200, 0.0, FAST])[-2:] == [False, False]


@pytest.mark.parametrize(("pause_ns", "named"), [(100 * MS, True), (100 * MS + 1, False), (1_000 * MS, False)])
def test_who_did_not_look_did_not_see_it_turn_all_the_time(pause_ns: int, named: bool) -> None:
    assert any(looked([FAST] * 20, every_ns=pause_ns)) is named


def test_a_clock_that_is_set_back_begins_anew() -> None:
    since_ns = NOW - 790 * MS
    assert turning_since_ns(since_ns, NOW, 1, 1, NOW - 1) == NOW - 1
    assert turning_since_ns(since_ns, NOW, 1, 1, NOW) == since_ns


def test_a_wheel_that_comes_to_rest_after_driving_is_not_named() -> None:
    speeds = [12.5] * 100 + [12.5 * math.exp(-k / 5) for k in range(200)]  # a lag of 50 ms
    assert not any(looked(speeds, [12.5] * 100 + [0.0] * 200))


def seen(poses: Iterable[Pose], every_ns: int = WINDOW_NS, **changes: float) -> list[bool]:
    """Return whether a robot without encoders rolls by itself, at each image."""
    rolling, found = Rolling(), []
    for k, pose in enumerate(poses):
        robot = RobotView(seen_ns=NOW + k * every_ns, pose=pose)._replace(**changes)
        rolling = runaway.watch(rolling, robot, WHEEL_RADIUS, WHEEL_BASE)
        found.append(rolling.runs)
    return found


def ahead(step: float, psi: float = 0.7, number: int = 12) -> list[Pose]:
    return [(k * step * math.cos(psi), k * step * math.sin(psi), psi) for k in range(number)]


def spin(turn: float, number: int = 12) -> list[Pose]:
    return [(0.3, 0.2, math.remainder(3.0 + k * turn, math.tau)) for k in range(number)]


def one_wheel(speed: float, number: int = 12) -> list[Pose]:
    """The left wheel stands: an arc round it."""
    return driven(0.0, speed, number)


def driven(left: float, right: float, number: int = 12) -> list[Pose]:
    """Wheels that turn so fast [rad/s], from the origin on."""
    v, omega = WHEEL_RADIUS * (left + right) / 2.0, WHEEL_RADIUS * (right - left) / WHEEL_BASE
    poses = []
    for k in range(number):
        turn, way = omega * k * WINDOW_NS * 1e-9, v * k * WINDOW_NS * 1e-9
        chord = way * (math.sin(turn / 2.0) / (turn / 2.0) if turn else 1.0)
        poses.append((chord * math.cos(turn / 2.0), chord * math.sin(turn / 2.0), math.remainder(turn, math.tau)))
    return poses


JUST = 1.0001 * ROLLED_M
RUNAWAYS: dict[str, list[Pose]] = {
    "forward": ahead(0.0244), "backward": ahead(-0.0244), "just": ahead(JUST), "just back": ahead(-JUST),
    "round": spin(0.3), "round the other way": spin(-0.3), "just round": spin(2.0 * JUST / WHEEL_BASE),
    "one wheel": one_wheel(FAST), "one wheel back": one_wheel(-FAST),
    "aside, a little": [(0.01 * k, 0.0049 * k, 0.0) for k in range(12)],
}  # fmt: skip
OTHERS: dict[str, list[Pose]] = {
    "standing": ahead(0.0), "creeping": ahead(0.9999 * ROLLED_M),
    "turning slowly": spin(1.9998 * ROLLED_M / WHEEL_BASE),
    "to and fro": [(0.02 * (k % 2), 0.0, 0.0) for k in range(12)],
    "carried aside": [(0.0, 0.02 * k, 0.0) for k in range(12)],
    "carried askew": [(0.01 * k, 0.0051 * k, 0.0) for k in range(12)],
    "nudged": [*ahead(0.0, 0.0, 4), *((0.02 * k, 0.0, 0.0) for k in range(4)), *[(0.06, 0.0, 0.0)] * 6],
}  # fmt: skip


@pytest.mark.parametrize("kind", list(RUNAWAYS))
def test_a_robot_that_rolls_for_four_windows_is_named(kind: str) -> None:
    found = seen(RUNAWAYS[kind])
    assert found.index(True) == 4
    assert all(found[4:]), "it is told as long as it lasts"


@pytest.mark.parametrize("kind", list(OTHERS))
def test_a_robot_that_does_something_else_is_not(kind: str) -> None:
    assert not any(seen(OTHERS[kind]))


@pytest.mark.parametrize("name", ["left_angle", "right_angle", "left_speed", "right_speed"])
@pytest.mark.parametrize("value", [1e-9, -1e-9])
def test_who_has_encoders_is_not_judged_by_poses(name: str, value: float) -> None:
    assert not any(seen(RUNAWAYS["forward"], **{name: value}))


def test_a_robot_that_was_never_seen_is_not_judged() -> None:
    assert runaway.watch(Rolling(NOW, by_itself=(4, 0)), RobotView(), WHEEL_RADIUS, WHEEL_BASE) == Rolling()


def test_images_in_between_do_not_shorten_a_window() -> None:
    poses = [(0.001 * k, 0.0, 0.0) for k in range(60)]  # 33 ms each, 8 a window: 8 mm
    found = seen(poses, every_ns=33 * MS)
    assert found.index(True) == 32


@pytest.mark.parametrize(("gap_ns", "named"), [(2 * WINDOW_NS - 1, True), (2 * WINDOW_NS, False), (-1, False)])
def test_a_robot_that_was_not_seen_for_two_windows_begins_anew(gap_ns: int, named: bool) -> None:
    rolling = Rolling(NOW, by_itself=(3, 3))
    robot = RobotView(seen_ns=NOW + gap_ns, pose=(0.02, 0.0, 0.0))
    after = runaway.watch(rolling, robot, WHEEL_RADIUS, WHEEL_BASE)
    assert after.runs is named
    assert after.by_itself == ((4, 4) if named else (0, 0))


def test_a_window_without_motion_or_the_other_way_ends_it() -> None:
    def next_(windows: int, x: float) -> int:
        robot = RobotView(seen_ns=NOW + WINDOW_NS, pose=(x, 0.0, 0.0))
        after = runaway.watch(Rolling(NOW, by_itself=(windows, windows)), robot, WHEEL_RADIUS, WHEEL_BASE)
        left, right = after.by_itself
        assert left == right
        return left

    assert [next_(3, 0.02), next_(-3, 0.02), next_(5, 0.0), next_(-3, -0.02), next_(3, -0.02)] == [4, 1, 0, -4, -1]


@pytest.mark.parametrize("value", [1e300, -1e300, 1.7e308, -1.7e308])
def test_no_pose_that_can_be_said_raises(value: float) -> None:
    poses = [(value, -value, value), (-value, value, -value), (0.0, 0.0, 0.0)] * 3
    assert len(seen(poses)) == 9


@pytest.mark.parametrize("sigma_m", [0.0003, 0.002])
def test_noise_is_no_motion(sigma_m: float, noise: Callable[[float, int], list[Pose]]) -> None:
    poses = noise(sigma_m, 4000)
    assert any(before != other for before, other in pairwise(poses))
    assert not any(seen(poses))


@pytest.fixture
def noise() -> Callable[[float, int], list[Pose]]:
    import numpy as np

    def drawn(sigma_m: float, number: int) -> list[Pose]:
        rows = np.random.default_rng(3).normal(0.0, (sigma_m, sigma_m, 0.005), (number, 3))
        return [(x, y, psi) for x, y, psi in rows.tolist()]

    return drawn


def test_the_same_image_seen_twice_changes_nothing() -> None:
    rolling = Rolling()
    for k, pose in enumerate(ahead(0.02)):
        robot = RobotView(seen_ns=NOW + k * WINDOW_NS, pose=pose)
        rolling = runaway.watch(rolling, robot, WHEEL_RADIUS, WHEEL_BASE)
        assert runaway.watch(rolling, robot, WHEEL_RADIUS, WHEEL_BASE) == rolling
        assert rolling.by_itself == (k, k)


def test_a_sharp_turn_is_one_of_the_wheels_at_its_middle_heading() -> None:
    """An arc of 1.5 rad in a window, with a chord of 0.1 m: along the heading half way, and nothing aside."""
    pose, poses = (0.0, 0.0, 0.0), []
    for _ in range(6):
        poses.append(pose)
        x, y, psi = pose
        pose = x + 0.1 * math.cos(psi + 0.75), y + 0.1 * math.sin(psi + 0.75), math.remainder(psi + 1.5, math.tau)
    assert seen(poses)[4]


def test_rolling_as_far_as_the_threshold_counts() -> None:
    robot = RobotView(seen_ns=NOW + WINDOW_NS, pose=(ROLLED_M, 0.0, 0.0))
    assert runaway.watch(Rolling(NOW), robot, WHEEL_RADIUS, WHEEL_BASE).by_itself == (1, 1)


def followed(commands: Iterable[tuple[float, float]], wheels: Iterable[tuple[float, float]]) -> Rolling:
    """Return what 3 s tell of a robot without encoders: commands and wheels [rad/s], each for a window."""
    rolling, angles, (x, y, psi) = Rolling(), (0.0, 0.0), (0.2, -0.1, 3.0)
    for k, (command, wheel) in enumerate(zip(((0.0, 0.0), *commands), ((0.0, 0.0), *wheels), strict=False)):
        angles = angles[0] + 0.25 * command[0], angles[1] + 0.25 * command[1]
        chord_x, chord_y, turn = driven(*wheel, 2)[1]
        x, y = (
            x + chord_x * math.cos(psi) - chord_y * math.sin(psi),
            y + chord_x * math.sin(psi) + chord_y * math.cos(psi),
        )
        psi = math.remainder(psi + turn, math.tau)
        robot = RobotView(seen_ns=NOW + k * WINDOW_NS, pose=(x, y, psi), left_told=angles[0], right_told=angles[1])
        rolling = runaway.watch(rolling, robot, WHEEL_RADIUS, WHEEL_BASE)
    return rolling


SLACK = ROLLED_M_S / WHEEL_RADIUS
STEADY = [(-3.0, -3.0), (6.0, 6.0), (4.0, 8.0), (-6.0, 5.0), (0.3, 0.0), (0.0, 0.0)]


@pytest.mark.parametrize("commands", STEADY)
@pytest.mark.parametrize("share", [0.7, 1.0, FASTER])
def test_a_robot_without_encoders_that_goes_as_commanded_is_not_named(
    commands: tuple[float, float], share: float
) -> None:
    rolling = followed(repeat(commands, 12), repeat((share * commands[0], share * commands[1]), 12))
    assert not rolling.runs
    assert not rolling.stands


@pytest.mark.parametrize("commands", STEADY)
@pytest.mark.parametrize("excess", [1.02, -1.02])
def test_a_wheel_without_encoders_that_is_much_faster_or_turns_the_other_way_is_named(
    commands: tuple[float, float], excess: float
) -> None:
    left, right = commands
    limit = FASTER * (max(right, 0.0) if excess > 0.0 else min(right, 0.0))
    assert followed(repeat(commands, 12), repeat((left, limit + excess * SLACK), 12)).runs
    assert not followed(repeat(commands, 12), repeat((left, limit + excess * SLACK), 12)).stands, "it has one name"
    assert not followed(repeat(commands, 3), repeat((left, limit + excess * SLACK), 3)).runs, "not for three windows"
    assert not followed(repeat(commands, 12), repeat((left, limit + 0.98 / 1.02 * excess * SLACK), 12)).runs


@pytest.mark.parametrize("command", [2.0, 12.0, -2.0, -12.0])
def test_a_wheel_without_encoders_that_hardly_turns_is_named_after_a_second(command: float) -> None:
    slow = math.copysign(SLOWER * abs(command) - TURNING_RAD_S, command)
    assert followed(repeat((command, command), 12), repeat((command, 0.99 * slow), 12)).stands
    assert followed(repeat((command, command), 12), repeat((0.0, 0.0), 12)).stands
    assert not followed(repeat((command, command), 4), repeat((0.0, 0.0), 4)).stands, "the first window may lag"
    assert not followed(repeat((command, command), 12), repeat((command, 1.01 * slow), 12)).stands
    assert not followed(repeat((0.99 * command / 6.0,) * 2, 12), repeat((0.0, 0.0), 12)).stands


@pytest.mark.parametrize("lag", [1, 0])
@pytest.mark.parametrize("seed", range(4))
def test_whatever_is_commanded_who_follows_a_window_late_is_not_named(lag: int, seed: int) -> None:
    drawn = random.Random(seed)
    commands = [(drawn.uniform(-12.0, 12.0), drawn.uniform(-12.0, 12.0)) for _ in range(400)]
    for end in range(5, 400):
        rolling = followed(commands[end - 5 : end], [*[commands[end - 6]] * lag, *commands[end - 5 : end]])
        assert not rolling.runs
        assert not rolling.stands
