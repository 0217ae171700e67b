"""The equations of ``safety/gate.py`` (its ramp) and ``vehicles/plant.py`` in JAX, for a tick of all robots at once.

Arrays end with (A, N): arenas and robots. Units are those of the two modules. Instants [ns] count from the beginning of
the tick, so that they fit 32 bits. Each robot cuts time at its own instants: a loop goes on until all reach the end.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from robofleet.core.arrays import Array
from robofleet.safety import gate
from robofleet.vehicles import plant
from robofleet.vehicles.differential_drive import body_from_wheels

_NS = 1e-9


class Build(NamedTuple):
    """How robots are built, as ``plant.Build``. Where there are two rows, they are of the left and the right wheel."""

    wheel_radius: jax.Array
    wheel_base: jax.Array
    max_wheel_speed: jax.Array
    motor_lag: jax.Array
    stop_lag: jax.Array
    count: jax.Array  # resolution of the encoders [rad]; 0: they are ideal
    deadband: jax.Array
    breakaway: jax.Array
    slip: jax.Array
    slip_noise: jax.Array
    top_speed_sag: jax.Array
    battery_life: jax.Array
    gains: jax.Array  # (2, A, N)
    signs: jax.Array  # (2, A, N)
    swapped: jax.Array
    longest_step_ns: jax.Array
    delay_ns: jax.Array

    @staticmethod
    def of(builds: np.ndarray) -> "Build":
        """Return rows (A, N) of ``simulation.bodies.BUILD``."""
        both = {name: np.stack([builds[f"left_{name}"], builds[f"right_{name}"]]) for name in ("gain", "sign")}
        own = {name: builds[name] for name in Build._fields if name in (builds.dtype.names or ())}
        count = builds["speed_quantum"] * builds["loop_period"]
        delay_ns = np.maximum(builds["delay_ns"], 0)
        return Build(**{**own, "delay_ns": delay_ns}, count=count, gains=both["gain"], signs=both["sign"])


class Body(NamedTuple):
    """Robots' state, as ``plant.Body``; of their wheels (2, A, N)."""

    x: jax.Array
    y: jax.Array
    psi: jax.Array
    used: jax.Array
    angles: jax.Array
    speeds: jax.Array
    counted: jax.Array


class Gates(NamedTuple):
    """What gates remember, and their outputs in the newest tick and in H - 1 ticks before it.

    While an output is on its way to its target, it is renewed every ``gate.RAMP_NS``: at K instants of a tick at most.
    """

    output: jax.Array  # (2, A, N) [rad/s]
    target: jax.Array  # (2, A, N)
    elapsed_ns: jax.Array  # since it was renewed last
    outputs: jax.Array  # (H, K, 2, A, N)
    renewed: jax.Array  # (H, A, N): the last one of these instants, from 0


def placed(starts: np.ndarray) -> Body:
    """Return robots that stand at poses (A, N, 3)."""
    x, y, psi = np.moveaxis(starts, -1, 0)
    none, wheels = np.zeros(x.shape), np.zeros((2, *x.shape))
    return Body(x, y, psi, none, wheels, wheels, wheels)


def closed(shape: tuple[int, int], tick_ns: int, ticks: int) -> Gates:
    """Return gates (A, N) whose outputs were 0 for H ticks."""
    wheels, renewals = np.zeros((2, *shape)), -(-tick_ns // gate.RAMP_NS)
    return Gates(
        wheels, wheels, np.zeros(shape, np.int64), np.zeros((ticks, renewals, *wheels.shape)),
        np.zeros((ticks, *shape), np.int64),
    )  # fmt: skip


def obey(g: Gates, wheels: jax.Array, acceleration: jax.Array, tick_ns: int) -> Gates:
    """Return gates after a tick in which wheels (2, A, N) were commanded [rad/s], with an acceleration [rad/s^2]."""
    output, target, elapsed_ns, outputs = g.output, g.target, g.elapsed_ns, []
    renewed = jnp.zeros_like(elapsed_ns)
    for _ in range(g.outputs.shape[1]):
        longest_ns = jnp.where((output == target).all(axis=0), gate.RAMP_NS, gate.LONGEST_RAMP_NS)
        reach = acceleration * jnp.minimum(elapsed_ns, longest_ns) * _NS
        way = wheels - output
        furthest = jnp.abs(way).max(axis=0)
        ratio = reach / jnp.where(furthest > reach, furthest, 1.0)
        output, target = jnp.where(furthest > reach, output + ratio * way, wheels), wheels
        outputs.append(output)
        renewed += (output != wheels).any(axis=0)
        elapsed_ns = jnp.full_like(elapsed_ns, gate.RAMP_NS)
    renewed = jnp.minimum(renewed, len(outputs) - 1)
    return Gates(
        output, target, tick_ns - renewed * gate.RAMP_NS,
        jnp.concatenate([g.outputs[1:], jnp.stack(outputs)[None]]), jnp.concatenate([g.renewed[1:], renewed[None]]),
    )  # fmt: skip


def advance(b: Body, p: Build, g: Gates, key: jax.Array | None, tick_ns: int) -> Body:
    """Return bodies after the newest tick of their gates; ``key``: of the random numbers; None: without noise."""
    ticks, renewals = g.outputs.shape[:2]
    outputs = g.outputs.reshape(ticks * renewals, *g.output.shape)

    def instants(at_ns: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the rows of the outputs at instants (A, N), and when the next ones follow."""
        tick = at_ns // tick_ns  # the newest one is 0
        step = (at_ns - tick * tick_ns) // gate.RAMP_NS
        renewed = _row(g.renewed, tick + ticks - 1)
        next_ns = jnp.where(step < renewed, tick * tick_ns + (step + 1) * gate.RAMP_NS, (tick + 1) * tick_ns)
        return (tick + ticks - 1) * renewals + step, next_ns

    def step(loop: tuple[jax.Array, jax.Array, Body]) -> tuple[jax.Array, jax.Array, Body]:
        at_ns, draws, body = loop
        row, acts_ns = instants(at_ns - p.delay_ns)
        end_ns = jnp.minimum(jnp.minimum(instants(at_ns)[1], acts_ns + p.delay_ns), at_ns + p.longest_step_ns)
        moving = at_ns < tick_ns
        duration = jnp.where(moving, end_ns - at_ns, gate.RAMP_NS) * _NS
        noise = 0.0 if key is None else jax.random.normal(jax.random.fold_in(key, draws), body.speeds.shape)
        stepped = _step(body, p, _row(outputs, row), duration, noise)
        body = jax.tree.map(lambda new, old: jnp.where(moving, new, old), stepped, body)
        return jnp.where(moving, end_ns, at_ns), draws + 1, body

    start = jnp.zeros_like(p.delay_ns), jnp.zeros((), p.delay_ns.dtype), b
    _, _, body = jax.lax.while_loop(lambda loop: (loop[0] < tick_ns).any(), step, start)
    return Body(*body)


def _row(rows: jax.Array, index: jax.Array) -> jax.Array:
    """Return each robot's row (..., A, N) of rows (R, ..., A, N), by an index (A, N)."""
    if len(rows) == 1:
        return rows[0]
    index = jnp.expand_dims(index, tuple(range(rows.ndim - index.ndim)))
    return jnp.take_along_axis(rows, index, axis=0, mode="clip")[0]


def _step(b: Body, p: Build, commands: jax.Array, duration: jax.Array, noise: jax.Array | float) -> Body:
    """Return bodies after durations > 0 [s] with constant commands (2, A, N), as ``plant.step``."""
    used = b.used + duration
    top = p.max_wheel_speed * (1.0 - p.top_speed_sag * jnp.minimum(1.0, used / p.battery_life))
    setpoints = jnp.where(p.swapped, commands[::-1], p.signs * commands)
    means, angles, speeds, counted = _turn(p, b.angles, b.speeds, b.counted, setpoints, top, duration)
    rolled = p.gains * means
    turning = p.slip * jnp.abs(velocities(rolled, p.wheel_radius, p.wheel_base)[1])
    rolled *= 1.0 - turning * jnp.maximum(0.0, 1.0 + p.slip_noise * noise)
    v, omega = velocities(rolled, p.wheel_radius, p.wheel_base)
    x, y, psi = arc(b.x, b.y, b.psi, v, omega, duration)
    return Body(x, y, psi, used, angles, speeds, counted)


def _turn(
    p: Build, angle: jax.Array, speed: jax.Array, counted: jax.Array, command: jax.Array, top: jax.Array,
    duration: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:  # fmt: skip
    """Return mean speeds of wheels, then their angles, speeds and counted angles, as ``plant.turned``."""
    held = jnp.abs(command) < jnp.where(speed != 0.0, p.deadband, p.breakaway)
    speed = jnp.where(held & (jnp.abs(speed) < plant._AT_REST), 0.0, speed)
    target = jnp.where(held, 0.0, jnp.clip(command, -top, top))
    lag = jnp.where(target != 0.0, p.motor_lag, p.stop_lag)
    decay = jnp.where(lag > 0.0, jnp.exp(-duration / _or_1(lag)), 0.0)
    ahead = speed - target
    mean, speed = target + ahead * (1.0 - decay) * lag / duration, target + ahead * decay
    travelled = angle + mean * duration
    seen = jnp.where(p.count > 0.0, p.count * jnp.floor(travelled / _or_1(p.count)), travelled)
    unseen = (travelled - seen) - (angle - counted)
    counts = (p.count > 0.0) & (target != 0.0) & (p.motor_lag > 0.0)
    speed += jnp.where(counts, unseen / _or_1(p.motor_lag), 0.0)
    return mean, travelled, speed, jnp.where(p.count > 0.0, seen, counted)


def _or_1(divisor: jax.Array) -> jax.Array:
    return jnp.where(divisor > 0.0, divisor, 1.0)


def velocities(wheels: jax.Array, radius: jax.Array | Array, base: jax.Array | Array) -> tuple[jax.Array, jax.Array]:
    """Return v [m/s] and omega [rad/s] of wheels (2, ...) [rad/s]."""
    return body_from_wheels(wheels[0], wheels[1], radius, base)  # type: ignore[arg-type]


def arc(
    x: jax.Array, y: jax.Array, psi: jax.Array, v: jax.Array, omega: jax.Array, duration: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:  # fmt: skip
    """Return poses after constant body velocities, as ``differential_drive.arc``."""
    half = omega * duration / 2.0
    chord, heading = v * duration * chord_share(half), psi + half
    psi += omega * duration
    return (
        x + chord * jnp.cos(heading), y + chord * jnp.sin(heading),
        psi - 2.0 * jnp.pi * jnp.ceil((psi - jnp.pi) / (2.0 * jnp.pi)),
    )  # fmt: skip


def chord_share(half: jax.Array) -> jax.Array:
    """Return a chord's length relative to its arc's, of half the angle."""
    small = jnp.abs(half) < 1e-4
    return jnp.where(small, 1.0 - half * half / 6.0, jnp.sin(half) / jnp.where(small, 1.0, half))
