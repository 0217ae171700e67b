"""A group of ideal GTernals that a behaviour drives through its interface alone: no bus, no barrier."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robofleet.behaviours.interface import Behaviour, Decision, Flow, Past, Pose, Situation, Team
from robofleet.core.arrays import Array
from robofleet.safety.distances import Body, Keepout
from robofleet.vehicles.differential_drive import (
    DifferentialDrive,
    arc,
    body_from_point,
    body_from_wheels,
    feasible_ratio,
    wheels_from_body,
)

GTERNAL = DifferentialDrive(
    wheel_radius=0.016,
    wheel_base=0.105,
    max_wheel_speed=12.5,
    max_speed=0.2,
    motor_lag=0.08,
    max_wheel_acceleration=150.0,
)
TICK, AHEAD = 0.033, 0.08
ARENA = (3.2, 2.0)
KEEPOUT = Keepout(
    gap=0.015,
    ahead=0.01,
    rate=10.0,
    pose_error=0.002,
    age=0.06,
    lost_after=0.5,
    point_ahead=AHEAD,
    tick=TICK,
    arena=ARENA,
)


def team(n: int, starts: Sequence[Pose | None] | None = None, *, tick: float = TICK) -> Team:
    """Make a group of GTernals, r1 to rn, in an arena of 3.2 by 2 m, with the paper's parameters.

    Args:
        n: How many robots.
        starts: Pose of each robot where the behaviour begins: x, y [m], psi [rad; world]. None: not known.
        tick: Control step [s].

    Returns:
        What a behaviour knows of its group.
    """
    body = Body(GTERNAL, 0.055, 0.002)
    return Team(
        name="group", robots=tuple(f"r{k + 1}" for k in range(n)), drives=(GTERNAL,) * n, bodies=(body,) * n,
        starts=tuple(starts or [None] * n), bystanders=(), keepout=KEEPOUT, arena=ARENA, tick=tick, delay=0.002,
        point_ahead=AHEAD, flow=Flow(45.0, 0.6, "exact"), rng=np.random.default_rng(1),
    )  # fmt: skip


def make(kind: type[Behaviour], settings: Mapping[str, Any], group: Team) -> Behaviour:
    """Make a behaviour as a configuration does.

    Args:
        kind: The behaviour's class.
        settings: The keys of ``groups[].settings``.
        group: The group, as ``team`` makes it.

    Returns:
        The behaviour.
    """
    return kind(kind.Settings.model_validate(settings), group)


def refusals(behaviour: Behaviour) -> list[str]:
    """List what ``robofleet check`` refuses of a behaviour.

    Args:
        behaviour: The behaviour.

    Returns:
        One line for each refusal and each bound that is not met. It begins with the key.
    """
    broken = [f"{bound.path}: {bound.what} {bound.mend}" for bound in behaviour.bounds() if not bound.holds]
    return [f"{key}: {message}" for key, message in behaviour.refusals()] + broken


def situation(poses: Array, t: float = 0.0, wind: tuple[float, float] = (0.0, 0.0)) -> Situation:
    """Make a situation in which all robots may drive and nobody else is in the arena.

    Args:
        poses: (N, 3) poses of the centres: x, y [m], psi [rad; world].
        t: Time since the start [s].
        wind: Velocity of every robot beyond what was commanded [m/s; world].

    Returns:
        The situation.
    """
    n = len(poses)
    return Situation(
        t=t,
        poses=np.array(poses),
        driving=np.ones(n, dtype=np.bool_),
        disturbance=np.tile(np.array(wind), (n, 1)),
        others=np.empty((0, 3)),
    )


def drive(behaviour: Behaviour, poses: Array, seconds: float, *, wind: tuple[float, float] = (0.0, 0.0)) -> Past:
    """Drive a behaviour's robots. They are ideal: their wheels do at once what they can of each decision.

    Args:
        behaviour: The behaviour.
        poses: (N, 3) poses of the centres at the start: x, y [m], psi [rad; world].
        seconds: How long [s].
        wind: Velocity of every robot beyond what was commanded [m/s; world]. The behaviour is told.

    Returns:
        What became of the group. Its second half counts as settled.
    """
    group, poses = behaviour.team, np.array(poses, dtype=np.float64)
    n, tick = len(group), group.tick
    behaviour.restart()
    ticks: list[tuple[float, Array, Array, Decision]] = []
    for k in range(round(seconds / tick)):
        t = k * tick
        now = situation(poses, t, wind)
        decision = behaviour.decide(now)
        ticks.append((t, poses.copy(), now.points(AHEAD), decision))
        velocities = np.empty((n, 2))
        for i, (x, y, psi) in enumerate(poses.tolist()):
            velocities[i], (v, omega) = _achieved(decision, i, psi)
            poses[i] = arc(x, y, psi, v, omega, tick)
        poses[:, :2] += tick * np.array(wind)
        behaviour.changed(velocities)
    t_column, pose_rows, point_rows, decisions = (list(column) for column in zip(*ticks, strict=True))
    settled = np.array(t_column) > seconds / 2
    nothing = np.full((n, 2), np.nan)
    references = [nothing if decision.references is None else decision.references for decision in decisions]
    figures = {
        figure.name: np.array([np.broadcast_to(decision.figures.get(figure.name, np.nan), n) for decision in decisions])
        for figure in behaviour.figures
    }
    return Past(
        t=np.array(t_column),
        poses=np.array(pose_rows),
        points=np.array(point_rows),
        known=np.ones(n, dtype=np.bool_),
        settled=settled,
        spaced=settled,
        references=np.array(references),
        figures=figures,
    )


def _achieved(decision: Decision, i: int, psi: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the velocities of robot i's point ahead and of its body that its wheels can do of a decision."""
    v, omega = decision.velocities[i].tolist()
    if decision.of == "point":
        v, omega = body_from_point(v, omega, psi, AHEAD)
    wheels = wheels_from_body(v, omega, GTERNAL.wheel_radius, GTERNAL.wheel_base)
    ratio = feasible_ratio(*wheels, GTERNAL.wheel_radius, GTERNAL.max_wheel_speed, GTERNAL.max_speed)
    v, omega = body_from_wheels(ratio * wheels[0], ratio * wheels[1], GTERNAL.wheel_radius, GTERNAL.wheel_base)
    c, s = np.cos(psi), np.sin(psi)
    return (c * v - s * AHEAD * omega, s * v + c * AHEAD * omega), (v, omega)
