"""A group of GTernals that a behaviour drives through the interface, with nothing around it: no bus, no barrier."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from robofleet.behaviours import Behaviour, Decision, Flow, Past, Situation, Team
from robofleet.behaviours.interface import Array, Pose
from robofleet.safety.distances import Body, Keepout
from robofleet.vehicles.differential_drive import (
    arc,
    body_from_point,
    body_from_wheels,
    feasible_ratio,
    wheels_from_body,
)
from tests.robots import GTERNAL

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
    """Return a group of n robots, r1 to rn, with the paper's parameters."""
    body = Body(GTERNAL, 0.055, 0.002)
    return Team(
        name="group", robots=tuple(f"r{k + 1}" for k in range(n)), drives=(GTERNAL,) * n, bodies=(body,) * n,
        starts=tuple(starts or [None] * n), bystanders=(), keepout=KEEPOUT, arena=ARENA, tick=tick, delay=0.002,
        point_ahead=AHEAD, flow=Flow(45.0, 0.6, "exact"), rng=np.random.default_rng(1),
    )  # fmt: skip


def made(kind: type[Behaviour], settings: dict[str, Any], group: Team) -> Behaviour:
    """Return a behaviour from settings as a configuration has them."""
    return kind(kind.Settings.model_validate(settings), group)


def situation(poses: Array, t: float = 0.0, wind: tuple[float, float] = (0.0, 0.0)) -> Situation:
    """Return a situation in which all may drive; ``wind``: the disturbance that is told [m/s]."""
    n = len(poses)
    return Situation(
        t=t,
        poses=np.array(poses),
        driving=np.ones(n, dtype=np.bool_),
        disturbance=np.tile(np.array(wind), (n, 1)),
        others=np.empty((0, 3)),
    )


def driven(behaviour: Behaviour, poses: Array, seconds: float, *, wind: tuple[float, float] = (0.0, 0.0)) -> Past:
    """Drive a behaviour, and return what became of it.

    The robots are ideal: their wheels do at once what they are asked for, as far as they can. ``wind`` moves every
    robot beside [m/s; world]; the behaviour is told.
    """
    group, poses = behaviour.team, np.array(poses, dtype=np.float64)
    n, tick = len(group), group.tick
    behaviour.restart()
    past: list[tuple[float, Array, Array, Decision]] = []
    for k in range(round(seconds / tick)):
        t = k * tick
        now = situation(poses, t, wind)
        decision = behaviour.decide(now)
        past.append((t, poses.copy(), now.points(AHEAD), decision))
        asked = np.empty((n, 2))
        for i, (x, y, psi) in enumerate(poses.tolist()):
            asked[i], (v, omega) = does(decision, i, psi)
            poses[i] = arc(x, y, psi, v, omega, tick)
        poses[:, :2] += tick * np.array(wind)
        behaviour.changed(asked)
    t, everywhere, points, decisions = (list(column) for column in zip(*past, strict=True))
    settled = np.array(t) > seconds / 2
    nothing = np.full((n, 2), np.nan)
    references = np.array([nothing if d.references is None else d.references for d in decisions])
    figures = {
        f.name: np.array([np.broadcast_to(d.figures.get(f.name, np.nan), n) for d in decisions])
        for f in behaviour.figures
    }
    return Past(
        t=np.array(t),
        poses=np.array(everywhere),
        points=np.array(points),
        known=np.ones(n, dtype=np.bool_),
        settled=settled,
        spaced=settled,
        references=references,
        figures=figures,
    )


def does(decision: Decision, i: int, psi: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the velocity of a robot's point ahead, and its body's, that its wheels can do of a decision."""
    v, omega = decision.velocities[i].tolist()
    if decision.of == "point":
        v, omega = body_from_point(v, omega, psi, AHEAD)
    wheels = wheels_from_body(v, omega, GTERNAL.wheel_radius, GTERNAL.wheel_base)
    ratio = feasible_ratio(*wheels, GTERNAL.wheel_radius, GTERNAL.max_wheel_speed, GTERNAL.max_speed)
    v, omega = body_from_wheels(ratio * wheels[0], ratio * wheels[1], GTERNAL.wheel_radius, GTERNAL.wheel_base)
    c, s = np.cos(psi), np.sin(psi)
    return (c * v - s * AHEAD * omega, s * v + c * AHEAD * omega), (v, omega)


def refused(behaviour: Behaviour) -> list[str]:
    """Return what is refused of a behaviour, each with its key."""
    broken = [f"{bound.path}: {bound.what} {bound.mend}" for bound in behaviour.bounds() if not bound.holds]
    return [f"{key}: {message}" for key, message in behaviour.refusals()] + broken
