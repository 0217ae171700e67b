"""The barrier of ``safety/barrier.py`` with its solids, its right-hand rule and its quadratic program, in JAX.

Arrays end with (A, N): arenas and robots, or with (A, M): bodies. All rows of ``safety/nearest.py`` are always there,
(R, A, N): one that does not apply has a limit that nothing reaches. All pairs of bodies are compared.

In an environment all bodies are seen, no bystander moves, and every robot may drive: the terms of these cases are left
out. So are the counters of blocked robots: no environment reads them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from robofleet.core.arrays import Array
from robofleet.envs.jax.plant import arc, chord_share, velocities
from robofleet.safety import barrier as cbf
from robofleet.safety import deadlock, nearest, solid_rows
from robofleet.vehicles import solids
from robofleet.vehicles.differential_drive import wheels_from_body

_FAR = 1e9  # the limit of a row that does not apply [m/s]

Row = tuple[jax.Array, jax.Array, jax.Array]


class Rows(NamedTuple):
    """a x + b y <= c, with normals (a, b) of size 1: (R, A, N) each."""

    a: jax.Array
    b: jax.Array
    c: jax.Array

    def over(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Return by how much each row is broken (R, A, N)."""
        return self.a * x + self.b * y - self.c

    def excess(self, x: jax.Array, y: jax.Array) -> jax.Array:
        return jnp.maximum(0.0, self.over(x, y).max(axis=0))


class BarrierState(NamedTuple):
    """What a barrier remembers of robots (A, N): the speeds of the last ticks (T, A, N), and of deadlocks."""

    lately: jax.Array
    held: jax.Array  # this line and the next five: as in deadlock.py
    turn: jax.Array
    vain: jax.Array
    clear: jax.Array
    stalls: jax.Array
    watched: jax.Array
    window: jax.Array  # (5, A, N): the pose at its start, and what was commanded since


class Stops(NamedTuple):
    """Points q of the poses (A, M) where bodies come to rest, and their velocities by one of v, and of l omega."""

    x: jax.Array
    y: jax.Array
    v_x: jax.Array
    v_y: jax.Array
    turn_x: jax.Array
    turn_y: jax.Array


class Barrier:
    """The barrier of N robots among M bodies; ``constants`` as ``safety.barrier`` makes them."""

    def __init__(self, constants: cbf.Constants, robots: int) -> None:
        self._k, self._n = constants, robots
        self._share = min(1.0, constants.rate * constants.tick)

    def fresh(self, arenas: int) -> BarrierState:
        """Return the memory at first."""
        lately = cbf.fresh(self._k).lately[: self._n].T[:, None]
        none = np.zeros((arenas, self._n), np.int64)
        return BarrierState(
            np.repeat(lately, arenas, axis=1), none, none, none, none, none, none, np.zeros((5, *none.shape))
        )

    def filter(
        self, poses: jax.Array, turning: jax.Array, wheels: jax.Array, memory: BarrierState
    ) -> tuple[jax.Array, BarrierState]:
        """Return wheels (2, A, N) changed where they must be; poses (3, A, M), turning (2, A, M)."""
        k, n = self._k, self._n
        radius, base, _, _, top, *_ = k.bodies[:n].T
        stops = self._stops(poses, turning)
        v, omega = velocities(wheels, radius, base)
        x, y = v, k.point_ahead * omega
        asking = (jnp.hypot(x, y) > deadlock._ASKS * top) & (memory.stalls == 0)
        rows, obstacles, others = self._rows(stops, self._believed(turning, memory))
        along, across, memory = self._answer(x, y, rows, obstacles, others, asking, memory)
        changed, finite = (along != x) | (across != y), jnp.isfinite(along + across)
        along, across = jnp.where(finite, along, 0.0), jnp.where(finite, across, 0.0)
        wheels = jnp.where(changed, jnp.stack(wheels_from_body(along, across / k.point_ahead, radius, base)), wheels)
        v, omega = velocities(wheels, radius, base)
        memory = memory._replace(lately=jnp.concatenate([memory.lately[1:], jnp.abs(v)[None]]))
        return wheels, self._watch(poses[:, :, :n], v * k.tick, k.point_ahead * omega * k.tick, memory)

    def _believed(self, turning: jax.Array, memory: BarrierState) -> jax.Array:
        """Return how far bodies (A, M) that in truth stand are believed to have gone [m]."""
        bodies, n = self._k.bodies, self._n
        speed = jnp.abs(velocities(turning, bodies[:, cbf._WHEEL], bodies[:, cbf._BASE])[0])
        members = jnp.maximum(speed[:, :n], memory.lately.max(axis=0))
        bystanders = jnp.broadcast_to(bodies[n:, cbf._TOP], speed[:, n:].shape)  # as ``cbf.fresh`` has them
        return bodies[:, cbf._BELIEVED] * jnp.concatenate([members, bystanders], axis=1)

    def _stops(self, poses: jax.Array, turning: jax.Array) -> Stops:
        """Return where bodies come to rest, as ``barrier._stop``."""
        radius, base, lag, *_ = self._k.bodies.T
        ahead, l = self._k.ahead, self._k.point_ahead
        v, omega = velocities(turning, radius, base)
        x, y, psi = arc(poses[0], poses[1], poses[2], v, omega, lag)
        half = omega * lag / 2.0
        chord, small = chord_share(half), jnp.abs(half) <= 1e-4
        slope = jnp.where(small, -half / 3.0, (jnp.cos(half) - chord) / jnp.where(small, 1.0, half))
        along, c, s = v * lag / 2.0, jnp.cos(poses[2] + half), jnp.sin(poses[2] + half)
        ahead_x, ahead_y = ahead * jnp.cos(psi), ahead * jnp.sin(psi)
        return Stops(
            x + ahead_x, y + ahead_y, chord * c, chord * s,
            (along * (slope * c - chord * s) - ahead_y) / l, (along * (slope * s + chord * c) + ahead_x) / l,
        )  # fmt: skip

    def _rows(self, stops: Stops, believed: jax.Array) -> tuple[Rows, int, int]:
        """Return all rows, and the indices where those of obstacles begin, and those of other bodies."""
        k, n = self._k, self._n
        own = Stops(*(field[:, :n] for field in stops))
        wheel, base, _, wheel_speed, top, edge, fastest, *_ = k.bodies[:n].T
        back = -cbf._WITHDRAWING * top
        pairs, speed = self._pairs(own, stops, believed, back)
        turn, wheel_limit, rows = base / (2.0 * k.point_ahead), wheel * wheel_speed * cbf._INSIDE, []
        for sign in (1.0, -1.0):
            rows += [_row(sign, sign * turn, wheel_limit), _row(sign, -sign * turn, wheel_limit)]
            rows.append(_row(sign, 0.0, speed * cbf._INSIDE))
        for out_x, out_y in cbf._WALLS:
            left = abs(out_x) * k.half[0] + abs(out_y) * k.half[1] - edge - out_x * own.x - out_y * own.y
            rows.append(_towards(own, out_x, out_y, jnp.maximum(k.rate * left, back)))
        firsts = []
        for rings in (k.rings[: k.floors], k.rings[k.floors :]):
            firsts.append(len(rows))
            for ring in rings:
                rows += self._solid(ring, own, edge, fastest, back)
        singles = (jnp.stack([jnp.broadcast_to(row[part], own.x.shape) for row in rows]) for part in range(3))
        return Rows(*map(jnp.concatenate, zip(singles, pairs, strict=True))), firsts[1], len(rows)

    def _pairs(self, own: Stops, stops: Stops, believed: jax.Array, back: Array) -> tuple[Row, jax.Array]:
        """Return a row for each body (M, A, N), as ``barrier._pair``, and how fast robots may be beside them all."""
        k, n, share = self._k, self._n, self._share
        _, _, _, _, top, _, fastest, trusted, disc = k.bodies[:n].T
        other_x, other_y, others = (field.T[:, :, None] for field in (stops.x, stops.y, believed))
        another = np.arange(len(k.bodies))[:, None, None] != np.arange(n)
        x, y, either = other_x - own.x, other_y - own.y, jnp.maximum(believed[:, :n], others)
        distance, near = jnp.hypot(x, y), disc + k.bodies[:, cbf._DISC, None, None] + sum(k.between)
        allowed = (1.0 - share) * (distance - near) + share * either
        speed = jnp.maximum(others, allowed) / np.where(trusted > 0.0, trusted, 1.0)
        speed = jnp.maximum(cbf._CREEPING * top, jnp.where(another & (trusted > 0.0), speed, top)).min(axis=0)
        left, reaches = distance - near - either, distance <= near + either + 2.0 * fastest / k.rate
        divisor = jnp.where(distance > 0.0, distance, 1.0)
        limit = jnp.maximum(k.rate * left / 2.0, back)
        row = _towards(own, x / divisor, y / divisor, limit, another & (distance > 0.0) & reaches)
        return row, jnp.minimum(speed, top)

    def _solid(self, ring: Array, own: Stops, edge: Array, fastest: Array, back: Array) -> list[Row]:
        """Return a row for each edge of a solid, and one for the way out of it, as ``solid_rows.solid_rows``."""
        first, last = int(ring[solids.FIRST]), int(ring[solids.LAST])
        from_x, from_y, to_x, to_y = self._k.edges[first:last].T[:, :, None, None]
        kept = edge + ring[solids.RADIUS]
        near = kept + fastest / self._k.rate  # nothing that the robot can do breaks a row further away
        seen = jnp.hypot(own.x - ring[solids.X], own.y - ring[solids.Y]) <= ring[solids.REACH] + near
        along_x, along_y, off_x, off_y = to_x - from_x, to_y - from_y, own.x - from_x, own.y - from_y
        squared = along_x * along_x + along_y * along_y
        t = (off_x * along_x + off_y * along_y) / np.where(squared > 0.0, squared, 1.0)  # (E, A, N)
        within, begins = (t > 0.0) & (t < 1.0), (t <= 0.0) & (jnp.roll(t, 1, axis=0) >= 1.0)
        if last - first == 1:
            begins, inside = t <= 0.0, jnp.zeros_like(within)
        else:
            before_x, before_y = np.roll(along_x, 1, axis=0), np.roll(along_y, 1, axis=0)
            notch = before_x * along_y - before_y * along_x < 0.0  # where an edge begins
            corner = jnp.where(t >= 1.0, np.roll(notch, -1, axis=0), notch)
            inside = jnp.where(within, along_x * off_y - along_y * off_x > 0.0, corner)
        part = jnp.clip(t, 0.0, 1.0)
        x, y = part * along_x - off_x, part * along_y - off_y
        distance = jnp.hypot(x, y)
        exists, divisor = seen & (distance > 0.0), jnp.where(distance > 0.0, distance, 1.0)

        def away(x: jax.Array, y: jax.Array, distance: jax.Array, exists: jax.Array) -> Row:
            return _towards(own, x, y, jnp.maximum(self._k.rate * (distance - kept), back), exists)

        x, y = x / divisor, y / divisor
        edges = away(x, y, distance, exists & (within | begins) & (distance < near) & ~inside)
        least = jnp.argmin(distance, axis=0)[None]
        x, y, distance, exists = (
            jnp.take_along_axis(field, least, axis=0)[0] for field in (x, y, distance, exists & inside)
        )
        return [*zip(*edges, strict=True), away(-x, -y, -distance, exists)]

    def _answer(
        self, x: jax.Array, y: jax.Array, rows: Rows, obstacles: int, others: int, asking: jax.Array, m: BarrierState
    ) -> tuple[jax.Array, jax.Array, BarrierState]:
        """Return what robots get for (x, y), and remember whether they get on, as ``deadlock.answer``."""
        around, until_clear, *_ = self._k.times
        top, wanted = self._k.bodies[: self._n, cbf._TOP], jnp.hypot(x, y)
        broken = rows.over(x, y) > nearest.TOLERANCE
        met, walled = broken[obstacles:].any(axis=0), broken[obstacles:others].any(axis=0)
        asking = jnp.pad(asking, ((0, 0), (0, len(self._k.bodies) - self._n)))  # bystanders do not
        stands = walled | (broken[others:] & ~asking.T[:, :, None]).any(axis=0)
        pressing = met & (wanted > deadlock._WANTED * top)
        clear = jnp.where(met, 0, m.clear + 1)
        turn = jnp.where(clear >= until_clear, 0, m.turn)
        begins = pressing & (turn == 0) & (m.held >= around)
        turn, held, vain = jnp.where(begins, 1, turn), jnp.where(begins, 0, m.held), jnp.where(begins, 0, m.vain)
        turned = pressing & (turn > 0)
        c, s = jnp.array(deadlock._TURNS).T[:, jnp.maximum(turn, 1) - 1]
        turn_x, turn_y = jnp.where(turned, c * x + s * y, x), jnp.where(turned, c * y - s * x, y)
        along, across = nearest_point(turn_x, turn_y, rows)
        least = deadlock._GRANTED * wanted * wanted
        gets_on = x * along + y * across >= least
        stuck = met & (jnp.hypot(along, across) < deadlock._GRANTED * wanted)
        in_vain = jnp.where(walled, turn_x * along + turn_y * across < least, stuck)
        last = jnp.where(walled, len(deadlock._TURNS), deadlock._RIGHT)
        tried = jnp.where(in_vain, vain + 1, jnp.maximum(0, vain - 1))
        over = turned & (tried >= around)
        further = jnp.where(stands & (turn < last), turn + 1, 0)
        held_on = jnp.where(met, held + (pressing & ~gets_on), jnp.maximum(0, held - 1))
        return along, across, m._replace(
            held=jnp.where(turned, held, held_on), turn=jnp.where(over, further, turn),
            vain=jnp.where(over, 0, jnp.where(turned, tried, vain)), clear=clear,
        )  # fmt: skip

    def _watch(self, poses: jax.Array, along: jax.Array, across: jax.Array, m: BarrierState) -> BarrierState:
        """Remember whether robots stall, as ``deadlock.watch``."""
        x, y, psi, commanded_x, commanded_y = m.window
        begins, ends = m.watched == 0, m.watched >= self._k.times[3]
        turned = self._k.point_ahead * ((poses[2] - psi + np.pi) % (2.0 * np.pi) - np.pi)
        moved = jnp.hypot(jnp.hypot(poses[0] - x, poses[1] - y), turned)
        commanded = jnp.hypot(commanded_x, commanded_y)
        stalls = jnp.where(ends & (moved >= deadlock._STALL_MOVED * deadlock._STALL_M), 0, m.stalls)
        stalled = (commanded >= deadlock._STALL_M) & (moved < deadlock._STALL_MOVED * commanded)
        window = jnp.where(begins, jnp.concatenate([poses, jnp.zeros_like(m.window[3:])]), m.window)
        return m._replace(
            stalls=jnp.where(ends & stalled, 1, stalls), watched=jnp.where(ends, 0, m.watched + 1),
            window=window.at[3].add(along).at[4].add(across),
        )  # fmt: skip


def nearest_point(x: jax.Array, y: jax.Array, rows: Rows) -> tuple[jax.Array, jax.Array]:
    """Return the points nearest to (x, y) that keep all rows, as ``nearest.nearest``; NaN where there is none."""
    keeps = rows.excess(x, y) <= nearest.TOLERANCE
    first_x, first_y, found = _project(x, y, rows)
    relaxed = rows._replace(c=jnp.maximum(rows.c, 0.0))  # it cannot withdraw from all: not nearer to any
    second_x, second_y, found_then = _project(x, y, relaxed)
    cases, nan = [keeps, found, found_then], jnp.nan
    return jnp.select(cases, [x, first_x, second_x], nan), jnp.select(cases, [y, first_y, second_y], nan)


def _project(x0: jax.Array, y0: jax.Array, rows: Rows) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the points nearest to (x0, y0) that keep all rows, and whether they do, as ``nearest._project``."""
    index = jnp.arange(len(rows.a))[:, None, None]

    def keep(k: jax.Array, point: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        x, y, found = point
        a, b, c = rows.a[k], rows.b[k], rows.c[k]
        broken, over = a * x + b * y > c + nearest.TOLERANCE, a * x0 + b * y0 - c
        on_x, on_y = x0 - over * a, y0 - over * b
        left, along = -rows.over(on_x, on_y), rows.b * a - rows.a * b
        parallel, before = jnp.abs(along) < nearest.TOLERANCE, index < k
        share = left / jnp.where(parallel, 1.0, along)
        low = jnp.where(before & ~parallel & (along < 0.0), share, -jnp.inf).max(axis=0)
        high = jnp.where(before & ~parallel & (along > 0.0), share, jnp.inf).min(axis=0)
        none = (before & parallel & (left < -nearest._CHECKED)).any(axis=0) | (low > high + nearest._CHECKED)
        shift = jnp.minimum(jnp.maximum(0.0, low), high)
        return (
            jnp.where(broken, on_x - shift * b, x), jnp.where(broken, on_y + shift * a, y), found & ~(broken & none),
        )  # fmt: skip

    x, y, found = jax.lax.fori_loop(0, len(rows.a), keep, (x0, y0, jnp.ones_like(x0, bool)))
    return x, y, found & (rows.excess(x, y) <= nearest._CHECKED)


def _row(along: jax.Array | float, across: jax.Array | float, limit: jax.Array, exists: jax.Array | bool = True) -> Row:
    """Return the row along v + across (l omega) <= limit, scaled to a normal of size 1, as ``solid_rows.add_row``."""
    size = jnp.hypot(along, across)
    exists &= size >= solid_rows._LEAST
    divisor = jnp.where(exists, size, 1.0)
    return (
        jnp.where(exists, along / divisor, 0.0), jnp.where(exists, across / divisor, 0.0),
        jnp.where(exists, limit / divisor, _FAR),
    )  # fmt: skip


def _towards(stop: Stops, x: jax.Array, y: jax.Array, limit: jax.Array, exists: jax.Array | bool = True) -> Row:
    """Return the row of robots that go no faster than ``limit`` [m/s] in a direction (x, y)."""
    return _row(x * stop.v_x + y * stop.v_y, x * stop.turn_x + y * stop.turn_y, limit, exists)
