"""The true world, as the simulated drivers publish it."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Stream
from robofleet.bus.keys import TRUTH, key
from robofleet.bus.messages import UNIT_TRUTH
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Instants
from robofleet.core.kernels import kernel, kernel_of_plain
from robofleet.vehicles import differential_drive

_HISTORY = 32  # true samples a robot, 10 ms apart
NOBODY = -1  # as a row: a robot of which nothing is kept
_FAR = 1e9  # [m, rad] beyond any arena and heading: such a truth is none
_GOES_ON_NS = 100_000_000  # after its newest sample a robot is taken to go on; then its driver is gone

_arc = kernel_of_plain(differential_drive.arc)


class World:
    """The true poses that the simulated drivers publish: all that a simulated source knows of its N robots.

    Between two samples a robot moved along the arc of the earlier one's body velocity, corrected so that it ends where
    the later one is. After the newest one it goes on for a little.
    """

    def __init__(self, config: Config, robots: Sequence[Robot], bus: Bus) -> None:
        self.tags = [robot.tag for robot in robots]
        rows = {robot.id: row for row, robot in enumerate(robots)}
        self._streams: list[tuple[Stream, NDArray[np.intp]]] = [
            (
                bus.stream(key(config.arena.name, TRUTH, unit), capacity=_HISTORY),
                np.array([rows.get(robot, NOBODY) for robot in members], np.intp),
            )
            for unit, members in config.units.items()
            if not rows.keys().isdisjoint(members)
        ]
        n = len(robots)
        # A ring of stamps and samples for each robot, and the count of all its samples.
        self._history = np.zeros((n, _HISTORY), np.int64), np.zeros((n, _HISTORY, 5)), np.zeros(n, np.int64)
        self.moving(np.zeros(n, np.int64), 1)  # compiles, or loads
        self.reported_at(0)
        take(*self._history, np.zeros(0, np.intp), 0, np.frombuffer(b"", UNIT_TRUTH.item_dtype))

    def update(self) -> None:
        """Take what the drivers said since the last call."""
        for stream, rows in self._streams:
            for _, _, payload in stream.drain():
                if (message := UNIT_TRUTH.view(payload)) is not None:
                    truth, robots = message
                    take(*self._history, rows, truth.stamp_ns, robots)

    def moving(self, instants_ns: Instants, half_ns: int) -> tuple[Array, Array]:
        """Return the poses (N, 3) and velocities (N, 3) [m/s, rad/s] over so long before and after the instants (N,).

        Before its first sample a robot is at that one; NaN of a robot that has not spoken yet.
        """
        return moving(*self._history, instants_ns, half_ns)

    def reported_at(self, instant_ns: int) -> Array:
        """Return poses (N, 3) at one instant; NaN also of a robot whose driver has told nothing that can be used for
        long.

        An image shows a robot wherever it stands; where there is none, only its own word tells where it is.
        """
        return reported_at(*self._history, instant_ns)


@kernel
def take(  # type: ignore[no-untyped-def]
    stamps, samples, count, rows, stamp_ns, truths
):
    """Add what a unit says of its robots (K,) in one message; ``rows``: of each place in the unit, or NOBODY.

    A sample that is not a robot's newest, or no pose, is ignored.
    """
    capacity = stamps.shape[1]
    for truth in truths:
        n = rows[truth.place] if truth.place < len(rows) else NOBODY
        if n == NOBODY or not (abs(truth.x_m) < _FAR and abs(truth.y_m) < _FAR and abs(truth.psi_rad) < _FAR):
            continue
        if count[n] and stamp_ns <= stamps[n, (count[n] - 1) % capacity]:
            continue
        at = count[n] % capacity
        stamps[n, at] = stamp_ns
        samples[n, at, 0], samples[n, at, 1], samples[n, at, 2] = truth.x_m, truth.y_m, truth.psi_rad
        samples[n, at, 3], samples[n, at, 4] = truth.v_m_s, truth.omega_rad_s
        count[n] += 1


@kernel
def reported_at(stamps: Instants, samples: Array, count: Instants, instant_ns: int) -> Array:
    poses, capacity = np.full((len(stamps), 3), np.nan), stamps.shape[1]
    for n in range(len(stamps)):
        if count[n] > 0 and instant_ns - stamps[n, (count[n] - 1) % capacity] <= _GOES_ON_NS:
            poses[n, 0], poses[n, 1], poses[n, 2] = _pose_at(stamps[n], samples[n], count[n], instant_ns)
    return poses


@kernel
def moving(
    stamps: Instants, samples: Array, count: Instants, instants_ns: Instants, half_ns: int
) -> tuple[Array, Array]:
    poses, velocities = np.empty((len(stamps), 3)), np.empty((len(stamps), 3))
    per_s = 0.5e9 / half_ns
    for n in range(len(stamps)):
        x = y = psi = x_late = y_late = psi_late = 0.0
        for instant_ns in (instants_ns[n] - half_ns, instants_ns[n] + half_ns):
            x, y, psi = x_late, y_late, psi_late
            x_late, y_late, psi_late = _pose_at(stamps[n], samples[n], count[n], instant_ns)
        d_x, d_y, turned = x_late - x, y_late - y, _remainder(psi_late - psi)
        # The middle of an arc lies beside that of its chord.
        poses[n, 0] = x + d_x / 2.0 + 0.125 * turned * d_y
        poses[n, 1] = y + d_y / 2.0 - 0.125 * turned * d_x
        poses[n, 2] = psi + turned / 2.0
        velocities[n, 0], velocities[n, 1], velocities[n, 2] = d_x * per_s, d_y * per_s, turned * per_s
    return poses, velocities


@kernel
def _pose_at(stamps: Instants, samples: Array, count: int, stamp_ns: int) -> tuple[float, float, float]:
    if count == 0:
        return np.nan, np.nan, np.nan
    capacity = len(stamps)
    oldest = max(0, count - capacity)
    k = count - 1
    while k > oldest and stamps[k % capacity] > stamp_ns:
        k -= 1
    at = k % capacity
    x, y, psi, v, omega = samples[at, 0], samples[at, 1], samples[at, 2], samples[at, 3], samples[at, 4]
    if stamps[at] > stamp_ns:
        return x, y, psi
    elapsed_s = min(stamp_ns - stamps[at], _GOES_ON_NS) * 1e-9
    there_x, there_y, there_psi = _arc(x, y, psi, v, omega, elapsed_s)
    if k + 1 == count:
        return there_x, there_y, there_psi
    after = (k + 1) % capacity
    step_s = (stamps[after] - stamps[at]) * 1e-9
    end_x, end_y, end_psi = _arc(x, y, psi, v, omega, step_s)
    share = (elapsed_s / step_s) ** 2  # the velocity changed evenly over the step
    return (
        there_x + share * (samples[after, 0] - end_x),
        there_y + share * (samples[after, 1] - end_y),
        _remainder(there_psi + share * _remainder(samples[after, 2] - end_psi)),
    )


@kernel
def _remainder(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


KERNELS = (reported_at, moving, take)  # that are called from Python
