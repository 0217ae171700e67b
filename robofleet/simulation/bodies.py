"""Many simulated robots' bodies at once: wheels, encoders and floor in arrays, compiled.

``drivers/simulated.py`` has the same robot one by one, for whoever reads or has no numba: ``vehicles/plant.py``
explains the model. Both do the same to the last bit: ``tests/simulation/test_bodies.py`` compares them.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.clock import S
from robofleet.core.kernels import kernel
from robofleet.vehicles import differential_drive
from robofleet.vehicles.interface import BodyTrouble, DriverContext, Imperfections
from robofleet.vehicles.sensors import SimulatedSensors

_NS = 1e-9
_SILENT_NS = 200_000_000  # the firmware's own watchdog: without a word for so long the motors go off
NEVER_NS = (1 << 63) - 1
_BLOCK = 512  # random numbers that are drawn at once
_CALLS = 32  # after so many the random numbers are counted anew
_DRAWS = 2  # for a step of the plant
_COMMANDS = 64  # that are under way to a robot without delay; more for each second of it
_COMMANDS_HZ = 1000

_F, _I = "<f8", "<i8"
_WHEELS = [
    (f"{side}_{name}", _F) for side in ("left", "right") for name in ("counted", "gain", "angle", "speed", "command")
]
BODY = np.dtype(
    [
        *((name, _F) for name in ("x", "y", "psi", "v", "omega", "used")),
        *_WHEELS,
        *((name, _I) for name in ("reached_ns", "off_ns", "first", "coming", "drawn")),
        # What is wrong with it now, as vehicles.interface.BodyTrouble; NaN: this wheel does as it is told.
        ("stuck", _I), *((name, _F) for name in ("slip", "left_runs", "right_runs", "pushed_x", "pushed_y")),
        # What its sensors say in spite of what is there.
        ("faults", _I), ("low_charge", _F),
    ]
)  # fmt: skip
PLANT = np.dtype(
    [
        *((name, _F) for name in (
            "wheel_radius", "wheel_base", "max_wheel_speed", "motor_lag", "speed_quantum", "loop_period", "deadband",
            "breakaway", "slip", "slip_noise", "top_speed_sag", "battery_life", "left_sign", "right_sign",
        )),
        ("swapped", _I), ("longest_step_ns", _I), ("delay_ns", _I),
    ]
)  # fmt: skip
COMING = np.dtype([("at_ns", _I), ("left", _F), ("right", _F)])

_AT_REST = 1e-3  # as in vehicles.plant
_arc = kernel(differential_drive.arc)
_body_from_wheels = kernel(differential_drive.body_from_wheels)


class Sensors(NamedTuple):
    """What a robot's sensors say in spite of what is there."""

    faults: int = 0  # of vehicles.interface.RobotFault
    charge: float = math.nan  # of the battery; NaN: as it is


class Bodies:
    """The bodies of robots (N,); each stands where it was put, told to stop."""

    def __init__(self, contexts: Sequence[DriverContext]) -> None:
        n = len(contexts)
        self.sensors: list[
            tuple[int, Callable[[], Sensors]]
        ] = []  # rows, and what tells what their sensors say wrongly
        self._now_ns = contexts[0].now_ns
        simulations = [context.simulation for context in contexts]
        assert all(simulations), "a robot that does not exist is refused without one"
        self.bodies, self.plants = np.zeros(n, BODY), np.zeros(n, PLANT)
        self._rngs = [s.rng for s in simulations if s is not None]
        self._troubles = [(row, s.trouble) for row, s in enumerate(simulations) if s is not None and s.trouble]
        now_ns, longest_delay_ns = self._now_ns(), 0
        for row, simulation in enumerate(simulations):
            assert simulation is not None
            imperfections, drive, body = simulation.imperfections, simulation.drive, self.bodies[row]
            left, right, base = self._rngs[row].uniform(-1.0, 1.0, 3).tolist()
            body["x"], body["y"], body["psi"] = simulation.start
            for side, drawn in (("left", left), ("right", right)):
                gain = 1.0 + imperfections.wheel_gain_error + imperfections.wheel_gain_spread * drawn
                body[f"{side}_gain"] = gain
            body["reached_ns"], body["off_ns"], body["low_charge"] = now_ns, NEVER_NS, math.nan
            body["left_runs"] = body["right_runs"] = math.nan
            self.plants[row] = _plant(imperfections, drive, base)
            longest_delay_ns = max(longest_delay_ns, int(self.plants[row]["delay_ns"]))
        capacity = _COMMANDS + _COMMANDS_HZ * longest_delay_ns // S
        self.radii = np.array([s.radius for s in simulations if s is not None])
        sensing = [(row, s.sensing) for row, s in enumerate(simulations) if s is not None and s.sensing is not None]
        self.sensing = SimulatedSensors(*zip(*sensing, strict=True)) if sensing else None
        self.coming = np.zeros((n, capacity), COMING)
        self._step_ns = int(self.plants["longest_step_ns"].min())
        self._noisy = bool(self.plants["slip"].any())
        self._enough_ns, self._calls = now_ns, 0  # until when the random numbers last, for so many calls
        self.noise = np.zeros((n, 2 * _BLOCK))  # two blocks a robot, each drawn at once and used from its end
        if self._noisy:
            for row in range(n):
                self._draw(row, 0)
                self._draw(row, 1)

    def __len__(self) -> int:
        """Return how many robots these are."""
        return len(self.bodies)

    def prepare(self) -> int:
        """Make ready for kernels that let time pass up to the present, and return that instant [ns]."""
        now_ns = self._now_ns()
        for row, trouble in self._troubles:
            if now_ns > self.bodies[row]["reached_ns"]:
                self._apply(row, trouble())
        for row, sensors in self.sensors:
            troubles = sensors()
            self.bodies[row]["faults"], self.bodies[row]["low_charge"] = troubles
        if self._noisy:
            self._supply(now_ns)
        return now_ns

    def row(self, row: int) -> tuple[Any, Any, Any, Any]:
        """Return a robot's part of the arrays, as kernels take it."""
        return self.bodies[row], self.plants[row], self.coming[row], self.noise[row]

    def write(self, row: int, left: float, right: float) -> None:
        """Command a robot's wheels from now on [rad/s]."""
        tell(*self.row(row), left, right, self.prepare())

    def truths(self) -> NDArray[np.float64]:
        """Return where the robots really are now, and how they move (N, 5): x, y, psi, v, omega."""
        advance_all(self.bodies, self.plants, self.coming, self.noise, self.prepare())
        b = self.bodies
        return np.stack([b[name] for name in ("x", "y", "psi", "v", "omega")], axis=1)

    def sense(self) -> NDArray[np.float64]:
        """Return what the sensors say now, as ``SimulatedSensors.read``; only where a robot has some."""
        assert self.sensing is not None
        truths = self.truths()
        return self.sensing.read(int(self.bodies["reached_ns"].max()), truths, self.radii)

    def _apply(self, row: int, trouble: BodyTrouble) -> None:
        body = self.bodies[row]
        body["stuck"], body["slip"] = trouble.stuck, trouble.slip
        body["left_runs"] = math.nan if trouble.left is None else trouble.left
        body["right_runs"] = math.nan if trouble.right is None else trouble.right
        body["pushed_x"], body["pushed_y"] = trouble.pushed

    def _supply(self, now_ns: int) -> None:
        """Let there be random numbers enough until an instant; robots that need more than fit are brought there."""
        self._calls += 1
        if now_ns <= self._enough_ns and self._calls < _CALLS:
            return
        b = self.bodies
        reached_ns, coming = int(b["reached_ns"].min()), int(b["coming"].max())
        steps = (now_ns - reached_ns) // self._step_ns + coming + 3
        left = (2 * _BLOCK - int(b["drawn"].max())) // _DRAWS
        if steps <= left:
            # Between two calls a robot is told twice at most: each word can cut one step in two.
            self._calls, spare = 0, left - coming - 3 - 2 * _CALLS
            self._enough_ns = reached_ns + max(0, spare) * self._step_ns
            return
        self._refill()
        while _DRAWS * steps > _BLOCK and (b["reached_ns"] < now_ns).any():
            advance_all(b, self.plants, self.coming, self.noise, now_ns)
            self._refill()

    def _refill(self) -> None:
        """Draw again the blocks of random numbers that were used up."""
        drawn = self.bodies["drawn"]
        for row in np.flatnonzero(drawn >= _BLOCK).tolist():
            # The block that is under way comes first, a new one behind it.
            self.noise[row, :_BLOCK] = self.noise[row, _BLOCK:]
            drawn[row] -= _BLOCK
            self._draw(row, 1)

    def _draw(self, row: int, block: int) -> None:
        self.noise[row, block * _BLOCK : (block + 1) * _BLOCK] = self._rngs[row].standard_normal(_BLOCK)[::-1]


def _plant(p: Imperfections, drive: differential_drive.DifferentialDrive, base: float) -> tuple[float, ...]:
    """Return a row of PLANT."""
    return (
        drive.wheel_radius, drive.wheel_base * (1.0 + p.wheel_base_spread * base), drive.max_wheel_speed,
        p.motor_lag, p.speed_quantum, p.loop_period, p.deadband, p.breakaway, p.slip, p.slip_noise, p.top_speed_sag,
        p.battery_life,
        -1.0 if p.wiring in ("left_reversed", "both_reversed") else 1.0,
        -1.0 if p.wiring in ("right_reversed", "both_reversed") else 1.0,
        p.wiring == "swapped", round(p.loop_period / _NS), round(p.actuation_delay / _NS),
    )  # fmt: skip


@kernel
def advance_all(bodies, plants, coming, noise, now_ns):  # type: ignore[no-untyped-def]
    """Let time pass for every robot (N,) until an instant [ns]; one that was reached already changes nothing."""
    for row in range(len(bodies)):
        advance(bodies[row], plants[row], coming[row], noise[row], now_ns)


@kernel
def advance(b, p, coming, noise, now_ns):  # type: ignore[no-untyped-def]
    """Let time pass for a robot; without a word for long its firmware switches the motors off."""
    if now_ns >= b.off_ns:
        off_ns = b.off_ns
        _advance(b, p, coming, noise, off_ns)
        if b.reached_ns < off_ns:
            return
        _tell(b, p, coming, 0.0, 0.0)
        b.off_ns = NEVER_NS
    _advance(b, p, coming, noise, now_ns)


@kernel
def tell(b, p, coming, noise, left, right, now_ns):  # type: ignore[no-untyped-def]
    """Command a robot's wheels [rad/s]; they follow after the actuation delay."""
    advance(b, p, coming, noise, now_ns)
    _tell(b, p, coming, left, right)
    b.off_ns = now_ns + _SILENT_NS


@kernel
def _tell(b, p, coming, left, right):  # type: ignore[no-untyped-def]
    pending = coming[(b.first + b.coming) % len(coming)]
    pending.at_ns, pending.left, pending.right = b.reached_ns + p.delay_ns, left, right
    if b.coming < len(coming):
        b.coming += 1


@kernel
def _advance(b, p, coming, noise, now_ns):  # type: ignore[no-untyped-def]
    while b.reached_ns < now_ns and b.drawn + _DRAWS <= len(noise):  # else Bodies draws more, and it goes on
        while b.coming > 0 and coming[b.first].at_ns <= b.reached_ns:
            b.left_command, b.right_command = coming[b.first].left, coming[b.first].right
            b.first = (b.first + 1) % len(coming)
            b.coming -= 1
        step_ns = min(now_ns - b.reached_ns, p.longest_step_ns)
        if b.coming > 0:
            step_ns = min(step_ns, coming[b.first].at_ns - b.reached_ns)
        _step(b, p, noise, step_ns * _NS)
        if b.pushed_x != 0.0 or b.pushed_y != 0.0:
            b.x += b.pushed_x * step_ns * _NS
            b.y += b.pushed_y * step_ns * _NS
        b.reached_ns += step_ns


@kernel
def _step(b, p, noise, duration):  # type: ignore[no-untyped-def]
    """Advance one robot by ``duration`` [s] with constant commands, as ``Plant.step``."""
    b.used += duration
    if b.stuck:
        b.left_speed = b.right_speed = b.v = b.omega = 0.0
        return
    used = min(1.0, b.used / p.battery_life)
    top = p.max_wheel_speed * (1.0 - p.top_speed_sag * used)
    left, right = through_wires(p, b.left_command, b.right_command)
    if not math.isnan(b.left_runs):
        left = b.left_runs
    if not math.isnan(b.right_runs):
        right = b.right_runs
    mean, b.left_angle, b.left_speed, b.left_counted = _turn(
        p, b.left_angle, b.left_speed, b.left_counted, left, top, duration
    )
    left = b.left_gain * mean
    mean, b.right_angle, b.right_speed, b.right_counted = _turn(
        p, b.right_angle, b.right_speed, b.right_counted, right, top, duration
    )
    right = b.right_gain * mean
    if left == 0.0 and right == 0.0:
        b.v = b.omega = 0.0
        return
    if p.slip:
        turning = p.slip * abs(_body_from_wheels(left, right, p.wheel_radius, p.wheel_base)[1])
        left *= 1.0 - turning * max(0.0, 1.0 + p.slip_noise * noise[b.drawn])
        right *= 1.0 - turning * max(0.0, 1.0 + p.slip_noise * noise[b.drawn + 1])
        b.drawn += _DRAWS
    left, right = (1.0 - b.slip) * left, (1.0 - b.slip) * right
    v, omega = _body_from_wheels(left, right, p.wheel_radius, p.wheel_base)
    b.v, b.omega = v, omega
    b.x, b.y, b.psi = _arc(b.x, b.y, b.psi, v, omega, duration)


@kernel
def _turn(p, angle, speed, counted, command, top, duration):  # type: ignore[no-untyped-def]
    """Return the mean speed of a wheel over ``duration``, then its angle, speed and counted angle."""
    threshold = p.deadband if speed else p.breakaway
    if -threshold < command < threshold:
        target = 0.0
        if -_AT_REST < speed < _AT_REST:
            speed = 0.0
    else:
        target = command if -top <= command <= top else math.copysign(top, command)
    if p.motor_lag:
        decay, ahead = math.exp(-duration / p.motor_lag), speed - target
        mean, speed = target + ahead * (1.0 - decay) * p.motor_lag / duration, target + ahead * decay
    else:
        mean = speed = target
    travelled = angle + mean * duration
    resolution = p.speed_quantum * p.loop_period
    if resolution:
        seen = resolution * math.floor(travelled / resolution)
        unseen = (travelled - seen) - (angle - counted)
        counted = seen
        if target and p.motor_lag:
            speed += unseen / p.motor_lag
    return mean, travelled, speed, counted


@kernel
def through_wires(p, left, right):  # type: ignore[no-untyped-def]
    """Return what arrives at the other end of a robot's wires, in either direction."""
    if p.swapped:
        return right, left
    return p.left_sign * left, p.right_sign * right


@kernel
def quantised(value, quantum):  # type: ignore[no-untyped-def]
    """Return a figure in whole counts."""
    return quantum * math.floor(value / quantum + 0.5) if quantum else value


KERNELS = (advance_all, tell, quantised)
