"""The controller: every 33 ms it reads, estimates, decides and publishes. It owns the flow's inputs and the filter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.interface import Wish, WishKind
from robofleet.bus.bus import Bus
from robofleet.bus.keys import COMMAND, STATE, TICK
from robofleet.bus.messages import (
    FLEET_POSES,
    RUN_STATE,
    TICK_RECORD,
    UNIT_COMMAND,
    UNIT_STATUS,
    Hurry,
    RobotTick,
    UnitCommand,
)
from robofleet.bus.statuses import HURRY_NS, Statuses
from robofleet.config import groups, slices
from robofleet.config.tree import Config
from robofleet.control import path, platoon, wheels
from robofleet.core.clock import Clock, S, TickGrid
from robofleet.core.compiling import Say, on_stderr, told
from robofleet.core.kernels import kernel
from robofleet.nodes import fleet
from robofleet.nodes.deciding import BehaviourRunner, Judge, untimed
from robofleet.nodes.leases import Leases
from robofleet.nodes.rescues import crawls
from robofleet.nodes.sighting import MeasurementUpdate
from robofleet.nodes.wishes import SetpointInbox
from robofleet.safety import barrier as safety_barrier
from robofleet.safety.supervisor import MOVING, Phase
from robofleet.safety.wiggle import STROKES, probe_speeds
from robofleet.tracking import estimator, measured
from robofleet.tracking.estimator import CARRIED, UNUSED
from robofleet.vehicles.differential_drive import feasible_ratio

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_NOTHING = np.uint64(0)  # as an epoch: nothing is said to this robot


@dataclass
class _Timing:
    """What the controller measures of itself."""

    overruns: int = 0
    lateness_ns: int = 0
    compute_ns: int = 0  # of the tick before


class _Parts(NamedTuple):
    """The parts of a tick's record (N, 15), as the fields of RobotTick are named: views of it."""

    pose: Array  # (N, 3)
    point: Array  # (N, 2)
    u: Array  # (N, 2)
    wheels: Array  # (N, 2)
    saturated: Array  # (N,), as those that follow
    measured: Array
    lost: Array
    filtered: Array
    blocked: Array
    failed: Array

    @classmethod
    def of(cls, record: Array) -> "_Parts":
        """Return the parts of a record."""
        names = RobotTick._fields

        def between(first: str, last: str) -> Array:
            return record[:, names.index(first) : names.index(last) + 1]

        several = (
            between("x_m", "psi_rad"), between("point_x_m", "point_y_m"), between("u_x_m_s", "u_y_m_s"),
            between("left_rad_s", "right_rad_s"),
        )  # fmt: skip
        return cls(*several, *(record[:, names.index(name)] for name in cls._fields[len(several) :]))


class Controller:
    """All groups' robots, group by group; the bystanders are seen, and kept clear of.

    ``judge`` calls the behaviours, and says which took too long.
    """

    def __init__(
        self, config: Config, bus: Bus, clock: Clock, rng: np.random.Generator, *, take_over: bool = False,
        judge: Judge = untimed,
    ) -> None:  # fmt: skip
        robots, c = config.members, config.controller
        self._config, self._clock = config, clock
        self._epoch, self._build = slices.drawn_id(rng, 32), slices.build(config)
        session = self._epoch << 32 | slices.drawn_id(rng, 32)
        self._tick_s = c.tick_s
        self._point_ahead, self._offset_free = c.point_ahead_m, c.disturbance == "estimated"
        self._lost_after_s = c.filter.lost_after_s
        self._sighting = MeasurementUpdate(config, bus, clock, self._epoch)
        self._drives = [slices.drive(robot) for robot in robots]
        self._statuses = Statuses(bus, config.units, [robot.id for robot in robots], by_radio=config.daemons)
        self._leases = Leases(bus, self._statuses, session, take_over=take_over)
        self._state, self._phases = bus.newest(STATE), groups.phases(config)
        units = self._statuses.units
        self._commands = [bus.publisher(COMMAND, unit.name) for unit in units]
        self._items = [np.zeros(unit.size, UNIT_COMMAND.item_dtype) for unit in units]
        self._places = [np.arange(unit.size)[unit.places] for unit in units]
        self._seq = 0  # of the newest command
        self._echoed = [0] * len(units)  # the nonce in each unit's newest one
        self._stale = [False] * len(units)  # whether it was in the one before, too
        self._publish_tick = bus.publisher(TICK)
        self._grid = TickGrid(clock.now_ns(), round(c.tick_s * S))
        self._index = 0
        self._timing = _Timing()
        self._record = np.zeros((len(robots), len(RobotTick._fields)))
        self._record_parts = _Parts.of(self._record)
        self._nobody = np.zeros(len(robots), dtype=np.bool_)
        self._deciding, self._groups = BehaviourRunner(config, judge), groups.rows(config.groups)
        self._setpoints = SetpointInbox(config, bus)
        self._crawls = crawls(config)
        self._unknown = np.zeros((len(robots), 2))
        self._begin()

    def _begin(self) -> None:
        """Know nothing of the fleet: at the start, and as long as somebody else drives these robots."""
        n = len(self._drives)
        self._deciding.begin()
        self._filter, self._barrier = fleet.fleet_filter(self._config), fleet.barrier(self._config)
        self._bystanders = fleet.bystanders(self._config)
        self._sighting.begin(self._filter, self._bystanders)
        self._wheels = np.zeros((n, 2))  # as commanded at the newest tick
        self._phase = Phase.IDLE
        self._run_tick = -1
        self._permitted = np.zeros(n, dtype=np.bool_)
        self._tried: list[tuple[int, int]] = []  # robots whose wheels are tried, and their strokes
        self._out: int | None = None  # the robot that a person drives out of a held run
        self._newest_word = (0, 0)  # epoch and seq of the supervisor's newest word

    def step(self, now_ns: int) -> int:
        """Do the newest tick that is due; ticks that were missed are counted and never made up.

        Between two ticks a robot whose link is bad is told its newest command again, echoing its newest nonce: of many
        that are lost or late one is in time. A controller that hangs repeats nothing.
        """
        index = self._grid.index_at(now_ns)
        if index > self._index:
            self._timing.overruns += index - self._index - 1
            self._timing.lateness_ns = now_ns - self._grid.instant(self._index + 1)  # of the first tick that was due
            self._index = index
            self._tick(self._grid.instant(index))
            self._timing.compute_ns = self._clock.now_ns() - now_ns
        else:
            self._repeat()
        next_ns = self._grid.instant(self._index + 1)
        hurries = self._statuses.by_radio or self._statuses.hurried()
        return min(next_ns, now_ns + HURRY_NS) if hurries else next_ns

    def close(self) -> None:
        """Nothing to bring to rest: the gates close when commands cease."""

    def _tick(self, tick_ns: int) -> None:
        silent = self._leases.refused
        self._hear_drivers()
        if self._leases.refused:  # somebody else drives these robots: not a word that could be taken for the other's
            if not silent:
                self._begin()
            return
        used = self._nobody
        if not silent:  # who begins anew takes nothing at first: by that the record tells it
            self._read_state()
            used = self._read_poses()
        unseen_s, moving = estimator.ages(self._filter.measured_ns, tick_ns), self._phase in MOVING
        lost = unseen_s > self._lost_after_s
        self._run_tick += self._phase is Phase.RUNNING
        setpoints = self._setpoints.at(self._index, self._phase)
        driving = self._permitted & ~lost if moving else self._driven_out(setpoints, lost)
        here, then, turning = self._filter.predict(tick_ns)
        w = self._filter.disturbance(then, self._point_ahead) if self._offset_free else self._unknown
        bodies, pushed = then, None
        if len(self._bystanders.measured_ns):
            bodies = np.concatenate([then, self._bystanders.predict(tick_ns)])
            pushed = np.concatenate([np.zeros_like(turning), self._bystanders.velocities])
            turning = np.concatenate([turning, np.zeros_like(self._bystanders.velocities)])
            unseen_s = np.concatenate([unseen_s, estimator.ages(self._bystanders.measured_ns, tick_ns)])
        self._deciding.tick(bodies, unseen_s < np.inf, driving, w, moving=moving, setpoints=setpoints)
        self._record_parts.filtered[:], self._record_parts.blocked[:] = self._barrier.filter(
            bodies, turning, unseen_s, driving, self._deciding.wheels, self._deciding.u, pushed
        )
        if self._out is not None:
            _crawl(self._deciding.wheels[self._out], self._deciding.u[self._out], float(self._crawls[self._out]))
        self._deciding.changed()
        commanded = self._deciding.wheels
        self._try_wheels(commanded)
        self._filter.command(tick_ns, commanded)
        self._wheels = commanded
        seq = self._seq
        for unit in range(len(self._commands)):
            self._command(unit)
        self._publish_record(tick_ns, here, used, lost, seq)

    def _read_state(self) -> None:
        payload = self._state.take()
        if payload is None or (message := RUN_STATE.view(payload)) is None:
            return
        state, robots = message
        self._newest_word = state.epoch, state.seq
        n = len(self._permitted)
        if state.phase in self._phases and len(robots) >= n:
            np.not_equal(robots["permitted"][:n], 0, out=self._permitted)
            strokes = robots["stroke"][:n].tolist() if state.phase == Phase.ARMED else []
            self._tried = [(row, stroke) for row, stroke in enumerate(strokes) if 0 < stroke < len(STROKES)]
            if state.phase != self._phase:
                resumed, self._phase = self._phase is Phase.HOLD, Phase(state.phase)
                if resumed and self._phase is self._deciding.phase:
                    self._deciding.resume()
                elif self._phase in MOVING:
                    self._run_tick = -1
                    self._deciding.restart(self._phase)

    def _driven_out(self, setpoints: Sequence[Wish | None], lost: Flags) -> Flags:
        """Return the one robot that the supervisor permits in a held run, if a person's wish is about it."""
        self._out = None
        permitted = np.flatnonzero(self._permitted).tolist() if self._phase is Phase.HOLD else []
        if len(permitted) != 1 or self._deciding.phase is not Phase.RUNNING or lost[permitted[0]]:
            return self._nobody
        (row,) = permitted
        for setpoint, own in zip(setpoints, self._groups, strict=True):
            if setpoint is None or setpoint.kind is not WishKind.RESCUE:
                continue
            if [own.start + k for k in np.flatnonzero(setpoint.told).tolist()] == [row]:
                self._out = row
                alone = self._nobody.copy()
                alone[row] = True
                return alone
        return self._nobody

    def _hear_drivers(self) -> None:
        self._statuses.take()
        self._leases.update()

    def _try_wheels(self, commanded: Array) -> None:
        """Let the robots that are being tried do their strokes."""
        for row, stroke in self._tried:
            drive = self._drives[row]
            left, right = probe_speeds(stroke, drive.wheel_radius)
            ratio = feasible_ratio(left, right, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
            commanded[row] = ratio * left, ratio * right

    def _read_poses(self) -> Flags:
        """Correct the filter by the cameras' newest images; returns which robots they measured."""
        used = self._sighting.read(self._index, self._grid)
        if used is None:
            return self._nobody
        if used.max() == CARRIED:
            for row in np.flatnonzero(used == CARRIED).tolist():
                self._deciding.carried(row)
        return np.not_equal(used, UNUSED)

    def _repeat(self) -> None:
        newer, statuses = self._statuses.take(), self._statuses
        if self._leases.refused:
            return
        for unit in (*statuses.hurried(), *filter(self._waits, statuses.by_radio.intersection(newer))):
            self._command(unit)

    def _waits(self, unit: int) -> bool:
        """Whether a unit on a radio, of which a status has just come, cannot wait for the next tick."""
        status = self._statuses.newest[unit]
        return status is not None and (status.hurry == Hurry.NOW or self._stale[unit])

    def _command(self, unit: int) -> None:
        """Command the robots of a unit that answer to this controller; if none does, nothing is said."""
        status, part, items = self._statuses.newest[unit], self._statuses.units[unit], self._items[unit]
        robots, mine = self._statuses.robots, self._leases.mine
        if status is None or not _fill_commands(items, robots, mine, part.numbers, self._places[unit], self._wheels):
            return
        self._seq += 1
        self._stale[unit], self._echoed[unit] = status.nonce == self._echoed[unit], status.nonce
        head = UnitCommand(
            self._seq, self._leases.session, status.boot_id, status.nonce, self._sighting.exposure_ns, ()
        )
        self._commands[unit](UNIT_COMMAND.encode_view(head, items))

    def _publish_record(self, tick_ns: int, here: Array, used: Flags, lost: Flags, seq: int) -> None:
        record_parts, decided = self._record_parts, self._deciding
        record_parts.pose[:], record_parts.point[:], record_parts.u[:], record_parts.wheels[:] = (
            here,
            decided.points,
            decided.u,
            decided.wheels,
        )
        record_parts.saturated[:], record_parts.measured[:], record_parts.lost[:], record_parts.failed[:] = (
            decided.saturated,
            used,
            lost,
            decided.failed,
        )
        running = self._phase is Phase.RUNNING
        head = (
            self._epoch, self._build, self._index, self._run_tick if running else -1, tick_ns,
            *self._sighting.taken[0], self._sighting.exposure_ns, *self._newest_word, seq,
            self._phase, decided.arrived, self._timing.overruns, self._timing.lateness_ns, self._timing.compute_ns,
        )  # fmt: skip
        self._publish_tick(
            TICK_RECORD.encode_array(head, self._record, decided.numbers.tobytes() + self._sighting.named)
        )


def _crawl(wheels: Array, u: Array, limit: float) -> None:
    """Slow a robot (2,) [rad/s], (2,) [m/s] on its arc down to a limit of its wheels: nearer to standing is safer."""
    fastest = float(np.abs(wheels).max())
    if fastest > limit:
        wheels *= limit / fastest
        u *= limit / fastest


@kernel
def _fill_commands(commands, statuses, mine, rows, places, wheels):  # type: ignore[no-untyped-def]
    """Write the wheels of the robots (K,) of a unit that are ours, and nothing for the others; returns if one is."""
    some = False
    for k in range(len(rows)):
        row, command = rows[k], commands[places[k]]
        command.epoch = statuses[row].epoch if mine[row] else _NOTHING  # an int beside it would make both floats
        command.left_rad_s, command.right_rad_s = wheels[row, 0], wheels[row, 1]
        some = some or mine[row]
    return some


def compile_kernels(config: Config, say: Say | None = None) -> None:
    """Compile every numba kernel of the control path, or load it from the cache, before the first tick.

    ``say`` is told how far it is; by default a line is written to stderr.
    """
    kernels = (
        *platoon.KERNELS,
        *path.KERNELS,
        *wheels.KERNELS,
        *measured.KERNELS,
        *estimator.KERNELS,
        *safety_barrier.KERNELS,
        _fill_commands,
    )
    with told("control", kernels, say or on_stderr()):
        _call_kernels(config)


def _call_kernels(config: Config) -> None:
    deciding, fleet_filter, barrier = BehaviourRunner(config), fleet.fleet_filter(config), fleet.barrier(config)
    to_start, to_park = config.run.begin == "go_to_start", config.run.end == "park"
    n = len(config.members)
    driving = np.ones(n, dtype=np.bool_)
    none, robots = np.zeros(0, np.intp), np.zeros(n, UNIT_STATUS.item_dtype)
    _fill_commands(np.zeros(0, UNIT_COMMAND.item_dtype), robots, driving, none, none, np.zeros((n, 2)))
    poses, instants_ns = np.empty((n, measured.COLUMNS)), np.empty(n, dtype=np.int64)
    nobody = np.frombuffer(b"", FLEET_POSES.item_dtype)  # read only, as what comes from the bus
    for instant_ns in (S, 2 * S):
        measured.placed(nobody, measured.rows_of({}), instant_ns, instant_ns, poses, instants_ns)
        fleet_filter.observe(np.full(n, instant_ns), np.zeros((n, measured.COLUMNS)))
        estimator.ages(fleet_filter.measured_ns, instant_ns)
        _, then, _ = fleet_filter.predict(instant_ns + 1)
        w = fleet_filter.disturbance(then, config.controller.point_ahead_m)
        bodies = np.zeros((len(config.bodies), 3))
        bodies[:n] = then
        deciding.tick(bodies, np.ones(len(bodies), dtype=np.bool_), driving, w, moving=True)
        barrier.filter(bodies, bodies[:, :2].copy(), bodies[:, 0].copy(), driving, deciding.wheels, deciding.u)
        for wanted, phase in ((to_start, Phase.POSITIONING), (to_park, Phase.PARKING)):
            if wanted:  # its behaviour rehearses by its first decisions
                deciding.restart(phase)
                deciding.tick(bodies, np.ones(len(bodies), dtype=np.bool_), driving, w, moving=True)
        deciding.restart(Phase.RUNNING)
        fleet_filter.command(instant_ns, deciding.wheels)
