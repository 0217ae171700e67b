"""The controller: every 33 ms it reads, estimates, decides and publishes. It owns the flow's inputs and the filter."""

import math
from dataclasses import dataclass

import numpy as np

from robofleet.clock import Clock, S, TickGrid
from robofleet.comms.bus import Bus, Inbox
from robofleet.comms.keys import CAMERA, COMMAND, POSES, STATE, TICK
from robofleet.comms.messages import (
    FLEET_POSES,
    RUN_STATE,
    TICK_RECORD,
    WHEEL_COMMAND,
    FleetPoses,
    WheelCommand,
)
from robofleet.comms.statuses import HURRY_NS, Statuses
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.control import path, platoon, wheels
from robofleet.processes import fleet
from robofleet.processes.compiling import Say, on_stderr, told
from robofleet.processes.deciding import Deciding, Judge, untimed
from robofleet.processes.leases import Leases
from robofleet.safety import barrier as safety_barrier
from robofleet.safety.supervisor import MOVING, Phase
from robofleet.safety.wiggle import PROBE_RAD_S, STROKES
from robofleet.tracking import estimator
from robofleet.tracking.estimator import CARRIED, UNUSED
from robofleet.vehicles.differential_drive import feasible_ratio

_UNSEEN = [math.nan] * 3
_PHASES = tuple(Phase)
_STALE_TICKS = 15  # poses that echo an older tick come from a network that stood still


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
        self._leases = Leases(bus, [robot.id for robot in robots], session, take_over=take_over)
        self._tick_s = c.tick_s
        self._point_ahead, self._offset_free = c.point_ahead_m, c.disturbance == "estimated"
        self._lost_after_ns = round(c.filter.lost_after_s * S)
        self._rows = {robot.tag: row for row, robot in enumerate(config.bodies)}
        self._drives = [slices.drive(robot) for robot in robots]
        self._statuses = Statuses(bus, [robot.id for robot in robots])
        self._poses = Inbox(bus.newest(POSES, CAMERA), FLEET_POSES)
        self._state = Inbox(bus.newest(STATE), RUN_STATE)
        self._commands = [bus.publisher(COMMAND, robot.id) for robot in robots]
        self._seq = 0  # of the newest command
        self._publish_tick = bus.publisher(TICK)
        self._grid = TickGrid(clock.now_ns(), round(c.tick_s * S))
        self._index = 0
        self._timing = _Timing()
        self._record = np.zeros((len(robots), 15))
        self._deciding = Deciding(config, judge)
        self._unknown = np.zeros((len(robots), 2))
        self._begin()

    def _begin(self) -> None:
        """Know nothing of the fleet: at the start, and as long as somebody else drives these robots."""
        n = len(self._drives)
        self._deciding.begin()
        self._filter, self._barrier = fleet.fleet_filter(self._config), fleet.barrier(self._config)
        self._bystanders = fleet.bystanders(self._config)
        self._wheels = [[0.0, 0.0]] * n  # as commanded at the newest tick
        self._phase = Phase.IDLE
        self._run_tick = -1
        self._permitted = np.zeros(n, dtype=np.bool_)
        self._tried: list[tuple[int, int]] = []  # robots whose wheels are tried, and their strokes
        self._taken = (0, 0)  # epoch and seq of the newest poses
        self._exposure_ns = 0  # of the newest ones used
        self._heard = (0, 0)  # epoch and seq of the supervisor's newest word

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
        return min(next_ns, now_ns + HURRY_NS) if self._statuses.hurried() else next_ns

    def close(self) -> None:
        """Nothing to bring to rest: the gates close when commands cease."""

    def _tick(self, tick_ns: int) -> None:
        silent = self._leases.refused
        self._hear_drivers()
        if self._leases.refused:  # somebody else drives these robots: not a word that could be taken for the other's
            if not silent:
                self._begin()
            return
        measured = [False] * len(self._drives)
        if not silent:  # who begins anew takes nothing at first: by that the record tells it
            self._read_state()
            measured = self._read_poses()
        lost = tick_ns - self._filter.measured_ns > self._lost_after_ns
        running = self._phase is Phase.RUNNING
        self._run_tick += running
        driving = ~lost & self._permitted & (self._phase in MOVING)
        here, there, turning = self._filter.predict(tick_ns)
        w = self._filter.disturbance(there, self._point_ahead) if self._offset_free else self._unknown
        bodies, seen = there, self._filter.measured_ns > 0
        if len(self._bystanders.measured_ns):
            bodies = np.concatenate([there, self._bystanders.predict(tick_ns)])
            seen = np.concatenate([seen, self._bystanders.measured_ns > 0])
        self._deciding.tick(bodies, seen, driving, w, moving=self._phase in MOVING)
        self._keep_apart(tick_ns, bodies, turning, driving)
        commanded = self._deciding.wheels
        self._try_wheels(commanded)
        self._filter.command(tick_ns, commanded)
        self._wheels = commanded.tolist()
        seq = self._seq
        for row in range(len(self._wheels)):
            self._command(row)
        self._publish_record(tick_ns, here, measured, lost, seq)

    def _keep_apart(self, tick_ns: int, bodies: np.ndarray, turning: np.ndarray, driving: np.ndarray) -> None:
        """Change what is not safe, and let the behaviours know what is done instead."""
        unseen, pushed = _age_s(self._filter.measured_ns, tick_ns), None
        if len(self._bystanders.measured_ns):
            pushed = np.concatenate([np.zeros_like(turning), self._bystanders.velocities])
            turning = np.concatenate([turning, np.zeros_like(self._bystanders.velocities)])
            unseen = np.concatenate([unseen, _age_s(self._bystanders.measured_ns, tick_ns)])
        self._record[:, 12], self._record[:, 13] = self._barrier.filter(
            bodies, turning, unseen, driving, self._deciding.wheels, self._deciding.u, pushed
        )
        self._deciding.changed()

    def _read_state(self) -> None:
        state = self._state.take()
        if state is not None:
            self._heard = state.epoch, state.seq
        n = len(self._permitted)
        if state is not None and state.phase in _PHASES and len(state.robots) >= n:
            self._permitted[:] = [robot.permitted for robot in state.robots[:n]]
            strokes = [robot.stroke for robot in state.robots[:n]] if state.phase == Phase.ARMED else []
            self._tried = [(row, stroke) for row, stroke in enumerate(strokes) if 0 < stroke < len(STROKES)]
            if state.phase != self._phase:
                resumed, self._phase = self._phase is Phase.HOLD, Phase(state.phase)
                if resumed and self._phase is self._deciding.phase:
                    self._deciding.resume()
                elif self._phase in MOVING:
                    self._run_tick = -1
                    self._deciding.restart(self._phase)

    def _hear_drivers(self) -> None:
        self._statuses.take()
        self._leases.update(self._statuses.newest)

    def _try_wheels(self, commanded: np.ndarray) -> None:
        """Let the robots that are being tried do their strokes."""
        for row, stroke in self._tried:
            drive, (left, right) = self._drives[row], (PROBE_RAD_S * share for share in STROKES[stroke])
            ratio = feasible_ratio(left, right, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
            commanded[row] = ratio * left, ratio * right

    def _read_poses(self) -> list[bool]:
        """Correct the filter by the newest image; returns which robots it measured."""
        message = self._poses.take()
        n, bodies = len(self._drives), len(self._rows)
        if message is not None:
            self._taken = message.epoch, message.seq
        if message is None or not 0 <= self._index - message.echo_tick <= _STALE_TICKS or not message.echo_tick:
            return [False] * n
        exposure_ns, latest_ns = self._exposure(message), self._grid.instant(self._index + 1)
        if exposure_ns > latest_ns:  # impossible, and the filter would be blind until then
            return [False] * n
        poses, instants_ns = [_UNSEEN] * bodies, [exposure_ns] * bodies
        for tag, after_ns, coasted_ns, *pose in message.poses:
            row = self._rows.get(tag)
            if row is not None and coasted_ns == 0 and exposure_ns + after_ns <= latest_ns:
                poses[row], instants_ns[row] = pose, exposure_ns + after_ns
        used = self._filter.observe(np.array(instants_ns[:n]), np.array(poses[:n])).tolist()
        if n < bodies:
            self._bystanders.observe(np.array(instants_ns[n:]), np.array(poses[n:]))
        for row, how in enumerate(used):
            if how == CARRIED:
                self._deciding.carried(row)
        self._exposure_ns = message.exposure_ns
        return [how != UNUSED for how in used]

    def _exposure(self, message: FleetPoses) -> int:
        """Mid-exposure on the controller's clock: the tracker says how long after which tick it was."""
        return self._grid.instant(message.echo_tick) + message.since_tick_ns

    def _repeat(self) -> None:
        self._statuses.take()
        for row in self._statuses.hurried():
            if not self._leases.refused:
                self._command(row)

    def _command(self, row: int) -> None:
        status = self._statuses.newest[row]
        if status is not None and status.session == self._leases.session:
            self._seq += 1
            command = WheelCommand(
                status.epoch, self._seq, status.session, status.boot_id, status.nonce, self._exposure_ns,
                *self._wheels[row],
            )  # fmt: skip
            self._commands[row](WHEEL_COMMAND.encode(command))

    def _publish_record(self, tick_ns: int, here: np.ndarray, measured: list[bool], lost: np.ndarray, seq: int) -> None:
        r, decided = self._record, self._deciding
        r[:, 0:3], r[:, 3:5], r[:, 5:7], r[:, 7:9] = here, decided.points, decided.u, decided.wheels
        r[:, 9], r[:, 10], r[:, 11], r[:, 14] = decided.saturated, measured, lost, decided.failed
        running = self._phase is Phase.RUNNING
        head = (
            self._epoch, self._build, self._index, self._run_tick if running else -1, tick_ns,
            *self._taken, self._exposure_ns, *self._heard, seq,
            self._phase, decided.arrived, self._timing.overruns, self._timing.lateness_ns, self._timing.compute_ns,
        )  # fmt: skip
        self._publish_tick(TICK_RECORD.encode_parts(head, len(r), r.tobytes(), decided.numbers.tobytes()))


def _age_s(measured_ns: np.ndarray, tick_ns: int) -> np.ndarray:
    """Return the age of each robot's newest image [s]; infinite for one that never was seen."""
    return np.where(measured_ns > 0, (tick_ns - measured_ns) / S, np.inf)


def compile_kernels(config: Config, say: Say | None = None) -> None:
    """Compile every numba kernel of the control path, or load it from the cache, before the first tick.

    ``say`` is told how far it is; by default a line is written to stderr.
    """
    kernels = (*platoon.KERNELS, *path.KERNELS, *wheels.KERNELS, *estimator.KERNELS, *safety_barrier.KERNELS)
    with told("control", kernels, say or on_stderr()):
        _call_kernels(config)


def _call_kernels(config: Config) -> None:
    deciding, fleet_filter, barrier = Deciding(config), fleet.fleet_filter(config), fleet.barrier(config)
    to_start, to_park = config.run.begin == "go_to_start", config.run.end == "park"
    n = len(config.members)
    driving = np.ones(n, dtype=np.bool_)
    for instant_ns in (S, 2 * S):
        fleet_filter.observe(np.full(n, instant_ns), np.zeros((n, 3)))
        _, there, _ = fleet_filter.predict(instant_ns + 1)
        w = fleet_filter.disturbance(there, config.controller.point_ahead_m)
        bodies = np.zeros((len(config.bodies), 3))
        bodies[:n] = there
        deciding.tick(bodies, np.ones(len(bodies), dtype=np.bool_), driving, w, moving=True)
        barrier.filter(bodies, bodies[:, :2].copy(), bodies[:, 0].copy(), driving, deciding.wheels, deciding.u)
        for wanted, phase in ((to_start, Phase.POSITIONING), (to_park, Phase.PARKING)):
            if wanted:  # its behaviour rehearses by its first decisions
                deciding.restart(phase)
                deciding.tick(bodies, np.ones(len(bodies), dtype=np.bool_), driving, w, moving=True)
        deciding.restart(Phase.RUNNING)
        fleet_filter.command(instant_ns, deciding.wheels)
