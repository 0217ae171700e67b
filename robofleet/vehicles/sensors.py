"""What a robot senses beside its wheels: a kind's sensors, and simulated ones, in arrays for many robots at once.

Everything is in the robot's frame: origin at the middle of the axle, x ahead, y to the left, z up. Gyro and
accelerometer tell the mean over the time since the reading before, so the gyro's readings add up to the heading.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robofleet.core.arrays import Array
from robofleet.vehicles.readings import SensorReading, TruePose

GYRO, ACCELEROMETER, MAGNETOMETER, HEADING = 1, 2, 4, 8  # which of them a robot has, added up
_PARTS = (GYRO, slice(0, 3)), (ACCELEROMETER, slice(3, 6)), (MAGNETOMETER, slice(6, 9)), (HEADING, slice(9, 10))
_INERTIAL = 10  # numbers of a reading before its distances
MOST_DISTANCES = 32  # of one robot
_GRAVITY = 9.80665  # [m/s^2], standard
_PARALLEL = 1e-12  # a ray along a wall does not meet it


@dataclass(frozen=True)
class Errors:
    """The errors of a simulated sensor, in its reading's unit."""

    noise: tuple[float, ...]  # standard deviation of each axis, of one reading
    bias: float  # half width of each axis's constant error, which is drawn once, uniformly


@dataclass(frozen=True)
class DistanceSensors:
    """A robot's distance sensors: each sees what is first on one ray."""

    places: tuple[tuple[float, float, float], ...]  # x, y [m], direction [rad] of each; robot frame
    range: float  # [m]; what is farther away is not seen
    noise: float  # standard deviation, relative to the distance
    dropout: float  # share of the readings that see nothing though something is there
    outliers: float  # share of the other readings that are anything between 0 and the range


@dataclass(frozen=True)
class SensorKind:
    """The sensors of a kind of robot; None of what it has not."""

    period: float  # from one reading to the next [s]
    gyro: Errors | None = None  # [rad/s]
    accelerometer: Errors | None = None  # [m/s^2]
    accelerometer_place: tuple[float, float] = (0.0, 0.0)  # x, y [m]; robot frame
    magnetometer: Errors | None = None  # [T]
    field: tuple[float, float, float] = (0.0, 0.0, 0.0)  # magnetic field of the laboratory [T; world frame]
    heading: Errors | None = None  # [rad]
    distances: DistanceSensors | None = None

    @property
    def parts(self) -> int:
        """Which of GYRO, ACCELEROMETER, MAGNETOMETER and HEADING it has, added up."""
        has = self.gyro, self.accelerometer, self.magnetometer, self.heading
        return sum(part for (part, _), errors in zip(_PARTS, has, strict=True) if errors is not None)

    @property
    def places(self) -> tuple[tuple[float, float, float], ...]:
        return () if self.distances is None else self.distances.places


@dataclass(frozen=True)
class Sensing:
    """What a simulated robot's sensors are made from."""

    kind: SensorKind
    walls: tuple[tuple[float, float, float, float], ...]  # x, y of both ends of each [m; world]
    rng: "np.random.Generator"


class SimulatedSensors:
    """The sensors of some robots (n,) among all whose bodies they see (N,); ``rows``: their places among all."""

    def __init__(self, rows: Sequence[int], sensing: Sequence[Sensing]) -> None:
        """Take at least one robot; all have the same walls."""
        kinds = [sensing_kind.kind for sensing_kind in sensing]
        n, most = len(kinds), max(len(kind.places) for kind in kinds)
        self.rows = np.array(rows, np.intp)
        self.parts = np.array([kind.parts for kind in kinds], np.int64)
        self.counts = np.array([len(kind.places) for kind in kinds], np.int64)
        self.period_ns = round(min(kind.period for kind in kinds) * 1e9)
        self._rngs = [sensing_kind.rng for sensing_kind in sensing]
        self._noise, self._bias = np.zeros((n, _INERTIAL)), np.zeros((n, _INERTIAL))
        self.has = np.zeros((n, _INERTIAL + most), np.bool_)  # the numbers that are a robot's own
        self._at, self._distances = np.zeros((n, most, 3)), np.zeros((n, 4))
        for row, (kind, rng) in enumerate(zip(kinds, self._rngs, strict=True)):
            drawn = rng.uniform(-1.0, 1.0, _INERTIAL)
            four = kind.gyro, kind.accelerometer, kind.magnetometer, kind.heading
            for (_, part), errors in zip(_PARTS, four, strict=True):
                if errors is not None:
                    self.has[row, part] = True
                    self._noise[row, part], self._bias[row, part] = errors.noise, errors.bias * drawn[part]
            if (d := kind.distances) is not None:
                self._at[row, : len(d.places)] = d.places
                self._distances[row] = d.range, d.noise, d.dropout, d.outliers
                self.has[row, _INERTIAL : _INERTIAL + len(d.places)] = True
        self._lever = np.array([kind.accelerometer_place for kind in kinds])
        self._field = np.array([kind.field for kind in kinds])
        walls = np.array(sensing[0].walls, np.float64).reshape(-1, 4)
        self._walls, self._along = walls[:, :2], walls[:, 2:] - walls[:, :2]
        self._before: tuple[int, Array] | None = None  # when these sensors were read last, and how the robots moved

    def read(self, now_ns: int, truths: Array, radii: Array) -> Array:
        """Return what the sensors say (n, 10 + most distances): gyro, accelerometer, magnetometer, heading, distances.

        Args:
            now_ns: the instant [ns].
            truths: x, y [m], psi [rad], v [m/s], omega [rad/s] of all robots (N, 5); world and body frame.
            radii: of the discs that the robots' bodies are (N,) [m].

        NaN is a distance sensor that sees nothing; what is not in ``has`` means nothing.
        """
        own = truths[self.rows]
        values = np.empty(self.has.shape)
        self._inertial(now_ns, own, values)
        for row, rng in enumerate(self._rngs):
            values[row, :_INERTIAL] += self._bias[row] + self._noise[row] * rng.standard_normal(_INERTIAL)
        values[:, 9] = math.pi - np.remainder(math.pi - values[:, 9], math.tau)
        if values.shape[1] > _INERTIAL:
            self._see(self.true_distances(truths, radii), values[:, _INERTIAL:])
        return values

    def readings(self, values: Array) -> list[SensorReading]:
        """Return the rows of ``read`` as each robot's reading (n,)."""
        own = (row[has].tolist() for row, has in zip(values, self.has, strict=True))
        return [unpacked(int(p), int(c), n) for p, c, n in zip(self.parts, self.counts, own, strict=True)]

    def first(self, now_ns: int, truths: Sequence[TruePose], radii: Sequence[float]) -> SensorReading:
        """Return what the first of these robots' sensors says, among all of which something is known."""
        return self.readings(self.read(now_ns, np.array(truths), np.array(radii)))[0]

    def true_distances(self, truths: Array, radii: Array) -> Array:
        """Return how far away along each ray the first wall or body is (n, most) [m]; inf where there is none."""
        own, (x, y, direction) = truths[self.rows], self._at.transpose(2, 0, 1)
        c, s, towards = np.cos(own[:, 2:3]), np.sin(own[:, 2:3]), own[:, 2:3] + direction
        from_x, from_y = (own[:, 0:1] + c * x - s * y)[:, :, None], (own[:, 1:2] + s * x + c * y)[:, :, None]
        ray_x, ray_y = np.cos(towards)[:, :, None], np.sin(towards)[:, :, None]
        # Bodies (n, sensors, N): where the ray enters the disc.
        to_x, to_y = truths[:, 0] - from_x, truths[:, 1] - from_y
        ahead, beyond = to_x * ray_x + to_y * ray_y, to_x * to_x + to_y * to_y - radii * radii
        inside = ahead * ahead - beyond
        discs = np.where((inside >= 0.0) & (ahead > 0.0), ahead - np.sqrt(np.maximum(inside, 0.0)), np.inf)
        discs[beyond <= 0.0] = 0.0  # the sensor is in that body: they touch
        discs[np.arange(len(own)), :, self.rows] = np.inf  # nobody sees itself
        nearest = discs.min(axis=2, initial=np.inf)
        if len(self._walls):
            # Walls (n, sensors, walls): t along the ray, u along the wall.
            (wall_x, wall_y), (along_x, along_y) = self._walls.T, self._along.T
            to_x, to_y = wall_x - from_x, wall_y - from_y
            across = ray_x * along_y - ray_y * along_x
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                t, u = (to_x * along_y - to_y * along_x) / across, (to_x * ray_y - to_y * ray_x) / across
            met = (np.abs(across) > _PARALLEL) & (t >= 0.0) & (u >= 0.0) & (u <= 1.0)
            nearest = np.minimum(nearest, np.where(met, t, np.inf).min(axis=2))
        return np.asarray(nearest)

    def _inertial(self, now_ns: int, own: Array, values: Array) -> None:
        """Fill in what ideal sensors of the motion, the field and the heading say."""
        psi, v, omega = own[:, 2], own[:, 3], own[:, 4]
        turning, faster, spinning_up = omega, np.zeros_like(v), np.zeros_like(v)
        if self._before is not None and (passed := (now_ns - self._before[0]) * 1e-9) > 0.0:
            before = self._before[1]
            turned = psi - before[:, 2]
            turning = (turned - math.tau * np.round(turned / math.tau)) / passed
            faster, spinning_up = (v - before[:, 3]) / passed, (omega - before[:, 4]) / passed
        self._before = now_ns, own
        x, y = self._lever.T
        values[:, 0:2], values[:, 2] = 0.0, turning
        values[:, 3] = faster - spinning_up * y - turning**2 * x
        values[:, 4] = v * turning + spinning_up * x - turning**2 * y
        values[:, 5] = _GRAVITY
        c, s, (east, north, up) = np.cos(psi), np.sin(psi), self._field.T
        values[:, 6], values[:, 7], values[:, 8] = c * east + s * north, c * north - s * east, up
        values[:, 9] = psi

    def _see(self, distances: Array, seen: Array) -> None:
        """Fill in what the distance sensors say of true distances (n, most)."""
        count = distances.shape[1]
        normal = np.array([rng.standard_normal(count) for rng in self._rngs])
        lost, wrong, anything = np.array([rng.random((3, count)) for rng in self._rngs]).transpose(1, 0, 2)
        reach, noise, dropout, outliers = self._distances.T[:, :, None]
        near = np.minimum(distances, reach)
        noisy = np.clip(near * (1.0 + noise * normal), 0.0, reach)
        noisy = np.where(wrong < outliers, reach * anything, noisy)
        seen[:] = np.where((distances > reach) | (lost < dropout), np.nan, noisy)


def packed(reading: SensorReading) -> tuple[int, int, list[float]]:
    """Return which sensors a reading is of, how many distances it has, and its numbers in their order."""
    four = reading[0], reading[1], reading[2], None if reading.heading is None else (reading.heading,)
    parts = sum(part for (part, _), present in zip(_PARTS, four, strict=True) if present is not None)
    present = [value for value in (*four, reading.distances) if value is not None]
    distances = 0 if reading.distances is None else len(reading.distances)
    return parts, distances, [float(number) for value in present for number in value]


def numbers(parts: int, distances: int) -> int:
    """Return how many numbers a packed reading has."""
    return sum(part_slice.stop - part_slice.start for part, part_slice in _PARTS if parts & part) + distances


def unpacked(parts: int, distances: int, numbers: Sequence[float]) -> SensorReading:
    rest = iter(numbers)

    def axes(part: int) -> tuple[float, float, float] | None:
        return (next(rest), next(rest), next(rest)) if parts & part else None

    gyro, accelerometer, magnetometer = axes(GYRO), axes(ACCELEROMETER), axes(MAGNETOMETER)
    heading = next(rest) if parts & HEADING else None
    return SensorReading(gyro, accelerometer, magnetometer, heading, tuple(rest) if distances else None)


def is_sound(reading: SensorReading) -> bool:
    """Return whether each axis has its number, finite but for a distance that is NaN, and the message has room."""
    axes = [vector for vector in reading[:3] if vector is not None]
    finite = [number for vector in axes for number in vector] + [0.0 if reading.heading is None else reading.heading]
    distances = () if reading.distances is None else reading.distances
    return (
        all(len(vector) == 3 for vector in axes)
        and math.isfinite(sum(finite))
        and len(distances) <= MOST_DISTANCES
        and not any(map(math.isinf, distances))
    )
