"""Steering laws from the nearest point of the curve, in plain Python: LQR with curvature feed-forward, pure pursuit,
Stanley. The speed is held by one proportional law for all three.
"""

import math
from dataclasses import dataclass

import numpy as np

from robofleet.core.arrays import Array
from robofleet.experiments.baselines.problem import Input, Problem
from robofleet.vehicles.bicycle import BicycleParameters

_RICCATI_ROUNDS, _RICCATI_BOUND = 100_000, 1e100
_TAYLOR_TERMS = 20


@dataclass(frozen=True)
class Nearest:
    """The nearest point of the curve, seen from a point of the vehicle."""

    along: float  # arc length [m]
    lateral: float  # e_y, of the vehicle, + left of the curve [m]
    heading: float  # e_psi = psi - tangent [rad]


class _Follower:
    """Keeps its place along the curve from update to update."""

    def __init__(self, problem: Problem, speed_gain: float) -> None:
        """``speed_gain`` [1/s]: a_l = speed_gain (v + speed_gain (s_target - s) / 4 - v_l), critically damped."""
        self.problem, self._gain, self._along = problem, speed_gain, 0.0

    def nearest(self, z: Array, psi: float) -> Nearest:
        """Return the nearest point to z (2,) [m], as seen with the heading psi [rad]."""
        lateral, heading, along = self.problem.reference.errors(z[None], np.array([psi]), self._along)
        self._along = float(along[0])
        return Nearest(self._along, float(lateral[0]), float(heading[0]))

    def curvature(self, at: Nearest) -> float:
        """Return the curve's curvature there [1/m], from the headings of the samples beside it."""
        r = self.problem.reference
        samples = len(r.headings) - 1
        i = math.floor(at.along / r.spacing)
        i = i % samples if r.closed else min(max(i, 0), samples - 1)
        return float(r.headings[i + 1] - r.headings[i]) / r.spacing

    def acceleration(self, t: float, x: Array, along: float) -> float:
        """Return a_l [m/s^2] that keeps ``along`` at speed * t."""
        v, k = self.problem.speed, self._gain
        return k * (v + k / 4.0 * (v * t - along) - float(x[2]))


class CurvatureLqr(_Follower):
    """Discrete LQR on (e_y, e_y', e_psi, e_psi') with the steady steering for the curvature.

    At constant speed v and curvature kappa the bicycle settles with e_psi = -beta, its side-slip, and the steering
    delta = kappa (l_f + l_r) + (alpha_f - alpha_r); the feedback acts on the difference from that.
    """

    name = "LQR feed-forward"

    def __init__(self, problem: Problem, speed_gain: float, weights: tuple[float, float, float, float]) -> None:
        """``weights``: of the four errors, the steering's is 1."""
        super().__init__(problem, speed_gain)
        m, v = problem.model, problem.speed
        self._gain_k = lqr(*_lateral(m, v, problem.step), np.diag(weights))
        length = m.front_axle + m.rear_axle
        load = m.mass * v * v / (2.0 * length)  # of one tyre at curvature 1, times the other axle's arm [N m]
        rear = load * m.front_axle / m.rear_stiffness  # slip angle of the rear axle over curvature [rad m]
        self._steering = length + load * m.rear_axle / m.front_stiffness - rear
        self._heading = rear - m.rear_axle  # e_psi over curvature

    def update(self, t: float, x: Array) -> Input:
        """Return the input; e_y' = v_n cos e_psi + v_l sin e_psi, e_psi' = psi' - kappa v."""
        at = self.nearest(x[:2], float(x[4]))
        v, k = self.problem.speed, self._gain_k
        kappa = self.curvature(at)
        sideways = float(x[3]) * math.cos(at.heading) + float(x[2]) * math.sin(at.heading)
        feedback = k[0] * at.lateral + k[1] * sideways
        feedback += k[2] * (at.heading - self._heading * kappa) + k[3] * (float(x[5]) - kappa * v)
        return self.acceleration(t, x, at.along), self._steering * kappa - float(feedback)


class PurePursuit(_Follower):
    """Steers the rear axle along the circle to a point of the curve ahead: delta = atan(2 L sin(eta) / distance)."""

    name = "pure pursuit"

    def __init__(self, problem: Problem, speed_gain: float, look_ahead: float) -> None:
        """``look_ahead`` [s]: the point is that much of the speed ahead of the rear axle, along the curve."""
        super().__init__(problem, speed_gain)
        self._ahead = look_ahead * problem.speed

    def update(self, t: float, x: Array) -> Input:
        """Return the input; eta is the bearing of the point from the rear axle."""
        m, psi = self.problem.model, float(x[4])
        rear = x[:2] - m.rear_axle * np.array([math.cos(psi), math.sin(psi)])
        at = self.nearest(rear, psi)
        aim = self.problem.reference.position(np.array([max(0.0, at.along + self._ahead)]))[0] - rear
        distance = math.hypot(aim[0], aim[1])
        bearing = math.atan2(aim[1], aim[0]) - psi
        steering = math.atan(2.0 * (m.front_axle + m.rear_axle) * math.sin(bearing) / distance)
        return self.acceleration(t, x, at.along + m.rear_axle), steering


class Stanley(_Follower):
    """Steers the front axle: delta = -e_psi - atan(gain e_y / v_l) - damping (psi' - kappa v)."""

    name = "Stanley"

    def __init__(self, problem: Problem, speed_gain: float, gain: float, damping: float) -> None:
        """``gain`` [1/s] of the front axle's lateral error, ``damping`` [s] of the yaw rate's."""
        super().__init__(problem, speed_gain)
        self._k, self._damping = gain, damping

    def update(self, t: float, x: Array) -> Input:
        m, psi = self.problem.model, float(x[4])
        front = x[:2] + m.front_axle * np.array([math.cos(psi), math.sin(psi)])
        at = self.nearest(front, psi)
        steering = -at.heading - math.atan(self._k * at.lateral / float(x[2]))
        steering -= self._damping * (float(x[5]) - self.curvature(at) * self.problem.speed)
        return self.acceleration(t, x, at.along - m.front_axle), steering


def _lateral(m: BicycleParameters, v: float, step: float) -> tuple[Array, Array]:
    """Return A (4, 4), B (4, 1) of the sampled lateral error dynamics at speed v [m/s]; step [s]."""
    front, rear = 2.0 * m.front_stiffness, 2.0 * m.rear_stiffness
    moment = m.front_axle * front - m.rear_axle * rear
    turning = m.front_axle**2 * front + m.rear_axle**2 * rear
    joint = np.zeros((5, 5))  # (A B; 0 0), whose exponential holds both sampled
    joint[0, 1] = joint[2, 3] = 1.0
    joint[1, 1:] = -(front + rear) / (m.mass * v), (front + rear) / m.mass, -moment / (m.mass * v), front / m.mass
    joint[3, 1:4] = np.array([-moment / v, moment, -turning / v]) / m.yaw_inertia
    joint[3, 4] = m.front_axle * front / m.yaw_inertia
    term = sampled = np.eye(5)
    for n in range(1, _TAYLOR_TERMS):
        term = term @ joint * (step / n)
        sampled = sampled + term
    return sampled[:4, :4], sampled[:4, 4:]


def lqr(A: Array, B: Array, Q: Array) -> Array:
    """Return K (n,) of u = -K x that minimises the sum of x'Qx + u^2, by iterating the discrete Riccati equation.

    Raises:
        ValueError: it does not settle.
    """
    P = Q.copy()
    for _ in range(_RICCATI_ROUNDS):
        K = np.linalg.solve(np.eye(B.shape[1]) + B.T @ P @ B, B.T @ P @ A)
        after = Q + A.T @ P @ (A - B @ K)
        if np.abs(after - P).max() <= 1e-10 * np.abs(after).max():
            return np.asarray(K[0])
        if np.abs(after).max() > _RICCATI_BOUND:
            break
        P = after
    raise ValueError("the Riccati equation does not settle: the pair (A, B) cannot be stabilised, or Q is too small")
