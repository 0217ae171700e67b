"""``envs/arenas.py`` in JAX: all robots of all arenas at once, on the device that JAX finds.

With the noise off a step is that of numba's arenas to rounding (1e-15 m). Over time: plants alone stay within 1e-12 m
for 20 s, with the barrier in a crowd within 1e-5 m for 10 s. Then a rounding may decide what an encoder counts: after
20 s some arenas are 0.5 mm apart, as numba's own are where their starts differ by 1e-15 m. With numbers of 32 bits
plants are 0.5 mm and 0.7 mrad apart after 20 s.

Random numbers are JAX's own: the same seed gives other ones than in numba's arenas, in steps.

Nobody has tried it on an accelerator yet: JAX's CPU backend ran the tests, and there it is slower than numba.
"""

from dataclasses import astuple
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from robofleet.config import barrier as config_barrier
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.clock import S
from robofleet.envs.jax import plant
from robofleet.envs.jax.barrier import Barrier, BarrierState
from robofleet.envs.jax.plant import Body, Build, Gates
from robofleet.envs.robots import Builds
from robofleet.safety import barrier as safety_barrier
from robofleet.simulation.bodies import BUILD
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import wheels_from_body


class State(NamedTuple):
    """Everything that changes, as a pytree; all arrays end with (A, N)."""

    build: Build
    body: Body
    gates: Gates
    memory: BarrierState
    seen: jax.Array  # (3, A, N) poses with noise
    velocities: jax.Array  # (2, A, N) as ``Arenas.velocities``


class JaxArenas:
    """Arenas with the arguments, attributes and methods of ``envs.arenas.Arenas``; ``threads`` are JAX's own.

    Attributes:
        state: Of all robots, on JAX's device.
        advance: The pure step, compiled, for loops of JAX's own: (state, velocities, of_body, key) to state. Call it
            within ``jax.enable_x64(double)``.
    """

    def __init__(
        self, config: Config, count: int, seed: int, *, builds: Builds, barrier: bool = True, double: bool = True
    ) -> None:
        """Put robots nowhere: ``reset`` every arena first.

        Args:
            config: The configuration of a run.
            count: A.
            seed: Of all random numbers.
            builds: Draws the robots (N,) of a new episode.
            barrier: Whether the barrier changes commands. Only an environment can do without.
            double: Whether numbers have 64 bits, or 32.
        """
        bodies = tuple(config_barrier.body(config, robot) for robot in config.bodies)
        n = len(config.members)
        self._build, self._double = builds, double
        self._barrier = Barrier(safety_barrier.constants(config_barrier.keepout(config), bodies), n)
        self._barrier_on = barrier
        drives = tuple(body.drive for body in bodies[:n])
        self._radius, self._base, self._max_wheel, self._max_speed, _, self._acceleration = np.array(
            [astuple(drive) for drive in drives]
        ).T
        self._l, self._tick_ns = config.controller.point_ahead_m, round(config.controller.tick_s * S)
        truth = config.tracker.truth
        self._sigma = np.array([truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad])
        self._slips = any(slices.imperfections(robot).slip_noise > 0.0 for robot in config.members)
        self._standing = np.array([slices.start_pose(robot) for robot in config.bystanders]).reshape(-1, 3)
        self.advance, self._put, self._delay_ticks = jax.jit(self._step), jax.jit(_put), 0
        self.ticks = np.zeros(count, dtype=np.int64)
        self.state: State | None = None
        self.seed(seed)

    def __len__(self) -> int:
        """Return A."""
        return len(self.ticks)

    def seed(self, seed: int) -> None:
        """Begin anew with random numbers."""
        self._rng = np.random.default_rng(seed)
        self._key = jax.random.key(seed)

    def close(self) -> None:
        """Do nothing: JAX's threads are its own."""

    def reset(self, arenas: Indices, starts: Array) -> None:
        """Begin anew in some arenas (K,), where the members stand at ``starts`` (K, N, 3), with robots newly drawn."""
        if len(arenas) == 0:
            return
        with jax.enable_x64(self._double):
            fresh = self._fresh(starts)
            if self.state is None:
                self.state = jax.tree.map(lambda array: jnp.repeat(array[..., :1, :], len(self), axis=-2), fresh)
            gates = self.state.gates
            if (more := len(fresh.gates.outputs) - len(gates.outputs)) > 0:
                gates = gates._replace(outputs=_longer(gates.outputs, more), renewed=_longer(gates.renewed, more))
            padding = np.full((1 << (len(arenas) - 1).bit_length()) - len(arenas), len(arenas) - 1)
            rows = np.concatenate([np.arange(len(arenas)), padding])  # few lengths: _put is compiled for each
            fresh = jax.tree.map(lambda array: array[..., rows, :], fresh)
            self.state = self._put(self.state._replace(gates=gates), fresh, arenas[rows])
        self.ticks[arenas] = 0
        self._publish()

    def step(self, velocities: Array, of_body: Flags) -> None:
        """Let every arena pass a tick; arguments as ``envs.arenas.Arenas.step``."""
        assert self.state is not None, "reset every arena first"
        with jax.enable_x64(self._double):
            self._key, key = jax.random.split(self._key)
            self.state = self.advance(self.state, velocities, of_body, key)
        self.ticks += 1
        self._publish()

    def _publish(self) -> None:
        assert self.state is not None
        body, seen = self.state.body, self.state.seen
        self.truths = self._everybody(np.stack([body.x, body.y, body.psi], axis=-1))
        self.poses = self._everybody(np.moveaxis(np.asarray(seen), 0, -1))
        self.velocities = np.moveaxis(np.asarray(self.state.velocities), 0, -1)

    def _everybody(self, poses: Array) -> Array:
        """Return poses of members (A, N, 3) with those of the bystanders."""
        return np.concatenate([poses, np.broadcast_to(self._standing, (len(poses), *self._standing.shape))], axis=1)

    def _fresh(self, starts: Array) -> State:
        """Return arenas where robots (K, N) that are newly drawn stand at poses (K, N, 3)."""
        shape = starts.shape[:2]
        builds = np.array([[astuple(build) for build in self._build(self._rng)] for _ in range(shape[0])], BUILD)
        delay_ticks = -(-int(builds["delay_ns"].max()) // self._tick_ns)
        self._delay_ticks = max(self._delay_ticks, delay_ticks)
        seen = starts + self._sigma * self._rng.standard_normal(starts.shape)
        return State(
            Build.of(builds), plant.placed(starts), plant.closed(shape, self._tick_ns, 1 + self._delay_ticks),
            self._barrier.fresh(shape[0]), np.moveaxis(seen, -1, 0), np.zeros((2, *shape)),
        )  # fmt: skip

    def _step(self, state: State, velocities: jax.Array, of_body: jax.Array, key: jax.Array) -> State:
        body, (pose_key, slip_key) = state.body, jax.random.split(key)
        wheels, memory = self._limited(velocities, of_body, state.seen[2]), state.memory
        if self._barrier_on:
            standing = jnp.broadcast_to(self._standing.T[:, None], (3, len(velocities), len(self._standing)))
            poses = jnp.concatenate([state.seen, standing], axis=2)
            turning = jnp.concatenate([body.speeds, jnp.zeros_like(standing[:2])], axis=2)
            wheels, memory = self._barrier.filter(poses, turning, wheels, memory)
        gates = plant.obey(state.gates, wheels, self._acceleration, self._tick_ns)
        body = plant.advance(body, state.build, gates, slip_key if self._slips else None, self._tick_ns)
        seen = jnp.stack([body.x, body.y, body.psi])
        if self._sigma.any():
            seen += self._sigma[:, None, None] * jax.random.normal(pose_key, seen.shape)
        return State(
            state.build, body, gates, memory, seen, jnp.stack(plant.velocities(wheels, self._radius, self._base))
        )

    def _limited(self, velocities: jax.Array, of_body: jax.Array, psi: jax.Array) -> jax.Array:
        """Return wheels (2, A, N) [rad/s] within their limits, as ``control.wheels.limited``."""
        first, second = jnp.moveaxis(velocities, -1, 0)
        c, s = jnp.cos(psi), jnp.sin(psi)
        v = jnp.where(of_body, first, c * first + s * second)
        omega = jnp.where(of_body, second, (c * second - s * first) / self._l)
        wheels = jnp.stack(wheels_from_body(v, omega, self._radius, self._base))
        fastest = jnp.abs(wheels).max(axis=0) / self._max_wheel
        fastest = jnp.maximum(fastest, self._radius * jnp.abs(wheels.sum(axis=0)) / 2.0 / self._max_speed)
        return wheels * (differential_drive._INSIDE / jnp.maximum(fastest, differential_drive._INSIDE))


def _put(state: State, fresh: State, arenas: jax.Array) -> State:
    put: State = jax.tree.map(lambda old, new: old.at[..., arenas, :].set(new), state, fresh)
    return put


def _longer(history: jax.Array, ticks: int) -> jax.Array:
    """Return a history that begins earlier: who needs that is new."""
    return jnp.concatenate([jnp.zeros((ticks, *history.shape[1:]), history.dtype), history])
