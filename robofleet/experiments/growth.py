"""Closed loops in simulation, with a delay that their controller does not know of: does a small error grow or die away.

The oracle of ``control/margins.py``: the nonlinear plants, the flow's and the filter's own code, no linearisation.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from robofleet.config import slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.control import wheels
from robofleet.control.flow import FlowError, NewtonRaphsonFlow, Plant
from robofleet.control.point import PointFlow
from robofleet.control.prediction import compile_plant
from robofleet.core.arrays import Array
from robofleet.core.clock import S
from robofleet.runs.margins import image_age_s
from robofleet.tracking.filter.estimator import FleetFilter
from robofleet.vehicles import plant as plants
from robofleet.vehicles.interface import Imperfections, WheelSpeeds

_PUSH = 1e-5  # of each state, or of a robot's reference to its left [m]
_START_S = 10.0  # a robot's reference gathers speed, then it is pushed
_FLOOR = 1e-10  # an error this small has died away: rounding is left
_RUNAWAY = 1e4  # times the push
_WIDTHS = (1.06, 1.3, 2.0)
_BORDER_RATIO = 1.004
_IDEAL_PERIOD_S = 0.005  # steps of a simulated robot


def flow_growth(flow: NewtonRaphsonFlow, truth: Plant, x: Array, duration: float, delay: float) -> float:
    """Return how much a flow's control error grows from the third to the last tenth of a simulation.

    truth: the plant as it is, which may have more states than the flow knows of, its own first. x (n,): where it moves
    straight with u = 0, before a push of all states. duration, and the unknown delay [s].
    """
    known, s, m = flow.plant.n, flow.settings, flow.plant.m
    rollout, none = compile_plant(truth).rollout, np.zeros(truth.n)
    whole, part = divmod(s.delay + delay, s.step)
    under_way = [np.zeros(m) for _ in range(int(whole) + 1)]
    velocity = flow.plant.f(x[:known], np.zeros(m))
    start, x = x[:known].copy(), x + _PUSH
    errors: list[float] = []
    for k in range(round(duration / s.step)):
        ahead = flow.plant.h(start + (k * s.step + s.delay + s.horizon) * velocity)
        try:
            under_way.append(flow.update(x[:known], ahead))
        except FlowError:
            return math.inf
        errors.append(flow.control_error)
        if not errors[-1] < _RUNAWAY * _PUSH:
            return math.inf
        if part > 0.0:
            rollout(x, under_way[0], none, part, x)
        del under_way[0]
        rollout(x, under_way[0], none, s.step - part, x)
    return _growth(np.array(errors))


def robot_growth(config: Config, robot: Robot, speed: float, duration: float, delay: float) -> float:
    """Return the same of a robot under the fleet's filter and the flow of its point ahead, which drives straight.

    The robot is ideal but for its motor lag, the poses are without noise, and wheels have no limits.
    """
    c, drive = config.controller, slices.drive(robot)
    noise = c.filter_in_force.model_copy(update={"gate_sigma": 1e6})
    known_ns, tick_ns, age_ns = slices.delay_ns(config, robot), round(c.tick_s * S), round(image_age_s(config) * S)
    fleet, law = FleetFilter((drive,), (known_ns,), noise), PointFlow(1, c.alpha, c.horizon_s, c.tick_s, c.integrator)
    imperfections = _ideal(drive.motor_lag, (age_ns + known_ns) / S + delay)
    unlimited = replace(drive, max_wheel_speed=math.inf)
    plant = plants.Plant(unlimited, imperfections, (0.0, 0.0, 0.0), np.random.default_rng(0), now_ns=S)
    geometry = np.array([[drive.wheel_radius, drive.wheel_base, np.inf, np.inf]])
    driving, of_body, l = np.array([True]), np.array([False]), c.point_ahead_m
    errors: list[float] = []
    for k in range(round((_START_S + duration) / c.tick_s)):
        now_ns = S + k * tick_ns
        plant.advance(now_ns)
        truth = plant.truth()
        fleet.observe(np.array([now_ns]), np.array([[truth.x, truth.y, truth.psi]]))
        poses = fleet.predict(now_ns + age_ns)[1]
        points = poses[:, :2] + l * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        t = k * c.tick_s
        ahead = np.array([[l + _gathered(speed, t + (age_ns + known_ns) / S + c.horizon_s), _PUSH * (t > _START_S)]])
        w = fleet.disturbance(poses, l) if c.disturbance == "estimated" else np.zeros((1, 2))
        u, _ = law.update(points, ahead, driving, w)
        if t > _START_S:
            errors.append(float(abs(points[0, 1] - _PUSH)))
            if not errors[-1] < _RUNAWAY * _PUSH:
                return math.inf
        request = wheels.limited(u, of_body, poses, l, geometry, driving)
        fleet.command(now_ns + age_ns, request.wheels)
        plant.write(WheelSpeeds(*request.wheels[0].tolist()))
    return _growth(np.array(errors))


def _gathered(speed: float, t: float) -> float:
    """Return the way of a reference that gathers speed evenly, then keeps it [m]."""
    return speed * (t - _START_S / 2.0) if t > _START_S else speed * t * t / (2.0 * _START_S)


def _growth(errors: Array) -> float:
    tenth = len(errors) // 10
    return float(errors[-tenth:].max() / max(errors[2 * tenth : 3 * tenth].max(), _FLOOR))


def delay_border(growth: Callable[[float], float], near: float) -> float:
    """Return the least delay [s] with which errors grow, by bisection; NaN: it is not within a factor of two.

    A loop may be stable again with a longer delay: the border is sought close by first.
    """
    for width in _WIDTHS if near else ():
        low, high = near / width, 0.99 * width * near  # not symmetric: bisection does not meet ``near``
        if growth(low) > 1.0 or growth(high) <= 1.0:
            continue
        while high / low > _BORDER_RATIO:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if growth(middle) > 1.0 else (middle, high)
        return math.sqrt(low * high)
    return math.nan


def _ideal(motor_lag: float, delay: float) -> Imperfections:
    return Imperfections(
        motor_lag=motor_lag, speed_quantum=0.0, loop_period=_IDEAL_PERIOD_S, deadband=0.0, breakaway=0.0,
        wheel_gain_spread=0.0, wheel_base_spread=0.0, slip=0.0, slip_noise=0.0, top_speed_sag=0.0, battery_life=1e9,
        actuation_delay=delay,
    )  # fmt: skip
