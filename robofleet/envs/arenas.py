"""Many arenas at once, step by step: the wheels' limits, barrier, gates' ramps and plant of a run, in arrays.

A step begins when a tick's commands act: what lies before, the delay that the controller knows of, is what its filter
predicts in a run. So the poses that a policy sees are true ones with the noise of ``tracker.truth``, and a delay that
the controller does not know of is the plant's.

Arenas are stepped in chunks, by as many threads as there are cores. Each chunk has random numbers of its own, so the
same seed gives the same numbers on any machine.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from robofleet.config import barrier as config_barrier
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.control import wheels
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.clock import S
from robofleet.core.kernels import free_kernel, kernel
from robofleet.core.rows import row_of
from robofleet.envs import lanes, normals
from robofleet.envs.robots import Builds
from robofleet.safety import barrier as safety_barrier
from robofleet.safety.gate import DRIVE, GATE, GateState
from robofleet.simulation.bodies import BODY, BUILD, COMING
from robofleet.vehicles import differential_drive, plant

_CHUNK = 256  # arenas that share random numbers
_UNDER_WAY = 16  # commands of a robot that do not act yet, at most: 80 ms of them
_drive, _draw = lanes.drive, normals.draw
_limit_commands, _filter_commands = wheels.limit_commands, safety_barrier.filter_commands
_body_from_wheels = kernel(differential_drive.body_from_wheels)
_LANES = lanes.LANES


class Arenas:
    """Arenas (A,) with the members (N,) and bystanders of a configuration, M bodies in all.

    Attributes:
        poses: Poses when the next commands act (A, M, 3): x, y [m], psi [rad; world], as the controller sees them.
        truths: The same without noise.
        velocities: What was commanded at the step before, after limits and barrier (A, N, 2): v [m/s], omega [rad/s].
        ticks: Steps since each arena was reset (A,).
    """

    def __init__(
        self, config: Config, count: int, seed: int, *, builds: Builds, barrier: bool = True, threads: int | None = None
    ) -> None:
        """Put robots nowhere: ``reset`` every arena first.

        Args:
            config: The configuration of a run.
            count: A.
            seed: Of all random numbers.
            builds: Draws the robots (N,) of a new episode.
            barrier: Whether the barrier changes commands. Only an environment can do without.
            threads: How many step the arenas. None: one for each core.
        """
        bodies = tuple(config_barrier.body(config, robot) for robot in config.bodies)
        n, m = len(config.members), len(bodies)
        self._build, self._barrier_on = builds, barrier
        self._constants = safety_barrier.constants(config_barrier.keepout(config), bodies)
        self._fresh = safety_barrier.fresh(self._constants)
        self._limits = wheels.limits(tuple(body.drive for body in bodies[:n]))
        self._drives = np.array([row_of(body.drive) for body in bodies[:n]], DRIVE)
        self._tick_ns = round(config.controller.tick_s * S)
        loop_s = min(slices.imperfections(robot).loop_period for robot in config.members)
        self._steps = lanes.steps(self._tick_ns, round(loop_s * S))
        self._now_ns = S  # 0 means "never" in many fields
        truth = config.tracker.truth
        self._sigma = np.array([truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad])
        self.truths, self.poses = np.zeros((count, m, 3)), np.zeros((count, m, 3))
        for row, robot in enumerate(config.bystanders):
            self.truths[:, n + row] = slices.start_pose(robot)
        self.velocities, self.ticks = np.zeros((count, n, 2)), np.zeros(count, dtype=np.int64)
        self._new_body = np.array(row_of(plant.placed((0.0, 0.0, 0.0), 0)), BODY)
        self._new_gate = np.array(row_of(GateState(boot_id=1)), GATE)
        self._arrays = (
            np.zeros((count, n), BODY), np.zeros((count, n), BUILD), np.zeros((count, n, _UNDER_WAY), COMING),
            np.zeros((count, n), GATE), np.zeros((count, m, 2)),
            *(np.repeat(array[None], count, axis=0) for array in self._fresh),
        )  # fmt: skip
        every = (self.poses, self.truths, self.velocities, *self._arrays)
        self._chunks = [tuple(array[k : k + _CHUNK] for array in every) for k in range(0, count, _CHUNK)]
        self.seed(seed)
        threads = min(threads or len(os.sched_getaffinity(0)), len(self._chunks))
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._driving = np.ones(n, dtype=np.bool_)

    def __len__(self) -> int:
        """Return A."""
        return len(self.ticks)

    def seed(self, seed: int) -> None:
        """Begin anew with random numbers."""
        rngs = np.random.default_rng(seed).spawn(1 + len(self._chunks))
        self._rng, self._streams = rngs[0], [normals.streams(rng) for rng in rngs[1:]]

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def reset(self, arenas: Indices, starts: Array) -> None:
        """Begin anew in some arenas (K,), where the members stand at ``starts`` (K, N, 3), with robots newly drawn."""
        bodies, builds, coming, gates, turning, *memory = self._arrays
        for arena in arenas.tolist():
            builds[arena] = [row_of(build) for build in self._build(self._rng)]
            for array, fresh in zip(memory, self._fresh, strict=True):
                array[arena] = fresh
        coming[arenas], bodies[arenas], gates[arenas] = 0, self._new_body, self._new_gate
        for k, name in enumerate(("x", "y", "psi")):
            bodies[name][arenas] = starts[..., k]
        bodies["reached_ns"][arenas] = gates["at_ns"][arenas] = self._now_ns
        turning[arenas], self.velocities[arenas], self.ticks[arenas] = 0.0, 0.0, 0
        self.truths[arenas, : starts.shape[1]] = starts
        self.poses[arenas] = self.truths[arenas]
        self.poses[arenas, : starts.shape[1]] += self._sigma * self._rng.standard_normal(starts.shape)

    def step(self, velocities: Array, of_body: Flags) -> None:
        """Let every arena pass a tick.

        Args:
            velocities: What the members are asked for (A, N, 2): v [m/s] and omega [rad/s] where ``of_body``, else
                velocities of the points ahead [m/s; world].
            of_body: (N,).
        """
        velocities = np.ascontiguousarray(velocities, np.float64)

        def chunk(k: int) -> None:
            rows = slice(k * _CHUNK, (k + 1) * _CHUNK)
            _step(
                velocities[rows],
                of_body,
                *self._chunks[k],
                self._streams[k],
                self._steps,
                self._driving,
                self._limits,
                self._drives,
                self._sigma,
                self._barrier_on,
                self._now_ns,
                self._tick_ns,
                *self._constants,
            )  # type: ignore[call-arg]

        if self._pool is None:
            for k in range(len(self._chunks)):
                chunk(k)
        else:
            list(self._pool.map(chunk, range(len(self._chunks))))
        self._now_ns += self._tick_ns
        self.ticks += 1


@free_kernel
def _step(  # type: ignore[no-untyped-def]
    velocities, of_body, poses, truths, obeyed, bodies, builds, coming, gates, turning, holds, lately, deadlocks,
    streams, steps, driving, limits, drives, sigma, barrier_on, now_ns, tick_ns, constants, between, half, edges, rings,
    floors, ahead, rate, l, age, lost_after, tick, times, patience,
):  # fmt: skip
    count, n, m = velocities.shape[0], velocities.shape[1], poses.shape[1]
    points, u, commands, saturated = np.empty((n, 2)), np.empty((n, 2)), np.empty((count, n, 2)), np.empty(n)
    change, blocked = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    unseen, pushed = np.full(m, age), np.zeros((m, 2))
    for a in range(count):
        _limit_commands(velocities[a], of_body, poses[a], l, limits, driving, points, u, commands[a], saturated)
        if barrier_on:
            _filter_commands(
                poses[a], turning[a], unseen, pushed, driving, commands[a], u, change, blocked, holds[a], lately[a],
                deadlocks[a], constants, between, half, edges, rings, floors, ahead, rate, l, age, lost_after, tick,
                times, patience,
            )  # fmt: skip
    plan, rows, noise = np.empty(steps * lanes.STEP), np.empty(lanes.LANE_ROWS), np.empty(2 * _LANES)
    _drive(
        bodies.reshape(-1), builds.reshape(-1), coming.reshape(count * n, coming.shape[2]), gates.reshape(-1), drives,
        commands.reshape(count * n, 2), now_ns, tick_ns, plan, rows, streams, noise,
    )  # fmt: skip
    drawn = 2 * _LANES
    for a in range(count):
        for i in range(n):
            b = bodies[a, i]
            obeyed[a, i, 0], obeyed[a, i, 1] = _body_from_wheels(
                commands[a, i, 0], commands[a, i, 1], limits[i, 0], limits[i, 1]
            )
            turning[a, i, 0], turning[a, i, 1] = b.left_speed, b.right_speed
            truths[a, i, 0], truths[a, i, 1], truths[a, i, 2] = b.x, b.y, b.psi
            for k in range(3):
                if drawn == 2 * _LANES:
                    _draw(streams, noise)
                    drawn = 0
                poses[a, i, k] = truths[a, i, k] + sigma[k] * noise[drawn]
                drawn += 1


KERNELS = (_step,)  # that are called from Python
