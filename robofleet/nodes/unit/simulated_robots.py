"""The simulated robots of a unit: gates, wheels and words of all of them at once, in arrays.

It does what ``gated_robot.py`` does for a robot that exists, to the last bit:
``tests/nodes/test_simulated_robots.py`` runs both beside each other. The lines that decide are in
``safety/gate.py``, compiled; those of the bodies in ``simulation/bodies.py``.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import astuple
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.messages import UNIT_COMMAND, UNIT_ENABLE, UNIT_SENSORS, UNIT_STATUS, UNIT_TRUTH, LeaseAnswer
from robofleet.bus.sensors import SensorsSaid
from robofleet.core.compiling import Say, told
from robofleet.core.kernels import kernel
from robofleet.nodes.unit.gated_robot import BAD_LINK_NS, HURRY_NS, LOOK_NS, NO_LINK_NS, TURNING_RAD_S, Probe
from robofleet.nodes.unit.health import said_of_a_runaway
from robofleet.nodes.unit.keeping import RobotState, StateStore, kept
from robofleet.safety import runaway
from robofleet.safety.gate import DRIVE, GATE, INPUT, NEVER_NS, GateState, Inputs, LeaseAction, record_of, step_row
from robofleet.safety.latches import GateStatus, Latch
from robofleet.simulation import bodies as simulated
from robofleet.simulation.bodies import Bodies
from robofleet.vehicles.interface import DriverContext, RobotFault

_F, _I = "<f8", "<i8"
LINK = np.dtype(
    [
        # What the wheels were given last, NaN before; what they were told since the start, and since when.
        *((name, _F) for name in ("left_written", "right_written", "left_told", "right_told")),
        *((name, _F) for name in ("left_telling", "right_telling")),
        *((name, _I) for name in ("told_ns", "accepted_exposure_ns", "applied_exposure_ns", "applied_ns")),
        *((name, _I) for name in ("opened", "hurry_until_ns", "told_latch", "stepped")),
        ("told_latch_id", _I), ("kept_epoch", _I), ("kept_latch_id", _I), ("kept_latch", _I),
        # The newest reading, and what is wrong with the robot.
        *((name, _F) for name in ("left_angle", "right_angle", "left_speed", "right_speed", "battery")),
        *((name, _I) for name in ("faults", "felt", "latch", "turning_since_ns", "turning_at_ns", "runs")),
    ]
)  # fmt: skip
_NO_COMMAND = np.ndarray((1,), UNIT_COMMAND.head_dtype, bytes(64)), np.ndarray((0,), UNIT_COMMAND.item_dtype, b"0")
_NO_ENABLE = np.ndarray((1,), UNIT_ENABLE.head_dtype, bytes(64)), np.ndarray((0,), UNIT_ENABLE.item_dtype, b"0")

_NOTHING = np.array([astuple(Inputs())], INPUT)
_UNTOLD = -1  # as an exposure: no command waits to reach the wheels
_NEW_LATCH, _TO_KEEP, _HURRIES, _RUNS = 1, 2, 4, 8  # what a call of the kernel found
_OPEN, _DRILL, _NONE = int(GateStatus.OPEN), int(Latch.DRILL), int(Latch.NONE)
_WIRED_STOP, _ROBOT_FAULT, _RUNAWAY = int(Latch.WIRED_STOP), int(Latch.ROBOT_FAULT), int(Latch.RUNAWAY)
_EMERGENCY_STOP, _GRAVEST = int(Latch.EMERGENCY_STOP), max(map(int, Latch))
_PRESSED = int(RobotFault.WIRED_STOP)
_HEARD_WITHIN_NS, _RESTS_WITHIN_NS = runaway.HEARD_WITHIN_NS, runaway.RESTS_WITHIN_NS
_RUNS_RAD_S = runaway.TURNING_RAD_S
_NOBODY = np.uint64(0)
_step, _advance, _tell = step_row, simulated.advance, simulated.tell
_quantised, _through_wires = simulated.quantised, simulated.through_wires


class SimulatedRobots:
    """Robots (N,) behind their gates."""

    def __init__(
        self, contexts: Sequence[DriverContext], bodies: Bodies, boot_id: int, keeping: StateStore,
        probe: Probe | None, now_ns: int,
    ) -> None:  # fmt: skip
        n = len(contexts)
        self._robots, self._bodies, self._probe = [context.robot for context in contexts], bodies, probe
        self._memories = [
            RobotState(context.robot, keeping, partial(self._complain, context.robot)) for context in contexts
        ]
        self._gates, self._inputs, self._links = np.zeros(n, GATE), np.zeros(n, INPUT), np.zeros(n, LINK)
        self._drives = np.array([astuple(context.drive) for context in contexts], DRIVE)
        self._statuses, self._truths = np.zeros(n, UNIT_STATUS.item_dtype), np.zeros(n, UNIT_TRUTH.item_dtype)
        self._truths["place"] = range(n)
        self._unsaid: list[str] = []
        self._complaints: dict[str, str] = {}
        self._closed = False
        for row, memory in enumerate(self._memories):
            self._gates[row] = astuple(GateState(boot_id=boot_id, **memory.kept._asdict()))
        links = self._links
        links["left_written"] = links["right_written"] = math.nan
        links["accepted_exposure_ns"] = _UNTOLD
        links["turning_since_ns"] = links["turning_at_ns"] = now_ns
        links["told_latch"], links["told_latch_id"] = self._gates["latch"], self._gates["latch_id"]
        self._note_kept(range(n))
        self._found = 0
        self.deadline_ns: int = 0
        b, world_ns = bodies, bodies.prepare()
        _look_all(self._gates, links, b.bodies, b.plants, b.coming, b.noise, now_ns, world_ns)

    def __len__(self) -> int:
        """Return how many robots these are."""
        return len(self._robots)

    @property
    def boot_id(self) -> int:
        """What was drawn when the unit started, and counted on whenever its clock was set back."""
        return int(self._gates["boot_id"][0])

    @property
    def hurries(self) -> bool:
        """Whether the link was bad a short while ago."""
        return bool(self._found & _HURRIES)

    @property
    def newest_nonce_ns(self) -> int:
        """The newest nonce that a command and a permission have echoed."""
        return int(np.minimum(self._gates["command_nonce"], self._gates["enabled_nonce"]).max())

    @property
    def latch_is_new(self) -> bool:
        """Whether the newest status does not tell of a gate's latch yet."""
        return bool(self._found & _NEW_LATCH)

    @property
    def any_open(self) -> bool:
        """Whether a gate lets a controller's commands through."""
        return bool((self._gates["status"] == GateStatus.OPEN).any())

    def set_back(self, from_ns: int, now_ns: int) -> None:
        """Let every gate begin anew: the clock was set back."""
        self._gates["at_ns"] = from_ns
        self.pass_on(now_ns, None, None, due=False)

    def pass_on(
        self, now_ns: int, command: tuple[NDArray[Any], NDArray[Any]] | None,
        enable: tuple[NDArray[Any], NDArray[Any]] | None, *, due: bool,
    ) -> None:  # fmt: skip
        """Let the gates decide on what arrived, and write the wheels; read the robots before, if that is due."""
        b = self._bodies
        self._found, self.deadline_ns = _pass_on(
            self._gates, self._inputs, self._links, self._drives, b.bodies, b.plants, b.coming, b.noise,
            *(command or _NO_COMMAND), *(enable or _NO_ENABLE), now_ns, b.prepare(), due,
        )  # fmt: skip
        if self._probe is not None:
            for row in np.flatnonzero(self._links["stepped"]).tolist():
                self._tell_probe(row, now_ns)
        if self._found & _RUNS:
            self._complain_of_runaways()

    def lease(self, session: int, action: LeaseAction, now_ns: int) -> tuple[LeaseAnswer, ...]:
        """Answer a request for the leases; an epoch that a restart would give out again is not given out."""
        return tuple(self._lease(row, session, action, now_ns) for row in range(len(self)))

    def _lease(self, row: int, session: int, action: LeaseAction, now_ns: int) -> LeaseAnswer:
        b, gate = self._bodies, self._gates[row]
        before = gate.copy()
        granted = _ask(
            self._gates, self._inputs, self._links, self._drives, row, np.uint64(session), int(action), now_ns
        )
        if gate["epoch"] != before["epoch"] and not self._save(row):
            self._gates[row], granted = before, 0
        else:
            _adopt_row(self._gates, self._links, b.bodies, b.plants, b.coming, b.noise, row, now_ns, b.prepare())
            if self._probe is not None:
                self._tell_probe(row, now_ns)
        self.deadline_ns = min(self.deadline_ns, int(gate["deadline_ns"]))
        return LeaseAnswer(int(granted), int(gate["epoch"]), int(gate["session"]))

    def keep(self, *, due: bool) -> None:
        """Keep what must be kept of the gates: a lease's epoch, a latch."""
        if self._found & _TO_KEEP:
            gate, link = self._gates, self._links
            changed = (
                (gate["epoch"] != link["kept_epoch"]) | (gate["latch_id"] != link["kept_latch_id"])
                | (np.where(gate["latch"] == _DRILL, _NONE, gate["latch"]) != link["kept_latch"])
            )  # fmt: skip
            rows = np.flatnonzero(changed).tolist()
            for row in rows:
                self._memories[row].keep(kept(record_of(GateState, gate[row])), due=due)
            self._note_kept(rows)

    def _save(self, row: int) -> bool:
        saved = self._memories[row].save(kept(record_of(GateState, self._gates[row])))
        self._note_kept([row])
        return saved

    def _note_kept(self, rows: Sequence[int]) -> None:
        for row in rows:
            memory, link = self._memories[row].kept, self._links[row]
            link["kept_epoch"], link["kept_latch"], link["kept_latch_id"] = memory

    def statuses(self, now_ns: int, refused: int) -> NDArray[Any]:
        """Return every robot's part of a status; ``refused``: messages of the unit that nobody could read."""
        _fill_statuses(self._gates, self._links, self._statuses, now_ns, refused)
        self._found &= ~_NEW_LATCH
        return self._statuses

    def truths(self) -> NDArray[Any]:
        """Return every robot's part of a truth."""
        b = self._bodies
        _fill_truths(b.bodies, b.plants, b.coming, b.noise, self._truths, b.prepare())
        return self._truths

    def sensors(self) -> SensorsSaid:
        """Return what the sensors say, of each robot whose sensors are read."""
        sensing = self._bodies.sensing
        assert sensing is not None
        robots = np.zeros(len(sensing.rows), UNIT_SENSORS.item_dtype)
        robots["place"], robots["parts"], robots["distances"] = sensing.rows, sensing.parts, sensing.counts
        return robots, self._bodies.sense()[sensing.has]

    def say(self) -> None:
        """Say in the log what there is to complain about."""
        if self._unsaid:
            lines, self._unsaid = self._unsaid, []
            print("\n".join(lines), file=sys.stderr)

    def close(self) -> None:
        """Motors off at once. Idempotent."""
        if not self._closed:
            self._closed = True
            b, world_ns = self._bodies, self._bodies.prepare()
            _stop_all(b.bodies, b.plants, b.coming, b.noise, world_ns)
            self.say()

    def _complain(self, robot: str, complaint: str) -> None:
        if complaint != self._complaints.get(robot):
            self._complaints[robot] = complaint
            self._unsaid.append(f"{robot}: {complaint}")

    def _complain_of_runaways(self) -> None:
        for row in np.flatnonzero(self._links["runs"] == 1).tolist():
            link = self._links[row]
            fastest = max(abs(float(link["left_speed"])), abs(float(link["right_speed"])))
            self._complain(self._robots[row], said_of_a_runaway(fastest))

    def _tell_probe(self, row: int, now_ns: int) -> None:
        assert self._probe is not None
        inputs, state = record_of(Inputs, self._inputs[row]), record_of(GateState, self._gates[row])
        self._probe(self._robots[row], now_ns, inputs, state)


@kernel
def _pass_on(  # type: ignore[no-untyped-def]
    gate,
    inputs,
    links,
    drives,
    bodies,
    plants,
    coming,
    noise,
    command,
    commands,
    enable,
    enables,
    now_ns,
    world_ns,
    due,
):
    found, deadline_ns, c, e = 0, NEVER_NS, command[0], enable[0]
    for k in range(len(gate)):
        g, l, i, b, p = gate[k], links[k], inputs[k], bodies[k], plants[k]
        if due:
            _look(g, l, b, p, coming[k], noise[k], now_ns, world_ns)
        commanded = len(commands) > 0 and commands[k].epoch != _NOBODY
        enabled = len(enables) > 0
        l.stepped = 0
        timed = g.deadline_ns != NEVER_NS and now_ns >= min(g.deadline_ns, g.at_ns + LOOK_NS)
        if commanded or enabled or timed or l.latch > g.latch or now_ns < g.at_ns:
            l.stepped = 1
            l.opened = l.opened or g.status == _OPEN
            age_ns = now_ns - min(g.command_nonce, g.enabled_nonce)
            if l.opened and BAD_LINK_NS < age_ns < NO_LINK_NS:
                l.hurry_until_ns = now_ns + HURRY_NS
            seq = g.seq
            inputs[k] = _NOTHING[0]
            if commanded:
                i.command, own = 1, commands[k]
                i.command_epoch, i.command_session, i.command_seq = own.epoch, c.session, c.seq
                i.command_boot_id, i.command_nonce = c.boot_id, c.nonce
                i.command_left, i.command_right = own.left_rad_s, own.right_rad_s
            if enabled:
                i.permission, permission = 1, enables[k]
                i.permission_epoch, i.permission_seq, i.permission_boot_id = permission.epoch, e.seq, e.boot_id
                i.permission_nonce, i.permission_clear, i.permission_limit = (
                    e.nonce,
                    permission.clear,
                    permission.limit_rad_s,
                )
                i.permission_latch = permission.latch if permission.latch <= _GRAVEST else _EMERGENCY_STOP
            _feel(l, i)
            _step(g, drives[k], i, now_ns)
            _adopt(g, l, b, p, coming[k], noise[k], now_ns, world_ns, commanded)
            if commanded and c.exposure_ns != l.applied_exposure_ns and g.seq != seq:
                l.accepted_exposure_ns = c.exposure_ns
            if l.accepted_exposure_ns != _UNTOLD and g.status == _OPEN:
                l.applied_exposure_ns, l.applied_ns = l.accepted_exposure_ns, now_ns
                l.accepted_exposure_ns = _UNTOLD
        if g.latch != l.told_latch or g.latch_id != l.told_latch_id:
            found |= _NEW_LATCH
        lasting = _NONE if g.latch == _DRILL else g.latch
        if g.epoch != l.kept_epoch or lasting != l.kept_latch or g.latch_id != l.kept_latch_id:
            found |= _TO_KEEP
        if g.at_ns < l.hurry_until_ns:
            found |= _HURRIES
        if l.runs == 1:
            found |= _RUNS
        deadline_ns = min(deadline_ns, g.deadline_ns)
    return found, deadline_ns


@kernel
def _look_all(gate, links, bodies, plants, coming, noise, now_ns, world_ns):  # type: ignore[no-untyped-def]
    for k in range(len(gate)):
        _look(gate[k], links[k], bodies[k], plants[k], coming[k], noise[k], now_ns, world_ns)


@kernel
def _look(g, l, b, p, coming, noise, now_ns, world_ns):  # type: ignore[no-untyped-def]
    """Read a robot, and tell it again to stand, as ``GatedRobot.look`` and ``Health.look``."""
    _advance(b, p, coming, noise, world_ns)
    left, right = _through_wires(p, b.left_angle, b.right_angle)
    count = p.speed_quantum * p.loop_period
    l.left_angle, l.right_angle = _quantised(left, count), _quantised(right, count)
    left, right = _through_wires(p, b.left_speed, b.right_speed)
    l.left_speed, l.right_speed = _quantised(left, p.speed_quantum), _quantised(right, p.speed_quantum)
    charge = max(0.0, 1.0 - b.used / p.battery_life)
    l.battery = charge if math.isnan(b.low_charge) else b.low_charge
    l.faults = b.faults
    l.felt = l.faults | (l.felt if g.latch else 0)
    fastest = max(abs(l.left_speed), abs(l.right_speed))
    stands = g.output_left == 0.0 and g.output_right == 0.0
    continuous = l.turning_at_ns <= now_ns <= l.turning_at_ns + _HEARD_WITHIN_NS
    if not stands or not fastest > _RUNS_RAD_S or not continuous:
        l.turning_since_ns = now_ns
    l.turning_at_ns = now_ns
    runs = l.turning_at_ns - l.turning_since_ns >= _RESTS_WITHIN_NS
    l.runs = 0 if not runs else (2 if l.runs else 1)  # 1: it is new
    if runs:
        l.latch = _RUNAWAY
    elif not l.faults:
        l.latch = _NONE
    else:
        l.latch = _WIRED_STOP if l.faults & _PRESSED else _ROBOT_FAULT
    if g.status != _OPEN and stands:
        _write(l, b, p, coming, noise, 0.0, 0.0, world_ns)


@kernel
def _feel(l, i):  # type: ignore[no-untyped-def]
    i.latch = l.latch
    i.turning = max(abs(l.left_speed), abs(l.right_speed)) > TURNING_RAD_S


@kernel
def _write(l, b, p, coming, noise, left, right, world_ns):  # type: ignore[no-untyped-def]
    _tell(b, p, coming, noise, left, right, world_ns)
    l.left_written, l.right_written = left, right


@kernel
def _adopt(g, l, b, p, coming, noise, now_ns, world_ns, again):  # type: ignore[no-untyped-def]
    """Do what the gate decided; ``again`` tells the robot also what it was told before."""
    if again or not (g.output_left == l.left_written and g.output_right == l.right_written):
        since_s = (now_ns - l.told_ns) * 1e-9
        l.left_told, l.right_told = l.left_told + l.left_telling * since_s, l.right_told + l.right_telling * since_s
        l.told_ns, l.left_telling, l.right_telling = now_ns, g.output_left, g.output_right
        _write(l, b, p, coming, noise, g.output_left, g.output_right, world_ns)


@kernel
def _adopt_row(gate, links, bodies, plants, coming, noise, row, now_ns, world_ns):  # type: ignore[no-untyped-def]
    _adopt(gate[row], links[row], bodies[row], plants[row], coming[row], noise[row], now_ns, world_ns, False)


@kernel
def _ask(gate, inputs, links, drives, row, session, action, now_ns):  # type: ignore[no-untyped-def]
    """Ask one gate for its lease; returns the answer."""
    i = inputs[row]
    inputs[row] = _NOTHING[0]
    i.lease, i.lease_session, i.lease_action = 1, session, action
    _feel(links[row], i)
    return _step(gate[row], drives[row], i, now_ns)


@kernel
def _fill_statuses(gate, links, statuses, now_ns, refused):  # type: ignore[no-untyped-def]
    for k in range(len(gate)):
        g, l, s = gate[k], links[k], statuses[k]
        s.epoch, s.session = g.epoch, g.session
        s.applied_exposure_ns, s.applied_ns, s.rejected = l.applied_exposure_ns, l.applied_ns, g.refused + refused
        s.gate, s.latch, s.latch_id = g.status, g.latch, g.latch_id
        s.faults = l.faults | (l.felt & ~_PRESSED if g.latch else 0)
        s.target_after_ns, s.output_after_ns = g.target_after_ns, g.output_after_ns
        s.left_angle_rad, s.right_angle_rad, s.left_rad_s, s.right_rad_s = (
            l.left_angle, l.right_angle, l.left_speed, l.right_speed,
        )  # fmt: skip
        s.left_output_rad_s, s.right_output_rad_s = g.output_left, g.output_right
        since_s = (now_ns - l.told_ns) * 1e-9
        s.left_told_rad = l.left_told + l.left_telling * since_s
        s.right_told_rad = l.right_told + l.right_telling * since_s
        s.battery = l.battery
        l.told_latch, l.told_latch_id = g.latch, g.latch_id


@kernel
def _fill_truths(bodies, plants, coming, noise, truths, world_ns):  # type: ignore[no-untyped-def]
    for k in range(len(bodies)):
        b, t = bodies[k], truths[k]
        _advance(b, plants[k], coming[k], noise[k], world_ns)
        t.x_m, t.y_m, t.psi_rad, t.v_m_s, t.omega_rad_s = b.x, b.y, b.psi, b.v, b.omega


@kernel
def _stop_all(bodies, plants, coming, noise, world_ns):  # type: ignore[no-untyped-def]
    for k in range(len(bodies)):
        _tell(bodies[k], plants[k], coming[k], noise[k], 0.0, 0.0, world_ns)


KERNELS = (_pass_on, _look_all, _adopt_row, _ask, _fill_statuses, _fill_truths, _stop_all, simulated.advance_all)


def compile_kernels(say: Say) -> None:
    """Compile every kernel, or load it from the cache, by calling it for no robots; ``say`` is told how far it is."""
    gate, inputs, links, drives = (np.zeros(0, kind) for kind in (GATE, INPUT, LINK, DRIVE))
    bodies = np.zeros(0, simulated.BODY), np.zeros(0, simulated.PLANT)
    arena = (*bodies, np.zeros((0, 1), simulated.COMING), np.zeros((0, 1)))
    statuses, truths = np.zeros(0, UNIT_STATUS.item_dtype), np.zeros(0, UNIT_TRUTH.item_dtype)
    row_arrays = tuple(np.zeros(1, kind) for kind in (GATE, INPUT, LINK, DRIVE))
    row_state = (
        np.zeros(1, simulated.BODY),
        np.ones(1, simulated.PLANT),
        np.zeros((1, 1), simulated.COMING),
        np.zeros((1, 1)),
    )
    with told("robots", KERNELS, say):
        _pass_on(gate, inputs, links, drives, *arena, *_NO_COMMAND, *_NO_ENABLE, 0, 0, False)
        _look_all(gate, links, *arena, 0, 0)
        _fill_statuses(gate, links, statuses, 0, 0)
        _fill_truths(*arena, truths, 0)
        _stop_all(*arena, 0)
        simulated.advance_all(*arena, 0)
        gate, inputs, links, drives = row_arrays
        _ask(gate, inputs, links, drives, 0, np.uint64(0), int(LeaseAction.RELEASE), 0)
        _adopt_row(gate, links, *row_state, 0, 0, 0)
