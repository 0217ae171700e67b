"""The controller: every 33 ms it measures, predicts, decides, limits, filters, commands and records."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.interface import Wish, WishKind
from robofleet.bus.bus import Answer, Bus
from robofleet.bus.keys import COMMAND, LEASE, STATE, TICK
from robofleet.bus.messages import (
    FLEET_POSES,
    LEASE_REQUEST,
    RUN_STATE,
    TICK_RECORD,
    UNIT_COMMAND,
    UNIT_STATUS,
    LeaseRequest,
    LinkState,
    RobotTick,
    UnitCommand,
)
from robofleet.bus.statuses import URGENT_PERIOD_NS, Statuses
from robofleet.config import groups, slices
from robofleet.config.tree import Config
from robofleet.control import following, platoon
from robofleet.control import wheels as wheel_limits
from robofleet.control.wheels import Request
from robofleet.core.clock import Clock, S, TickGrid
from robofleet.core.compiling import Say, on_stderr, told
from robofleet.core.kernels import kernel
from robofleet.nodes import fleet
from robofleet.nodes.behaviour_runner import BehaviourRunner, Judge, untimed
from robofleet.nodes.fleet_estimate import FleetEstimate, Prediction
from robofleet.nodes.rescues import crawls
from robofleet.nodes.setpoints import SetpointInbox
from robofleet.safety import barrier as safety_barrier
from robofleet.safety.barrier import Filtered
from robofleet.safety.gate import LeaseAction
from robofleet.safety.supervisor import MOVING, Phase
from robofleet.safety.wiggle import STROKES, probe_speeds
from robofleet.tracking.filter import estimator
from robofleet.tracking.filter.estimator import CARRIED, UNUSED
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
        self._point_ahead_m = c.point_ahead_m
        self._estimate = FleetEstimate(config, bus, clock, self._epoch)
        self._drives = fleet.drives(config)
        self._limits = wheel_limits.limits(self._drives)
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
        self._nobody = np.zeros(len(robots), dtype=np.bool_)
        self._runner, self._groups = BehaviourRunner(config, judge), groups.rows(config.groups)
        self._setpoints = SetpointInbox(config, bus)
        self._crawls = crawls(config)
        self._robots = np.zeros((len(robots), len(RobotTick._fields)))  # of a tick's record
        self._begin()

    def _begin(self) -> None:
        """Know nothing of the fleet: at the start, and as long as somebody else drives these robots."""
        n = len(self._drives)
        self._runner.begin()
        self._estimate.begin()
        self._barrier = fleet.barrier(self._config)
        self._wheels = np.zeros((n, 2))  # as commanded at the newest tick
        self._phase = Phase.IDLE
        self._run_tick = -1
        self._permitted = np.zeros(n, dtype=np.bool_)
        self._tried: list[tuple[int, int]] = []  # robots whose wheels are tried, and their strokes
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
        hurries = self._statuses.by_radio or self._statuses.urgent_units
        return min(next_ns, now_ns + URGENT_PERIOD_NS) if hurries else next_ns

    def close(self) -> None:
        """Nothing to bring to rest: the gates close when commands cease."""

    def _tick(self, tick_ns: int) -> None:
        """Measure, predict, decide, limit, filter, command, record."""
        begins = self._leases.refused
        self._statuses.take()
        self._leases.update()
        if self._leases.refused:  # somebody else drives these robots: not a word that could be taken for the other's
            if not begins:
                self._begin()
            return
        used = self._nobody
        if not begins:  # who begins anew takes nothing at first: by that the record tells it
            self._read_state()
            used = self._measure()
        self._run_tick += self._phase is Phase.RUNNING
        prediction = self._estimate.predict(tick_ns)
        setpoints = self._setpoints.at(self._index, self._phase)
        driving, rescued = self._drivers(setpoints, prediction.lost)
        decisions = self._runner.decide(
            prediction.poses, prediction.unseen_s < np.inf, driving, prediction.disturbance,
            moving=self._phase in MOVING, setpoints=setpoints,
        )  # fmt: skip
        request = wheel_limits.limited(
            decisions.velocities, decisions.of_body, prediction.poses, self._point_ahead_m, self._limits,
            decisions.driving,
        )  # fmt: skip
        filtered = self._barrier.filter(
            prediction.poses, prediction.turning, prediction.unseen_s, driving, request.wheels, request.u,
            prediction.pushed,
        )  # fmt: skip
        final, seq = self._final(filtered, rescued), self._seq
        self._command(tick_ns, final.wheels)
        self._record(tick_ns, used, prediction, decisions.numbers, request, final, seq)

    def _measure(self) -> Flags:
        """Correct the estimate by the cameras' newest images; returns which robots they measured."""
        used = self._estimate.measure(self._index, self._grid)
        if used is None:
            return self._nobody
        for row, use in enumerate(used.tolist()):
            if use == CARRIED:
                self._runner.carried(row)
        return np.not_equal(used, UNUSED)

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
                if resumed and self._phase is self._runner.phase:
                    self._runner.resume()
                elif self._phase in MOVING:
                    self._run_tick = -1
                    self._runner.restart(self._phase)

    def _drivers(self, setpoints: Sequence[Wish | None], lost: Flags) -> tuple[Flags, int | None]:
        """Return which robots may drive, and the one of them that a person drives out of a held run."""
        if self._phase in MOVING:
            return self._permitted & ~lost, None
        rescued = self._rescued(setpoints, lost) if self._phase is Phase.HOLD else None
        return self._nobody if rescued is None else np.arange(len(lost)) == rescued, rescued

    def _rescued(self, setpoints: Sequence[Wish | None], lost: Flags) -> int | None:
        """Return the one robot that the supervisor permits in a held run, if a person's setpoint is about it."""
        permitted = np.flatnonzero(self._permitted).tolist()
        if len(permitted) != 1 or self._runner.phase is not Phase.RUNNING or lost[permitted[0]]:
            return None
        for setpoint, own in zip(setpoints, self._groups, strict=True):
            if setpoint is None or setpoint.kind is not WishKind.RESCUE:
                continue
            if [own.start + k for k in np.flatnonzero(setpoint.told).tolist()] == permitted:
                return int(permitted[0])
        return None

    def _final(self, filtered: Filtered, rescued: int | None) -> Filtered:
        """Return what is commanded: what the barrier let through, less of a robot that is rescued, none of those whose
        behaviours failed at last, and the strokes of robots whose wheels are tried. It is written over ``filtered``."""
        wheels, u = filtered.wheels, filtered.u
        if rescued is not None:
            fastest, limit = float(np.abs(wheels[rescued]).max()), float(self._crawls[rescued])
            if fastest > limit:  # nearer to standing on its arc is safer
                wheels[rescued] *= limit / fastest
                u[rescued] *= limit / fastest
        if (failed := self._runner.changed(u)) is not None:
            wheels[failed], u[failed] = 0.0, 0.0
        for row, stroke in self._tried:
            drive = self._drives[row]
            left, right = probe_speeds(stroke, drive.wheel_radius)
            ratio = feasible_ratio(left, right, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
            wheels[row] = ratio * left, ratio * right
        return filtered

    def _command(self, tick_ns: int, wheels: Array) -> None:
        """Command a tick's wheels (N, 2) [rad/s]."""
        self._estimate.command(tick_ns, wheels)
        self._wheels = wheels
        for unit in range(len(self._commands)):
            self._command_unit(unit)

    def _repeat(self) -> None:
        newer, statuses = self._statuses.take(), self._statuses
        if self._leases.refused:
            return
        for unit in (*statuses.urgent_units, *filter(self._waits, statuses.by_radio.intersection(newer))):
            self._command_unit(unit)

    def _waits(self, unit: int) -> bool:
        """Whether a unit on a radio, of which a status has just come, cannot wait for the next tick."""
        status = self._statuses.newest[unit]
        return status is not None and (status.hurry == LinkState.BAD or self._stale[unit])

    def _command_unit(self, unit: int) -> None:
        """Command the robots of a unit that answer to this controller; if none does, nothing is said."""
        status, part, items = self._statuses.newest[unit], self._statuses.units[unit], self._items[unit]
        robots, mine = self._statuses.robots, self._leases.mine
        if status is None or not _fill_commands(items, robots, mine, part.numbers, self._places[unit], self._wheels):
            return
        self._seq += 1
        self._stale[unit], self._echoed[unit] = status.nonce == self._echoed[unit], status.nonce
        head = UnitCommand(
            self._seq, self._leases.session, status.boot_id, status.nonce, self._estimate.exposure_ns, ()
        )
        self._commands[unit](UNIT_COMMAND.encode_view(head, items))

    def _record(
        self, tick_ns: int, used: Flags, prediction: Prediction, numbers: Array, request: Request, final: Filtered,
        seq: int,
    ) -> None:  # fmt: skip
        """Publish what a tick read, and what came of it."""
        _fill_record(
            self._robots, prediction.now, request.points, final.u, final.wheels, request.saturated,
            used, prediction.lost, final.change, final.blocked, self._runner.failed,
        )  # fmt: skip
        running = self._phase is Phase.RUNNING
        head = (
            self._epoch, self._build, self._index, self._run_tick if running else -1, tick_ns,
            *self._estimate.taken[0], self._estimate.exposure_ns, *self._newest_word, seq,
            self._phase, self._runner.arrived, self._timing.overruns, self._timing.lateness_ns, self._timing.compute_ns,
        )  # fmt: skip
        self._publish_tick(TICK_RECORD.encode_array(head, self._robots, numbers.tobytes() + self._estimate.named))


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


@kernel
def _fill_record(  # type: ignore[no-untyped-def]
    robots, poses, points, u, wheels, saturated, used, lost, change, blocked, failed
):
    """Write the robots (N,) of a tick's record, each the fields of a RobotTick."""
    for k in range(len(robots)):
        row = robots[k]
        row[0], row[1], row[2] = poses[k, 0], poses[k, 1], poses[k, 2]
        row[3], row[4] = points[k, 0], points[k, 1]
        row[5], row[6] = u[k, 0], u[k, 1]
        row[7], row[8] = wheels[k, 0], wheels[k, 1]
        row[9], row[10], row[11] = saturated[k], used[k], lost[k]
        row[12], row[13], row[14] = change[k], blocked[k], failed[k]


def compile_kernels(config: Config, say: Say | None = None) -> None:
    """Compile every numba kernel of the control path, or load it from the cache, before the first tick.

    ``say`` is told how far it is; by default a line is written to stderr.
    """
    kernels = (
        *platoon.KERNELS,
        *following.KERNELS,
        *wheel_limits.KERNELS,
        *estimator.KERNELS,
        *safety_barrier.KERNELS,
        _fill_commands,
        _fill_record,
    )
    with told(kernels, say or on_stderr()):
        _call_kernels(config)


def _call_kernels(config: Config) -> None:
    for law in (platoon, following):  # every law that comes with robofleet: another configuration compiles none then
        law.rehearse(fleet.drives(config)[0])
    runner, fleet_filter, barrier = BehaviourRunner(config), fleet.fleet_filter(config), fleet.barrier(config)
    to_start, to_park = config.run.begin == "go_to_start", config.run.end == "park"
    n, c = len(config.members), config.controller
    everybody, driving = np.ones(len(config.bodies), dtype=np.bool_), np.ones(n, dtype=np.bool_)
    none, robots = np.zeros(0, np.intp), np.zeros(n, UNIT_STATUS.item_dtype)
    _fill_commands(np.zeros(0, UNIT_COMMAND.item_dtype), robots, driving, none, none, np.zeros((n, 2)))
    poses, instants_ns = np.empty((n, estimator.COLUMNS)), np.empty(n, dtype=np.int64)
    nobody = np.frombuffer(b"", FLEET_POSES.item_dtype)  # read only, as what comes from the bus
    for instant_ns in (S, 2 * S):
        estimator.measurements(nobody, estimator.rows_of({}), instant_ns, instant_ns, poses, instants_ns)
        fleet_filter.observe(np.full(n, instant_ns), np.zeros((n, estimator.COLUMNS)))
        estimator.ages(fleet_filter.measured_ns, instant_ns)
        now, then, _ = fleet_filter.predict(instant_ns + 1)
        w = fleet_filter.disturbance(then, c.point_ahead_m)
        bodies = np.zeros((len(config.bodies), 3))
        bodies[:n] = then
        decided = runner.decide(bodies, everybody, driving, w, moving=True)
        limits = wheel_limits.limits(fleet.drives(config))
        request = wheel_limits.limited(decided.velocities, decided.of_body, bodies, c.point_ahead_m, limits, driving)
        final = barrier.filter(bodies, bodies[:, :2].copy(), bodies[:, 0].copy(), driving, request.wheels, request.u)
        _fill_record(
            np.zeros((n, len(RobotTick._fields))), now, request.points, final.u, final.wheels, request.saturated,
            driving, driving, final.change, final.blocked, runner.failed,
        )  # fmt: skip
        for wanted, phase in ((to_start, Phase.POSITIONING), (to_park, Phase.PARKING)):
            if wanted:  # its behaviour rehearses by its first decisions
                runner.restart(phase)
                runner.decide(bodies, everybody, driving, w, moving=True)
        runner.restart(Phase.RUNNING)
        fleet_filter.command(instant_ns, request.wheels)


_ASK_AGAIN_TICKS = 10


class Leases:
    """The leases of this controller: asked for until every unit has granted them, or somebody else holds one.

    ``take_over``: each is taken once also from a controller that is alive; who loses it then does not take it back.
    """

    def __init__(self, bus: Bus, statuses: Statuses, session: int, *, take_over: bool = False) -> None:
        self._bus, self._statuses, self.session = bus, statuses, session
        units = statuses.units
        self._actions = [LeaseAction.TAKE_OVER if take_over else LeaseAction.ACQUIRE] * len(units)
        self._requests: list[Answer | None] = [None] * len(units)
        self._again = [0] * len(units)
        self._session = np.uint64(session)
        self._held = statuses.robots["session"]  # (N,) by whom; a view
        self.mine = np.zeros(len(statuses.robots), np.bool_)  # (N,) which robots answer to this controller
        self.refused = False  # somebody else holds the lease of a robot

    def update(self) -> None:
        """Ask every unit that is there and of which a robot is not ours, every few ticks."""
        held = self._held.tolist()
        if held.count(self.session) == len(held):
            self.mine.fill(True)
            self.refused = False
            self._actions = [LeaseAction.ACQUIRE] * len(self._actions)
            return
        np.equal(self._held, self._session, out=self.mine)
        self.refused = bool((~self.mine & (self._held != 0)).any())
        for number, unit in enumerate(self._statuses.units):
            if self._statuses.newest[number] is None:
                continue
            if self.mine[unit.rows].all():
                self._actions[number] = LeaseAction.ACQUIRE
                continue
            self._again[number] -= 1
            if self._again[number] < 0:
                self._again[number] = _ASK_AGAIN_TICKS
                request = LEASE_REQUEST.encode(LeaseRequest(self.session, self._actions[number]))
                self._requests[number] = self._bus.ask(LEASE, unit.name, request)
