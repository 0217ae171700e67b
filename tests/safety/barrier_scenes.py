"""Scenes for the barrier, and its oracle: rows by numerical differentiation, solved by daqp."""

import math
from typing import NamedTuple

import daqp
import numpy as np

from robofleet.safety.barrier import Barrier, Filtered
from robofleet.safety.distances import Body, Keepout, apart, from_edge
from robofleet.vehicles.differential_drive import arc, body_from_wheels, wheels_from_body
from tests.robots import GTERNAL

BODY = Body(GTERNAL, 0.055, 0.002)
KEEPOUT = Keepout(
    gap=0.01, ahead=0.01, rate=10.0, pose_error=0.002, age=0.133, lost_after=0.5, point_ahead=0.08, tick=0.033,
    arena=(3.2, 2.0),
)  # fmt: skip
D, L = apart(KEEPOUT, BODY, BODY), KEEPOUT.point_ahead

Array = np.ndarray


class Scene(NamedTuple):
    """Robots, how their wheels turn, and what they are asked for."""

    poses: Array
    turning: Array
    wheels: Array

    @property
    def n(self) -> int:
        return len(self.poses)


def body(wheels: Array) -> tuple[float, float]:
    return body_from_wheels(*wheels.tolist(), GTERNAL.wheel_radius, GTERNAL.wheel_base)


def feasible(wheels: Array) -> Array:
    """Scale wheels so that the robot can do them."""
    fastest = max(np.abs(wheels).max() / 12.5, abs(body(wheels)[0]) / 0.2, 1.0)
    return wheels / fastest


def scene(seed: int, n: int = 5, reach: float = 0.35) -> Scene:
    """Return robots that are close together, some within D of each other, anywhere in the arena."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform((-1.55, -0.95), (1.55, 0.95))
    at = np.clip(middle + rng.uniform(-reach, reach, (n, 2)), (-1.545, -0.945), (1.545, 0.945))
    wheels = np.array([feasible(row) for row in rng.uniform(-14, 14, (2 * n, 2))])
    return Scene(np.column_stack([at, rng.uniform(-math.pi, math.pi, n)]), wheels[:n], wheels[n:])


def answer(
    s: Scene, barrier: Barrier | None = None, unseen: Array | None = None, driving: Array | None = None
) -> Filtered:
    barrier = barrier or Barrier(KEEPOUT, (BODY,) * s.n)
    return barrier.filter(
        s.poses, s.turning, np.zeros(s.n) if unseen is None else unseen,
        np.ones(s.n, dtype=np.bool_) if driving is None else driving, s.wheels, velocities(s.poses, s.wheels),
    )  # fmt: skip


def velocities(poses: Array, wheels: Array) -> Array:
    """Return u (N, 2) of the points p."""
    found = []
    for (_, _, psi), row in zip(poses, wheels, strict=True):
        v, omega = body(row)
        c, s = math.cos(psi), math.sin(psi)
        found.append((c * v - s * L * omega, s * v + c * L * omega))
    return np.array(found)


def stop_point(pose: Array, turning: Array) -> Array:
    """Return q where a robot comes to rest, its wheels' speeds decaying: step by step."""
    x, y, psi = pose.tolist()
    left = np.exp(-np.linspace(0.0, 40.0, 80))  # of the wheels' speeds
    v, omega = body(turning * GTERNAL.motor_lag)
    for share in (left[:-1] - left[1:]).tolist():
        x, y, psi = arc(x, y, psi, v, omega, share)
    return np.array([x + KEEPOUT.ahead * math.cos(psi), y + KEEPOUT.ahead * math.sin(psi)])


def stop_velocity(pose: Array, turning: Array, wheels: Array) -> Array:
    """Return q' under a command, by letting the robot follow it for a moment."""
    moment = 1e-4
    between = wheels + (turning - wheels) * math.exp(-moment / 2 / GTERNAL.motor_lag)
    after = wheels + (turning - wheels) * math.exp(-moment / GTERNAL.motor_lag)
    moved = np.array(arc(*pose.tolist(), *body(between), moment))
    return (stop_point(moved, after) - stop_point(pose, turning)) / moment


class Rows(NamedTuple):
    """A z <= b for one robot's z = (v, l omega): limits, then edges and pairs."""

    a: Array
    b: Array


def rows(s: Scene, i: int, apart_m: float = D) -> Rows:
    """Return a robot's rows by numerical differentiation of where it would stop."""
    at = [stop_point(pose, turning) for pose, turning in zip(s.poses, s.turning, strict=True)]
    units = [
        np.array(wheels_from_body(v, omega, GTERNAL.wheel_radius, GTERNAL.wheel_base))
        for v, omega in ((0.1, 0), (0, 0.1 / L))
    ]
    moves = np.array([stop_velocity(s.poses[i], s.turning[i], unit) for unit in units]).T / 0.1
    turn = GTERNAL.wheel_base / 2 / L
    a = [(g, g * h) for g in (1, -1) for h in (turn, -turn, 0)]
    b = [GTERNAL.wheel_radius * 12.5, GTERNAL.wheel_radius * 12.5, 0.2] * 2
    for out, half in (((1, 0), 1.6), ((-1, 0), 1.6), ((0, 1), 1.0), ((0, -1), 1.0)):
        a.append(tuple(np.array(out) @ moves))
        b.append(max(KEEPOUT.rate * (half - from_edge(KEEPOUT, BODY) - np.array(out) @ at[i]), -0.1))
    for j in range(s.n):
        if j != i:
            distance = float(np.linalg.norm(at[j] - at[i]))
            a.append(tuple((at[j] - at[i]) / distance @ moves))
            b.append(max(KEEPOUT.rate * (distance - apart_m) / 2, -0.1))  # withdrawing at half its top speed at most
    return Rows(np.array(a, dtype=float), np.array(b, dtype=float))


def nearest(r: Rows, z: Array) -> Array | None:
    """Return daqp's answer; None if there is none."""
    found, _, flag, _ = daqp.solve(
        np.eye(2), -z, r.a, r.b, np.full(len(r.b), -1e30), np.zeros(len(r.b), dtype=np.int32)
    )
    return np.array(found) if flag == 1 else None


def face_to_face(distance: float, n: int = 2) -> Scene:
    """Return robots in a row that all drive at the middle."""
    poses = [(k * distance, 0.0, 0.0 if k < n / 2 else math.pi) for k in range(n)]
    return Scene(np.array(poses), np.zeros((n, 2)), np.full((n, 2), 5.0))
