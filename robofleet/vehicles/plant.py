"""A simulated differential-drive robot that is as bad as a real one: the one place of its equations.

Firmware runs a speed loop on each wheel; its feedback is an encoder that counts. Between the wheels and the floor are
a gain error, a wrong base and slip. Randomness is passed in; time is passed in.

The functions are plain Python: a :class:`Plant` runs them for one robot and needs no numba. ``simulation/bodies.py``
compiles the same functions for rows of arrays.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robofleet.vehicles.differential_drive import DifferentialDrive, arc, body_from_wheels, floor
from robofleet.vehicles.interface import BodyTrouble, DriverReading, Imperfections, WheelSpeeds
from robofleet.vehicles.readings import TruePose

NEVER_NS = (1 << 63) - 1
WATCHDOG_NS = 200_000_000  # without a command for so long the firmware of ``drivers/simulated.py`` stops the motors
RANDOM_BLOCK = 512  # random numbers that are drawn at once
DRAWS = 2  # random numbers of one step

_NS = 1e-9
_AT_REST = 1e-3  # friction holds a wheel slower than this [rad/s]
_COMMANDS = 64  # that are under way to a robot without delay; more for each second of it
_COMMANDS_HZ = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Build:
    """How a robot was built: its imperfections, with what was drawn of them. Units as in ``Imperfections``."""

    wheel_radius: float
    wheel_base: float
    max_wheel_speed: float
    motor_lag: float
    stop_lag: float
    speed_quantum: float
    loop_period: float
    deadband: float
    breakaway: float
    slip: float
    slip_noise: float
    top_speed_sag: float
    battery_life: float
    left_gain: float  # travel of a wheel, relative to what it should be
    right_gain: float
    left_sign: float  # of a wheel's wires
    right_sign: float
    swapped: bool  # the wheels' wires
    longest_step_ns: int
    delay_ns: int


@dataclass(slots=True, kw_only=True)
class Body:
    """A robot's state: pose [m, rad; world], body velocity, wheels, battery, and what is wrong with it now.

    It is not frozen: a step changes it in place, as it changes a row of an array.
    """

    x: float
    y: float
    psi: float
    v: float = 0.0
    omega: float = 0.0
    used: float = 0.0  # battery time [s]
    left_angle: float = 0.0
    left_speed: float = 0.0
    left_counted: float = 0.0  # the angle that the encoder has seen
    left_command: float = 0.0
    right_angle: float = 0.0
    right_speed: float = 0.0
    right_counted: float = 0.0
    right_command: float = 0.0
    reached_ns: int  # time has passed until then
    off_ns: int = NEVER_NS  # when the firmware's watchdog stops the motors
    first: int = 0  # place of the oldest command that does not act yet
    waiting: int = 0  # how many of them there are
    drawn: int = 0  # random numbers that were used
    stuck: bool = False  # this line and the next two: as BodyTrouble
    slip: float = 0.0
    left_runs: float = math.nan  # NaN: this wheel obeys
    right_runs: float = math.nan
    pushed_x: float = 0.0
    pushed_y: float = 0.0
    faults: int = 0  # that it reports, as RobotFault
    low_charge: float = math.nan  # that it reports instead of its battery's; NaN: none


@dataclass(slots=True, kw_only=True)
class Coming:
    """A command that does not act yet [rad/s]."""

    at_ns: int = 0
    left: float = 0.0
    right: float = 0.0


def built(drive: DifferentialDrive, imperfections: Imperfections, rng: np.random.Generator) -> Build:
    """Return a robot of a kind, with errors that are drawn once."""
    p = imperfections
    left, right, base = rng.uniform(-1.0, 1.0, 3).tolist()
    return Build(
        wheel_radius=drive.wheel_radius,
        wheel_base=drive.wheel_base * (1.0 + p.wheel_base_error + p.wheel_base_spread * base),
        max_wheel_speed=drive.max_wheel_speed * (1.0 + p.top_speed_error), motor_lag=p.motor_lag,
        stop_lag=p.motor_lag if p.stop_lag is None else p.stop_lag,
        speed_quantum=p.speed_quantum, loop_period=p.loop_period, deadband=p.deadband, breakaway=p.breakaway,
        slip=p.slip, slip_noise=p.slip_noise,
        top_speed_sag=p.top_speed_sag, battery_life=p.battery_life,
        left_gain=1.0 + p.wheel_gain_error - p.wheel_gain_difference / 2.0 + p.wheel_gain_spread * left,
        right_gain=1.0 + p.wheel_gain_error + p.wheel_gain_difference / 2.0 + p.wheel_gain_spread * right,
        left_sign=-1.0 if p.wiring in ("left_reversed", "both_reversed") else 1.0,
        right_sign=-1.0 if p.wiring in ("right_reversed", "both_reversed") else 1.0,
        swapped=p.wiring == "swapped", longest_step_ns=round(p.loop_period / _NS),
        delay_ns=round(p.actuation_delay / _NS),
    )  # fmt: skip


def placed(pose: tuple[float, float, float], now_ns: int) -> Body:
    x, y, psi = pose
    return Body(x=x, y=y, psi=psi, reached_ns=now_ns)


def capacity(delay_ns: int) -> int:
    """Return how many commands may be under way to a robot with a delay."""
    return _COMMANDS + _COMMANDS_HZ * delay_ns // 1_000_000_000


def random_numbers(rng: np.random.Generator) -> list[float]:
    numbers: list[float] = rng.standard_normal(RANDOM_BLOCK)[::-1].tolist()
    return numbers


def befall(b: Body, trouble: BodyTrouble) -> None:
    b.stuck, b.slip = trouble.stuck, trouble.slip
    b.left_runs = math.nan if trouble.left is None else trouble.left
    b.right_runs = math.nan if trouble.right is None else trouble.right
    b.pushed_x, b.pushed_y = trouble.pushed


def command(b: Body, p: Build, coming: Sequence[Coming], left: float, right: float, off_ns: int) -> None:
    """Command the wheels [rad/s] at the instant that was reached; they follow after the actuation delay.

    At ``off_ns`` the motors go off, if there is no other command before.
    """
    b.off_ns = off_ns
    if p.delay_ns <= 0:
        b.left_command, b.right_command = left, right
        return
    newest = coming[(b.first + b.waiting) % len(coming)]
    newest.at_ns, newest.left, newest.right = b.reached_ns + p.delay_ns, left, right
    if b.waiting < len(coming):
        b.waiting += 1


def advance(b: Body, p: Build, coming: Sequence[Coming], noise: Sequence[float], now_ns: int) -> None:
    """Let time pass until then [ns], or until the random numbers are used up. An instant in the past changes nothing.

    Time is cut at the instants at which commands act.
    """
    while True:  # with one call of _pass: of every call the compiler makes a copy
        off = now_ns >= b.off_ns
        _pass(b, p, coming, noise, b.off_ns if off else now_ns)
        if not off or b.reached_ns < b.off_ns:
            return
        command(b, p, coming, 0.0, 0.0, NEVER_NS)


def _pass(b: Body, p: Build, coming: Sequence[Coming], noise: Sequence[float], now_ns: int) -> None:
    while b.reached_ns < now_ns and b.drawn + DRAWS <= len(noise):
        step_ns = next_step(b, p, coming, now_ns)
        step(b, p, noise, step_ns * _NS)
        if b.pushed_x != 0.0 or b.pushed_y != 0.0:
            b.x += b.pushed_x * step_ns * _NS
            b.y += b.pushed_y * step_ns * _NS
        b.reached_ns += step_ns


def next_step(b: Body, p: Build, coming: Sequence[Coming], now_ns: int) -> int:
    """Let the commands act that are due, and return for how long they are constant [ns], until ``now_ns`` at most."""
    act(b, coming)
    step_ns = min(now_ns - b.reached_ns, p.longest_step_ns)
    return min(step_ns, coming[b.first].at_ns - b.reached_ns) if b.waiting > 0 else step_ns


def act(b: Body, coming: Sequence[Coming]) -> None:
    """Let the commands act that are due at the instant that was reached."""
    while b.waiting > 0 and coming[b.first].at_ns <= b.reached_ns:
        b.left_command, b.right_command = coming[b.first].left, coming[b.first].right
        b.first = (b.first + 1) % len(coming)
        b.waiting -= 1


def step(b: Body, p: Build, noise: Sequence[float], duration: float) -> None:
    """Advance by ``duration`` > 0 [s] with constant commands."""
    b.used += duration
    if b.stuck:
        b.left_speed = b.right_speed = b.v = b.omega = 0.0
        return
    top, (decay, stop_decay) = top_speed(p, b.used), decays(p, duration)
    left, right = setpoints(b, p)
    mean, b.left_angle, b.left_speed, b.left_counted = turned(
        p, b.left_angle, b.left_speed, b.left_counted, left, top, duration, decay, stop_decay
    )
    left = p.left_gain * mean
    mean, b.right_angle, b.right_speed, b.right_counted = turned(
        p, b.right_angle, b.right_speed, b.right_counted, right, top, duration, decay, stop_decay
    )
    right = p.right_gain * mean
    if left == 0.0 and right == 0.0:
        b.v = b.omega = 0.0
        return
    if p.slip:
        left, right = slipped(p, left, right, noise[b.drawn], noise[b.drawn + 1])
        b.drawn += DRAWS
    left, right = (1.0 - b.slip) * left, (1.0 - b.slip) * right
    b.v, b.omega = body_from_wheels(left, right, p.wheel_radius, p.wheel_base)
    b.x, b.y, b.psi = arc(b.x, b.y, b.psi, b.v, b.omega, duration)


def setpoints(b: Body, p: Build) -> tuple[float, float]:
    """Return what the speed loops of the wheels aim at [rad/s]: commands, unless a wheel runs away."""
    left, right = _through_wires(p, b.left_command, b.right_command)
    if not math.isnan(b.left_runs):
        left = b.left_runs
    if not math.isnan(b.right_runs):
        right = b.right_runs
    return left, right


def measured(b: Body, p: Build) -> tuple[float, float, float, float, float]:
    """Return angles and speeds of the wheels, left and right, in whole counts, and the charge."""
    left_angle, right_angle = _through_wires(p, b.left_angle, b.right_angle)
    left_speed, right_speed = _through_wires(p, b.left_speed, b.right_speed)
    count = p.speed_quantum * p.loop_period
    charge = max(0.0, 1.0 - b.used / p.battery_life) if math.isnan(b.low_charge) else b.low_charge
    return (
        _quantised(left_angle, count), _quantised(right_angle, count),
        _quantised(left_speed, p.speed_quantum), _quantised(right_speed, p.speed_quantum), charge,
    )  # fmt: skip


def top_speed(p: Build, used: float) -> float:
    """Return the fastest speed of a wheel [rad/s] after so much battery time [s]."""
    return p.max_wheel_speed * (1.0 - p.top_speed_sag * min(1.0, used / p.battery_life))


def decays(p: Build, duration: float) -> tuple[float, float]:
    """Return what is left after ``duration`` [s] of what a wheel lags behind, while it drives and while it stops."""
    decay = math.exp(-duration / p.motor_lag) if p.motor_lag else 0.0  # once for both: an exponential takes long
    if p.stop_lag == p.motor_lag:
        return decay, decay
    return decay, math.exp(-duration / p.stop_lag) if p.stop_lag else 0.0


def turned(
    p: Build, angle: float, speed: float, counted: float, command: float, top: float, duration: float,
    decay: float, stop_decay: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return the mean speed of a wheel over ``duration``, then its angle, speed and counted angle."""
    threshold = p.deadband if speed else p.breakaway
    if -threshold < command < threshold:
        target = 0.0
        if -_AT_REST < speed < _AT_REST:
            speed = 0.0
    else:
        target = command if -top <= command <= top else math.copysign(top, command)
    lag, decay = (p.motor_lag, decay) if target else (p.stop_lag, stop_decay)
    ahead = speed - target
    mean, speed = target + ahead * (1.0 - decay) * lag / duration, target + ahead * decay
    travelled = angle + mean * duration
    resolution = p.speed_quantum * p.loop_period
    if resolution:
        seen = resolution * floor(travelled / resolution)
        # the loop acts on what it counts: what the encoder has not seen yet is missing from its feedback
        unseen = (travelled - seen) - (angle - counted)
        counted = seen
        if target and p.motor_lag:
            speed += unseen / p.motor_lag
    return mean, travelled, speed, counted


def slipped(p: Build, left: float, right: float, left_noise: float, right_noise: float) -> tuple[float, float]:
    """Return with which speeds wheels pass over the floor that turn with ``left`` and ``right`` [rad/s]."""
    turning = p.slip * abs(body_from_wheels(left, right, p.wheel_radius, p.wheel_base)[1])
    left *= 1.0 - turning * max(0.0, 1.0 + p.slip_noise * left_noise)
    right *= 1.0 - turning * max(0.0, 1.0 + p.slip_noise * right_noise)
    return left, right


def _through_wires(p: Build, left: float, right: float) -> tuple[float, float]:
    """Return what arrives at the other end of the robot's wires, in either direction."""
    if p.swapped:
        return right, left
    return p.left_sign * left, p.right_sign * right


def _quantised(value: float, quantum: float) -> float:
    return quantum * math.floor(value / quantum + 0.5) if quantum else value


class Plant:
    """One robot, which stands where it was put, commanded to stop."""

    def __init__(
        self, drive: DifferentialDrive, imperfections: Imperfections, pose: tuple[float, float, float],
        rng: np.random.Generator, *, now_ns: int = 0, trouble: Callable[[], BodyTrouble] | None = None,
    ) -> None:  # fmt: skip
        """``trouble`` returns what is wrong with it now."""
        self._p, self._rng, self._trouble = built(drive, imperfections, rng), rng, trouble
        self._b = placed(pose, now_ns)
        self._coming = [Coming() for _ in range(capacity(self._p.delay_ns))]
        self._noise = [] if self._p.slip else [0.0] * DRAWS

    def write(self, wheels: WheelSpeeds, *, off_ns: int = NEVER_NS) -> None:
        """Command the wheels [rad/s] at the instant that was reached; at ``off_ns`` the motors go off."""
        command(self._b, self._p, self._coming, *wheels, off_ns)

    def advance(self, now_ns: int) -> None:
        """Let time pass until then [ns]; an instant that was reached already changes nothing."""
        b = self._b
        if now_ns > b.reached_ns and self._trouble is not None:
            befall(b, self._trouble())
        while b.reached_ns < now_ns:
            self._supply()
            advance(b, self._p, self._coming, self._noise, now_ns)

    def step(self, wheels: WheelSpeeds, duration: float, *, blocked: bool = False) -> None:
        """Advance by ``duration`` > 0 [s] with constant commands; ``blocked`` motors stand still, whatever they are."""
        self._supply()
        self._b.stuck = blocked
        self._b.left_command, self._b.right_command = wheels
        step(self._b, self._p, self._noise, duration)

    @property
    def charge(self) -> float:
        """Charge of the battery [0..1]."""
        return self.reading().battery

    def reading(self) -> DriverReading:
        return DriverReading(*measured(self._b, self._p), self._b.faults)

    def truth(self) -> TruePose:
        b = self._b
        return TruePose(b.x, b.y, b.psi, b.v, b.omega)

    def _supply(self) -> None:
        if self._b.drawn + DRAWS > len(self._noise):
            self._noise, self._b.drawn = random_numbers(self._rng), 0
