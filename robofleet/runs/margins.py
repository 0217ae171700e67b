"""What the configured loop of a robot bears that its controller does not know of: delay, motor lag, wheel radius.

The loop is the one that runs: poses at the camera's instants, the fleet filter with its steady gain, the prediction to
the moment when the commands act, the flow of the point ahead (eq. 31), the wheels with their lag. It is linearised
about straight driving at a speed: there, in the frame that moves along, nothing of it changes with time.
"""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from robofleet.config import groups, slices
from robofleet.config.controller import FilterSettings
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.control.flow import integrator_gain
from robofleet.control.margins import MOST_DELAY, MOST_LAG, Margins, Motion, SampledLoop
from robofleet.core.arrays import Array
from robofleet.core.clock import S

_SETTLED_STEPS = 3000  # of the filter: its slowest part forgets within tens of seconds
_MOST_UNDER_WAY = 30  # commands, of which the controller's state holds each
_POSE, _WHEELS, _INPUT = slice(0, 5), slice(5, 7), slice(7, 9)  # of the controller's state; then the commands


def margin_rows(config: Config) -> Iterator[tuple[str, str, str, str]]:
    """Yield what a table of proofs says of the margins, the least of any robot: what, value, limit, note."""
    every = [margins for _, margins in _fastest(config)]
    if not every:
        return
    tick = config.controller.tick_s
    delay, lag = min(m.delay for m in every), min(m.lag for m in every)
    low, high = max(m.gain[0] for m in every), min(m.gain[1] for m in every)
    yield "the unknown delay that the loop tolerates at top speed", _shown(delay, MOST_DELAY * tick), "", ""
    yield "the unknown motor lag that it tolerates", _shown(lag, MOST_LAG * tick), "", ""
    yield "the true wheel radius that it tolerates", f"{1.0 + low:.2f} to {1.0 + high:.2f} times", "", ""


def margin_warnings(config: Config) -> Iterator[str]:
    """Yield the robots whose loop is unstable even if all is as configured, a line each."""
    for robot, margins in _fastest(config):
        if margins.delay == 0.0:
            yield (
                f"the loop of {robot.id} is unstable at its top speed, {robot.vehicle.max_speed_m_s:g} m/s: "
                "raise controller.horizon_s"
            )


def _fastest(config: Config) -> list[tuple[Robot, Margins]]:
    """Return the margins of one robot of each kind that the flow drives, at its top speed: the least of any speed."""
    members = itertools.chain.from_iterable(
        group.robots
        for group, behaviour in zip(config.groups, groups.behaviours(config), strict=True)
        if behaviour.by_point_flow()
    )
    kinds: dict[object, Robot] = {}
    for robot in map(config.robot, members):
        if image_age_s(config) + slices.delay_ns(config, robot) / S > _MOST_UNDER_WAY * config.controller.tick_s:
            return []  # it would take too long
        kinds.setdefault((slices.drive(robot), slices.delay_ns(config, robot)), robot)
    return [(robot, robot_loop(config, robot, robot.vehicle.max_speed_m_s).margins()) for robot in kinds.values()]


def _shown(duration: float, most: float) -> str:
    return f"{1e3 * duration:.0f} ms" if math.isfinite(duration) else f"over {1e3 * most:.0f} ms"


def robot_loop(config: Config, robot: Robot, speed: float) -> SampledLoop:
    """Return the loop of a robot that drives straight at ``speed`` [m/s], as the controller believes it to be.

    The plant's state is x, y [m], psi [rad] beside the reference, its input the wheels' commands [rad/s].
    """
    c, drive = config.controller, slices.drive(robot)
    h, l, T = c.tick_s, c.point_ahead_m, c.horizon_s
    gain = integrator_gain(c.alpha, h, c.integrator)
    delay = image_age_s(config) + slices.delay_ns(config, robot) / S
    A, B = np.zeros((3, 3)), np.zeros((3, 2))
    A[1, 2] = speed
    B[0], B[2] = drive.wheel_radius / 2.0, drive.wheel_radius / drive.wheel_base * np.array([-1.0, 1.0])
    believed, noise = np.zeros((5, 5)), c.filter_in_force
    believed[:3, :3] = A
    believed[:3, 3:] = speed / drive.wheel_radius * B  # what wrong efficiencies of the wheels do
    believed[3:, 3:] = -np.eye(2) / noise.efficiency_time_s
    motion = Motion(believed, np.pad(B, ((0, 2), (0, 0))), drive.motor_lag)
    whole, part = divmod(delay, h)
    commands = [slice(9 + 2 * k, 11 + 2 * k) for k in range(int(whole) + 1)]  # under way, oldest first
    now = np.eye(commands[-1].stop + 3)  # rows: the controller's state, then the measured pose
    correction = _filter_gain(believed, noise, h) @ (now[-3:] - now[:3])
    z = np.concatenate([now[_POSE] + correction, now[_WHEELS]])[: motion.states]
    acting = motion.after(z, now[commands[0]], part)
    for command in commands[1:]:
        acting = motion.after(acting, now[command], h)
    point = np.array([acting[0], acting[1] + l * acting[2]])
    efficiencies = believed[[0, 2], 3:] @ acting[3:5]
    disturbance = np.array([efficiencies[0], l * efficiencies[1]])
    u = now[_INPUT] - gain * (point / T + disturbance + now[_INPUT])
    v, omega = u[0], (u[1] - speed * acting[2]) / l
    wheels = np.array([v - omega * drive.wheel_base / 2.0, v + omega * drive.wheel_base / 2.0]) / drive.wheel_radius
    sent = [*(now[command] for command in commands), wheels]
    z = motion.after(motion.after(z, sent[0], part), sent[1], h - part)
    z = np.concatenate([z, np.zeros((7 - motion.states, len(now)))]) if motion.states < 7 else z
    after = np.concatenate([z[:7], u, *sent[1:]])
    return SampledLoop(A, B, after[:, :-3], after[:, -3:], np.eye(len(after))[-2:], h, delay, drive.motor_lag)


def image_age_s(config: Config) -> float:
    """Return how long before a tick the poses were measured that it decides by."""
    source = config.tracker.source
    if source in ("camera", "truth") and config.camera.trigger == "tick":
        return config.camera.trigger_lead_s
    return config.controller.tick_s / 2.0 + (config.tracker.mocap.latency_s if source == "mocap" else 0.0)


def _filter_gain(believed: Array, noise: FilterSettings, h: float) -> Array:
    """Return the Kalman gain (5, 3) that the fleet filter comes to while a robot drives straight."""
    phi = Motion(believed, np.zeros((5, 1)), 0.0).after(np.eye(5), np.zeros((1, 5)), h)
    drift = np.array([noise.position_drift_m, noise.position_drift_m, noise.heading_drift_rad]) ** 2 * h
    wander = noise.efficiency_sigma**2 * (1.0 - phi[3:, 3:].diagonal() ** 2)
    r = np.diag([noise.position_noise_m, noise.position_noise_m, noise.heading_noise_rad]) ** 2
    p = np.diag([*r.diagonal(), *[noise.efficiency_sigma**2] * 2])
    gain = np.zeros((5, 3))
    for _ in range(_SETTLED_STEPS):
        p = phi @ p @ phi.T + np.diag([*drift, *wander])
        gain = np.linalg.solve(p[:3, :3] + r, p[:3]).T
        p = p - gain @ p[:3]
        p = (p + p.T) / 2.0
    return gain
