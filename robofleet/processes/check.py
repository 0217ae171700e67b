"""What is refused before a wheel turns: settings that are right one by one and cannot work together."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from robofleet.clock import S
from robofleet.config import barrier, slices
from robofleet.config.faults import Complaint
from robofleet.config.load import ConfigFile
from robofleet.config.tree import Config, Group
from robofleet.control.path import Path
from robofleet.plugins import PluginError, load
from robofleet.processes import check_drivers, check_faults, reality
from robofleet.safety.arming import free_m
from robofleet.safety.barrier import apart, from_edge
from robofleet.safety.gate import VALID_NS
from robofleet.tracking.sources import ScheduledCamera

Array = NDArray[np.float64]

_STEPS = 1000  # a side: the fastest wheel is then known to about 1e-5 of itself
_STANDSTILL = 0.01  # of the mean |r'|: a path slower than this at a point has a cusp there
_ROUNDING = 1e-9
_LONGEST_TICK_S = VALID_NS / S - 0.03  # status period, bus and lateness come off what the gate grants


@dataclass(frozen=True)
class Bound:
    """One thing that was looked at: a value, and its limit (at most, at least, or ``strict``: less)."""

    path: str
    what: str
    value: float
    limit: float
    unit: str
    mend: str
    at_least: bool = False
    strict: bool = False

    @property
    def tightness(self) -> float:
        """Up to 1 when the bound holds."""
        used, available = (self.limit, self.value) if self.at_least else (self.value, self.limit)
        return used / available if available > 0 else math.inf

    @property
    def holds(self) -> bool:
        """Whether the bound is kept."""
        return self.tightness <= 1 + (-_ROUNDING if self.strict else _ROUNDING)


@dataclass(frozen=True)
class Lap:
    """A robot on its lap when it follows the path without error: arrays over the parameter, shape (n,)."""

    sigma: Array
    position: Array  # r, shape (n, 2) [m]
    speed: Array  # |r'| [m a side]
    v: Array  # of the body [m/s]
    omega: Array  # of the body [rad/s]
    centre: Array  # of the robot, shape (n, 2) [m]


def load_checked(
    file: FilePath, overrides: Sequence[str] = (), faults_file: FilePath | None = None, *, lockstep: bool = False
) -> Config:
    """Read a configuration that can work; ConfigError with every fault at its line and column.

    Where nothing else is wrong with the robots, each is opened once: what does not answer is a fault too.
    """
    source = ConfigFile(file, overrides, faults_file)
    complaints = refusals(source.config, lockstep=lockstep)
    if not any(path.startswith("robots.") for path, _ in complaints):
        complaints += check_drivers.unreachable(source.config)
    source.refuse(complaints)
    return source.config


def refusals(config: Config, *, lockstep: bool = False) -> list[Complaint]:
    """Return what cannot work: (dotted path, what is wrong and how to mend it).

    Lockstep lets simulated time pass at any rate: it never moves a real robot, nor waits for a real camera.
    """
    faults = check_faults.complaints(config, lockstep=lockstep)
    complaints = [*check_drivers.complaints(config, lockstep=lockstep), *reality.complaints(config), *faults]
    if config.tracker.source == "camera":
        complaints += _camera_source(config, lockstep)
    for bound in _bounds(config):
        if not bound.holds:
            relation = "at least" if bound.at_least else "less than" if bound.strict else "at most"
            value, limit = _shown(bound.value, bound.unit), _shown(bound.limit, bound.unit)
            complaints.append((bound.path, f"{bound.what} is {value}, must be {relation} {limit}: {bound.mend}"))
    return complaints


def proofs(config: Config) -> list[tuple[str, str, str, str]]:
    """Return what was proved: (what, the tightest value, its limit, how much of it is used)."""
    tightest: dict[str, Bound] = {}
    for bound in _bounds(config):
        if bound.what not in tightest or bound.tightness > tightest[bound.what].tightness:
            tightest[bound.what] = bound
    return [
        (
            b.what,
            _shown(b.value, b.unit),
            ("≥ " if b.at_least else "< " if b.strict else "≤ ") + _shown(b.limit, b.unit),
            f"{b.tightness:.0%}",
        )
        for b in tightest.values()
    ]


def drive_lap(path: Path, group: Group, point_ahead: float) -> Lap:
    """Return the lap of a robot whose point p (or centre) moves exactly as r(gamma t).

    p at r makes the heading follow psi' = (-sin psi r_x' + cos psi r_y') / l: solved exactly over steps with
    r' held, which is stable for every l > 0; the first of two laps forgets the start.
    """
    sigma = (np.arange(path.sides * _STEPS) + 0.5) / _STEPS
    derivative = path.derivative(sigma)
    speed = np.hypot(derivative[:, 0], derivative[:, 1])
    if group.track == "centre":
        second = path.second_derivative(sigma)
        cross = derivative[:, 0] * second[:, 1] - derivative[:, 1] * second[:, 0]
        along, turn = speed, cross / np.maximum(speed, np.finfo(float).tiny) ** 2
        centre = path.position(sigma)
    else:
        decay = np.exp(-speed / (_STEPS * point_ahead)).tolist()
        direction = np.arctan2(derivative[:, 1], derivative[:, 0]).tolist()
        psi = direction[-1]
        lags = []  # from r' to the heading, before and after each step [rad]
        for towards, factor in zip(direction * 2, decay * 2, strict=True):
            before = math.remainder(psi - towards, math.tau)
            after = 2 * math.atan(math.tan(before / 2) * factor)
            psi += after - before
            lags.append((before, after))
        lag = np.array(lags[len(sigma) :])
        along, turn = speed * np.cos(lag.mean(axis=1)), (lag[:, 1] - lag[:, 0]) * _STEPS
        heading = np.array(direction) + lag.mean(axis=1)
        centre = path.position(sigma) - point_ahead * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    rate = group.path_rate
    return Lap(sigma, path.position(sigma), speed, along * rate, turn * rate, centre)


def _bounds(config: Config) -> Iterator[Bound]:
    yield from _controller(config)
    yield from _path(config)
    yield from _start(config)
    if config.tracker.source == "camera":
        yield from _camera(config)


def _controller(config: Config) -> Iterator[Bound]:
    controller, spacing = config.controller, config.groups[0].spacing_m
    if controller.integrator == "euler":
        mend = f"lower alpha below {2 / controller.tick_s:.3g}, or take the exact integrator"
        gain = controller.alpha * controller.tick_s
        yield Bound("controller.alpha", "Euler's gain, alpha * tick_s,", gain, 2.0, "", mend, strict=True)
    mend = f"lower it below {1 / controller.tick_s:.3g}, or a distance is used up within a tick"
    used = controller.barrier.rate_per_s * controller.tick_s
    yield Bound("controller.barrier.rate_per_s", "rate_per_s * tick_s", used, 1.0, "", mend, strict=True)
    mend = "a command is valid for 120 ms and at each tick up to 30 ms old, so the gates would close between two ticks"
    yield Bound("controller.tick_s", "tick_s", controller.tick_s, _LONGEST_TICK_S, "s", mend)
    yield Bound(
        "controller.point_ahead_m", "point_ahead_m", controller.point_ahead_m, spacing / 2, "m",
        "the point must be much closer to its robot than the next robot is, so lower it or raise spacing_m",
    )  # fmt: skip


def _path(config: Config) -> Iterator[Bound]:
    group = config.groups[0]
    path = Path.hermite(*slices.knots(group))
    lap = drive_lap(path, group, config.controller.point_ahead_m)
    slowest = int(lap.speed.argmin())
    mend = f"it stands still at parameter {lap.sigma[slowest]:.2f}, so mend the derivatives of its knots"
    cusp = Bound(
        "groups.0.path", "the path's smallest derivative", float(lap.speed[slowest]),
        _STANDSTILL * float(lap.speed.mean()), "m a side", mend, at_least=True,
    )  # fmt: skip
    yield cusp
    yield from _inside(config, lap)
    if cusp.holds:
        yield from _wheels(config, lap)
    yield from _spacing(config, path, lap)
    if group.behaviour == "platoon":
        yield from _clear_of_the_path(config, lap)


def _inside(config: Config, lap: Lap) -> Iterator[Bound]:
    radius = max(robot.vehicle.body_radius_m for robot in config.platoon)
    keepout = barrier.keepout(config)
    margin = max(from_edge(keepout, barrier.body(config, robot)) for robot in config.platoon) - radius
    for axis, name in enumerate("xy"):
        reach = np.abs(lap.position[:, axis])
        k = int(reach.argmax())
        mend = f"the path leaves the arena at parameter {lap.sigma[k]:.2f}, so move its knots inwards"
        what = f"the path's reach in {name} with a body's radius"
        yield Bound("groups.0.path", what, float(reach[k]) + radius, config.arena.size_m[axis] / 2 - margin, "m", mend)


def _wheels(config: Config, lap: Lap) -> Iterator[Bound]:
    """Wheel and body speeds along the lap, for each kind of robot; both are proportional to the path rate."""
    kinds = {slices.drive(robot): robot.id for robot in reversed(config.platoon)}
    for drive, robot_id in kinds.items():
        body = np.abs(lap.v)
        wheel = (body + np.abs(lap.omega) * drive.wheel_base / 2) / drive.wheel_radius
        for what, values, limit, unit in (
            ("the fastest wheel along the path", wheel, drive.max_wheel_speed, "rad/s"),
            ("the highest speed along the path", body, drive.max_speed, "m/s"),
        ):
            k = int(values.argmax())
            fits = _rounded_down(config.groups[0].path_rate * limit / float(values[k]))
            mend = f"{robot_id} at path parameter {lap.sigma[k]:.2f}; path_rate {fits:g} fits"
            yield Bound("groups.0.path_rate", what, float(values[k]), limit, unit, mend)


def _spacing(config: Config, path: Path, lap: Lap) -> Iterator[Bound]:
    spacing, robots, length = config.groups[0].spacing_m, config.platoon, path.length()
    if len(robots) > 1:
        far = lap.position[:: _STEPS // 100]
        reach = np.linalg.norm(far[:, None] - far[None], axis=-1).max(axis=1)
        k = int(reach.argmin())
        fits = _rounded_down(float(reach[k]))
        mend = f"no point of the path is so far from parameter {k / 100:.2f}, so a spacing of {fits:g} fits"
        yield Bound("groups.0.spacing_m", "spacing_m on this path", spacing, float(reach[k]), "m", mend, strict=True)
    mend = f"a spacing of {_rounded_down(length / len(robots)):g} fits"
    what = "the platoon with a gap behind it, spacing_m a robot,"
    yield Bound("groups.0.spacing_m", what, len(robots) * spacing, length, "m", mend, strict=True)
    keepout = barrier.keepout(config)
    for one, other in itertools.pairwise(robots):
        fastest = min(float(np.abs(lap.v).max()), other.vehicle.max_speed_m_s)
        near = apart(keepout, barrier.body(config, one), barrier.body(config, other)) + 2 * fastest / keepout.rate
        mend = f"the barrier would hold {other.id} back from {one.id}, so raise it"
        yield Bound("groups.0.spacing_m", "spacing_m", spacing, near, "m", mend, at_least=True)


def _clear_of_the_path(config: Config, lap: Lap) -> Iterator[Bound]:
    """A bystander stands where the barrier lets every robot pass on its lap."""
    keepout = barrier.keepout(config)
    bodies = [barrier.body(config, robot) for robot in config.platoon]
    for i, robot in enumerate(config.robots):
        if robot in config.bystanders:
            distances = np.hypot(lap.centre[:, 0] - robot.start.x_m, lap.centre[:, 1] - robot.start.y_m)
            k, its = int(distances.argmin()), barrier.body(config, robot)
            near = max(apart(keepout, one, its) for one in bodies)
            mend = f"the robots pass it at path parameter {lap.sigma[k]:.2f}, so park {robot.id} further away"
            what = "the distance of a robot that is not in the group from the path"
            yield Bound(f"robots.{i}.start", what, float(distances[k]), near, "m", mend, at_least=True)


def _start(config: Config) -> Iterator[Bound]:
    for i, robot in enumerate(config.robots):
        for axis, (name, at) in enumerate((("x", robot.start.x_m), ("y", robot.start.y_m))):
            what = f"a start pose's reach in {name} with the body's radius"
            reach, half = abs(at) + robot.vehicle.body_radius_m, config.arena.size_m[axis] / 2
            yield Bound(f"robots.{i}.start", what, reach, half, "m", f"move {robot.id} into the arena")
    for (i, one), (j, other) in itertools.combinations(enumerate(config.robots), 2):
        apart = math.hypot(one.start.x_m - other.start.x_m, one.start.y_m - other.start.y_m)
        bodies = one.vehicle.body_radius_m + other.vehicle.body_radius_m
        what, mend = "the distance between two robots at the start", f"move {one.id} and {other.id} apart"
        yield Bound(f"robots.{j}.start", what, apart, bodies, "m", mend, at_least=True)
        standing = [one in config.bystanders, other in config.bystanders]
        if sum(standing) == 1:
            k, moves = (i, other) if standing[0] else (j, one)
            what = "the distance of a robot that is not in the group from one that is, at the start"
            room = bodies + free_m(slices.drive(moves).wheel_radius)
            mend = f"{moves.id}'s wheels are tried before a start, so move {config.robots[k].id} away from it"
            yield Bound(f"robots.{k}.start", what, apart, room, "m", mend, at_least=True)


def _camera(config: Config) -> Iterator[Bound]:
    camera = config.camera
    period = config.controller.tick_s if camera.trigger == "tick" else 1 / camera.rate_hz
    taken = camera.exposure_s + camera.readout_s
    mend = "the next frame begins before, so shorten the exposure"
    yield Bound("camera.exposure_s", "exposure and readout of a frame", taken, period, "s", mend)
    if camera.trigger == "tick":
        needed = camera.exposure_s / 2 + camera.readout_s
        what, mend = "the time from mid-exposure to the tick", "half the exposure and the readout go first"
        lead = camera.trigger_lead_s
        yield Bound("camera.trigger_lead_s", what, lead, needed, "s", mend, at_least=True)


def _camera_source(config: Config, lockstep: bool) -> Iterator[Complaint]:
    source = config.camera.source
    try:
        found = load("robofleet.cameras", source)
    except PluginError as error:
        yield "camera.source", str(error)
    else:
        if lockstep and not issubclass(found, ScheduledCamera):
            yield "camera.source", f"{source!r} keeps real time, and lockstep does not: run without --lockstep"
        yield from getattr(found, "refusals", _none)(config)


def _none(_config: Config) -> tuple[Complaint, ...]:
    return ()


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()


def _rounded_down(value: float) -> float:
    """Return a number of three digits that is at most 1 % less, and not more."""
    return float(f"{0.995 * value:.3g}")
