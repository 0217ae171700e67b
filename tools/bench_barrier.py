"""The barrier's rows of ``bench.py``: a tick of a fleet that crosses the arena, and one joint program by daqp."""

from pathlib import Path

import numpy as np
from bench_tracker import Row, percentiles, timed
from numpy.typing import NDArray

from robofleet.config.barrier import body as body_of
from robofleet.config.barrier import keepout as keepout_of
from robofleet.config.load import load_config
from robofleet.safety.barrier import Barrier
from robofleet.safety.distances import apart
from robofleet.vehicles.differential_drive import (
    arc,
    body_from_point,
    feasible_ratio,
    point_from_pose,
    wheels_from_body,
)

Array = NDArray[np.float64]

_TICKS = 1500
_PEER_EVERY = 10  # ticks
_NEAR = 0.05  # beyond the distance that is kept [m]


def rows() -> list[Row]:
    """Return the rows; ratios are to robofleet's median, or p99 where that is what the row says."""
    return [row for count in (4, 20, 50) for row in _crossing(count)]


def _crossing(count: int) -> list[Row]:
    """All robots drive to places of others; each that arrives is sent on."""
    config = load_config(Path(__file__).parents[1] / "configs" / "platoon.yaml")
    body, keepout = body_of(config, config.robots[0]), keepout_of(config)
    rng = np.random.default_rng(1)
    barrier, drive, l = Barrier(keepout, (body,) * count), body.drive, keepout.point_ahead
    cells = np.array([(x, y) for x in np.linspace(-1.4, 1.4, 10) for y in np.linspace(-0.85, 0.85, 6)])
    chosen = cells[rng.permutation(len(cells))[:count]]
    poses, goals = np.column_stack([chosen, rng.uniform(-3.0, 3.0, count)]), rng.permutation(chosen)
    unseen, driving, wheels = np.zeros(count), np.ones(count, dtype=np.bool_), np.zeros((count, 2))
    times: dict[str, list[float]] = {"robofleet": []}
    for k in range(_TICKS):
        turning, u = wheels, np.empty((count, 2))
        wheels = np.empty((count, 2))
        for i, (x, y, psi) in enumerate(poses.tolist()):
            u[i] = goals[i] - point_from_pose(x, y, psi, l)
            if np.hypot(*u[i]) < 0.05:
                goals[i] = cells[rng.integers(len(cells))]
            u[i] *= drive.max_speed / np.hypot(*u[i])
            v, omega = body_from_point(float(u[i, 0]), float(u[i, 1]), psi, l)
            wheel_speeds = wheels_from_body(v, omega, drive.wheel_radius, drive.wheel_base)
            ratio = feasible_ratio(*wheel_speeds, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
            u[i], wheels[i] = ratio * u[i], ratio * np.array(wheel_speeds)
        if k % _PEER_EVERY == 0:
            _joint(times, poses, u, apart(keepout, body, body), config.controller.barrier.rate_per_s)
        times["robofleet"].append(timed(barrier.filter, poses, turning, unseen, driving, wheels, u)[0])
        for i, (left, right) in enumerate(wheels.tolist()):
            v, omega = drive.wheel_radius * (left + right) / 2, drive.wheel_radius * (right - left) / drive.wheel_base
            x, y, psi = poses[i].tolist()
            poses[i] = arc(x, y, psi, v, omega, keepout.tick)
    return list(percentiles(f"barrier, a tick of {count} robots", times))


def _joint(times: dict[str, list[float]], poses: Array, u: Array, distance: float, rate: float) -> None:
    """Time daqp on the dense program of all robots' velocities, near pairs only; its rows are there already."""
    try:
        import daqp  # noqa: PLC0415
    except ImportError:
        return
    n = len(poses)
    delta = poses[:, None, :2] - poses[None, :, :2]
    apart_m = np.linalg.norm(delta, axis=-1)
    first, other = np.nonzero(np.triu(apart_m < distance + _NEAR, 1))
    pairs, limits = np.zeros((len(first), n, 2)), np.zeros((4 * n, n, 2))
    normal = delta[first, other] / np.maximum(apart_m[first, other], 1e-6)[:, None]
    index = np.arange(len(first))
    pairs[index, first], pairs[index, other] = -normal, normal
    turn = 0.105 / 2 / 0.08
    for i, psi in enumerate(poses[:, 2]):
        e, across = np.array((np.cos(psi), np.sin(psi))), np.array((-np.sin(psi), np.cos(psi)))
        limits[4 * i : 4 * i + 4, i] = e + turn * across, e - turn * across, -e + turn * across, -e - turn * across
    a = np.concatenate([limits, pairs]).reshape(-1, 2 * n)
    upper = np.concatenate([np.full(4 * n, 0.2), np.maximum(rate * (apart_m[first, other] - distance), 0.0)])
    lower, sense, weight = np.full(len(upper), -1e30), np.zeros(len(upper), dtype=np.int32), np.eye(2 * n)
    linear = -u.ravel()
    times.setdefault("daqp, one joint program, the solver alone", []).append(
        timed(daqp.solve, weight, linear, a, upper, lower, sense)[0]
    )
