"""A simulated differential-drive robot that is as bad as a real one.

Firmware runs a speed loop on each wheel; its feedback is an encoder that counts. Between the wheels and the floor are
a gain error, a wrong base and slip. Randomness is passed in; time is passed in.
"""

import math

import numpy as np

from robofleet.vehicles.differential_drive import DifferentialDrive, arc, body_from_wheels
from robofleet.vehicles.interface import DriverReading, Imperfections, WheelSpeeds
from robofleet.vehicles.readings import TruePose

_RANDOM_BLOCK = 512
_OBEYING = (None, None)  # of wheels that turn by themselves
_AT_REST = 1e-3  # friction holds a wheel slower than this [rad/s]


class _Wheel:
    """Speed loop and encoder of one wheel."""

    __slots__ = ("_breakaway", "_counted", "_deadband", "_lag", "_resolution", "angle", "gain", "speed")

    def __init__(self, p: Imperfections, gain: float) -> None:
        self._lag, self._deadband, self._breakaway = p.motor_lag, p.deadband, p.breakaway
        self._resolution = p.speed_quantum * p.loop_period
        self._counted = 0.0  # the angle that the encoder has seen
        self.gain = gain
        self.angle = 0.0
        self.speed = 0.0

    def turn(self, command: float, top_speed: float, duration: float) -> float:
        """Advance by ``duration`` [s] and return the mean speed over it [rad/s]."""
        lag, speed, resolution = self._lag, self.speed, self._resolution
        threshold = self._deadband if speed else self._breakaway
        if -threshold < command < threshold:
            target = 0.0
            if -_AT_REST < speed < _AT_REST:
                speed = 0.0
        else:
            target = command if -top_speed <= command <= top_speed else math.copysign(top_speed, command)
        if lag:
            decay, ahead = math.exp(-duration / lag), speed - target
            mean, speed = target + ahead * (1.0 - decay) * lag / duration, target + ahead * decay
        else:
            mean = speed = target
        travelled = self.angle + mean * duration
        if resolution:
            counted = resolution * math.floor(travelled / resolution)
            # the loop acts on what it counts: what the encoder has not seen yet is missing from its feedback
            unseen = (travelled - counted) - (self.angle - self._counted)
            self._counted = counted
            if target and lag:
                speed += unseen / lag
        self.angle, self.speed = travelled, speed
        return mean

    def block(self) -> None:
        self.speed = 0.0


class Plant:
    """The robot: pose of the axle's middle [m, rad; world], wheels, battery."""

    def __init__(
        self,
        drive: DifferentialDrive,
        imperfections: Imperfections,
        pose: tuple[float, float, float],
        rng: np.random.Generator,
    ) -> None:
        p = imperfections
        left, right, base = rng.uniform(-1.0, 1.0, 3).tolist()
        self._drive, self._p, self._rng = drive, p, rng
        self._swapped = p.wiring == "swapped"
        self._left_sign = -1.0 if p.wiring in ("left_reversed", "both_reversed") else 1.0
        self._right_sign = -1.0 if p.wiring in ("right_reversed", "both_reversed") else 1.0
        self._base = drive.wheel_base * (1.0 + p.wheel_base_spread * base)
        self._left = _Wheel(p, 1.0 + p.wheel_gain_error + p.wheel_gain_spread * left)
        self._right = _Wheel(p, 1.0 + p.wheel_gain_error + p.wheel_gain_spread * right)
        self._pose = pose
        self._body = (0.0, 0.0)
        self._used = 0.0  # battery time [s]
        self._noise: list[float] = []

    def step(
        self,
        command: WheelSpeeds,
        duration: float,
        *,
        blocked: bool = False,
        slip: float = 0.0,
        runs: tuple[float | None, float | None] = _OBEYING,
    ) -> None:
        """Advance by ``duration`` > 0 [s] with constant commands.

        ``blocked`` motors stand still whatever is asked; ``slip`` is the share of the wheels' travel that is lost; the
        speeds ``runs`` are those of a left and a right wheel that turn by themselves [rad/s], None where one obeys.
        """
        self._used += duration
        if blocked:
            self._left.block()
            self._right.block()
            self._body = (0.0, 0.0)
            return
        used = min(1.0, self._used / self._p.battery_life)
        top = self._drive.max_wheel_speed * (1.0 - self._p.top_speed_sag * used)
        left, right = self._through_wires(*command)
        if runs != _OBEYING:
            left, right = (
                commanded if own is None else own for commanded, own in zip((left, right), runs, strict=True)
            )
        left = self._left.gain * self._left.turn(left, top, duration)
        right = self._right.gain * self._right.turn(right, top, duration)
        if left == 0.0 and right == 0.0:
            self._body = (0.0, 0.0)
            return
        radius = self._drive.wheel_radius
        if self._p.slip:
            turning = self._p.slip * abs(body_from_wheels(left, right, radius, self._base)[1])
            left *= 1.0 - turning * self._slip_factor()
            right *= 1.0 - turning * self._slip_factor()
        left, right = (1.0 - slip) * left, (1.0 - slip) * right
        v, omega = self._body = body_from_wheels(left, right, radius, self._base)
        self._pose = arc(*self._pose, v, omega, duration)

    def push(self, x: float, y: float) -> None:
        """Move the robot over the floor as a hand does [m; world]: its wheels skid."""
        self._pose = self._pose[0] + x, self._pose[1] + y, self._pose[2]

    @property
    def charge(self) -> float:
        """Charge of the battery [0..1]."""
        return max(0.0, 1.0 - self._used / self._p.battery_life)

    def reading(self) -> DriverReading:
        """Return what the robot's own sensors say: angles and speeds in whole counts."""
        quantum, period = self._p.speed_quantum, self._p.loop_period
        left_angle, right_angle = self._through_wires(self._left.angle, self._right.angle)
        left_speed, right_speed = self._through_wires(self._left.speed, self._right.speed)
        return DriverReading(
            _quantised(left_angle, quantum * period),
            _quantised(right_angle, quantum * period),
            _quantised(left_speed, quantum),
            _quantised(right_speed, quantum),
            self.charge,
            0,
        )

    def truth(self) -> TruePose:
        """Return the true pose and body velocity."""
        return TruePose(*self._pose, *self._body)

    def _through_wires(self, left: float, right: float) -> tuple[float, float]:
        """Return what arrives at the other end of the robot's wires, in either direction."""
        if self._swapped:
            return right, left
        return self._left_sign * left, self._right_sign * right

    def _slip_factor(self) -> float:
        if not self._noise:
            self._noise = self._rng.standard_normal(_RANDOM_BLOCK).tolist()
        return max(0.0, 1.0 + self._p.slip_noise * self._noise.pop())


def _quantised(value: float, quantum: float) -> float:
    return quantum * math.floor(value / quantum + 0.5) if quantum else value
