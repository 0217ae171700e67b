"""The robots of a unit that this project simulates: gates, links and bodies of all of them at once, in arrays.

The rules are those of ``link.py`` and ``safety/gate.py``, compiled; the bodies are those of ``simulation/bodies.py``.
"""

from collections.abc import Sequence
from dataclasses import astuple
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.messages import UNIT_COMMAND, UNIT_ENABLE, UNIT_SENSORS, UNIT_STATUS, UNIT_TRUTH, LeaseAnswer
from robofleet.bus.sensors import SensorMessage
from robofleet.core.compiling import Say, told
from robofleet.core.kernels import kernel, kernel_of_plain
from robofleet.core.rows import record_of, row_type
from robofleet.nodes.unit import link
from robofleet.nodes.unit.gated_robot import Probe, Robots, UnitMessage
from robofleet.nodes.unit.link import Link
from robofleet.nodes.unit.state_store import RobotState, StateStore
from robofleet.safety.gate import DRIVE, GATE, INPUT, NEVER_NS, GateState, Inputs, LeaseAction
from robofleet.safety.latches import GateStatus
from robofleet.simulation import bodies as simulated
from robofleet.simulation.bodies import Bodies
from robofleet.vehicles.interface import DriverContext
from robofleet.vehicles.plant import WATCHDOG_NS

LINK = row_type(Link)
_NO_COMMAND = np.ndarray((1,), UNIT_COMMAND.head_dtype, bytes(64)), np.ndarray((0,), UNIT_COMMAND.item_dtype, b"0")
_NO_ENABLE = np.ndarray((1,), UNIT_ENABLE.head_dtype, bytes(64)), np.ndarray((0,), UNIT_ENABLE.item_dtype, b"0")
_NOTHING = np.array([astuple(Inputs())], INPUT)

_put_command, _put_permission = kernel_of_plain(link.put_command), kernel_of_plain(link.put_permission)
_look_at, _pass_to_gate = kernel_of_plain(link.look), kernel_of_plain(link.pass_on)
_settle, _fill_status = kernel_of_plain(link.settle), kernel_of_plain(link.fill_status)
_advance, _command, _measured, _write_wheels = (
    simulated.advance, simulated.command, simulated.measured, simulated.write
)  # fmt: skip


class SimulatedRobots(Robots):
    """Robots (N,) behind their gates."""

    def __init__(
        self, contexts: Sequence[DriverContext], bodies: Bodies, boot_id: int, state_store: StateStore,
        probe: Probe | None, now_ns: int,
    ) -> None:  # fmt: skip
        super().__init__()
        self._robots, self._bodies, self._probe = [context.robot for context in contexts], bodies, probe
        self._memories = [
            RobotState(robot, state_store, partial(self._complaints.add, robot)) for robot in self._robots
        ]
        gates = [GateState(boot_id=boot_id, **memory.kept._asdict()) for memory in self._memories]
        self._gates = np.array([astuple(gate) for gate in gates], GATE)
        self._links = np.array([astuple(link.new_link(gate, now_ns)) for gate in gates], LINK)
        self._drives = [context.drive for context in contexts]
        self._drive_rows = np.array([astuple(drive) for drive in self._drives], DRIVE)
        n = len(contexts)
        self._inputs = np.zeros(n, INPUT)
        self._statuses, self._truths = np.zeros(n, UNIT_STATUS.item_dtype), np.zeros(n, UNIT_TRUTH.item_dtype)
        self._truths["place"] = range(n)
        self._closed = False
        self._deadline_ns = 0
        world_ns = bodies.prepare()
        for row, gate in enumerate(self._gates):
            _look(gate, self._links[row], *bodies.row(row), now_ns, world_ns)

    def __len__(self) -> int:
        return len(self._robots)

    @property
    def boot_id(self) -> int:
        return int(self._gates["boot_id"][0])

    @property
    def deadline_ns(self) -> int:
        return self._deadline_ns

    @property
    def newest_nonce_ns(self) -> int:
        return int(np.minimum(self._gates["command_nonce"], self._gates["enabled_nonce"]).max())

    @property
    def any_open(self) -> bool:
        return bool((self._gates["status"] == GateStatus.OPEN).any())

    def set_back(self, from_ns: int, now_ns: int) -> None:
        self._gates["at_ns"] = from_ns
        self.pass_on(now_ns, None, None, due=False)

    def pass_on(self, now_ns: int, command: UnitMessage | None, enable: UnitMessage | None, *, due: bool) -> None:
        b = self._bodies
        self._pending, self._deadline_ns = _pass_on(
            self._gates, self._inputs, self._links, self._drive_rows, b.bodies, b.builds, b.coming, b.noise,
            *(command or _NO_COMMAND), *(enable or _NO_ENABLE), now_ns, b.prepare(), due,
        )  # fmt: skip
        if self._probe is not None:
            for row in np.flatnonzero(self._links["stepped"]).tolist():
                inputs, gate = record_of(Inputs, self._inputs[row]), record_of(GateState, self._gates[row])
                self._probe(self._robots[row], now_ns, inputs, gate)
        if self._pending & link.NEW_RUNAWAY:
            for row in np.flatnonzero(self._links["runaway"] == 1).tolist():
                self._complaints.add(self._robots[row], link.runaway_complaint(record_of(Link, self._links[row])))

    def lease(self, session: int, action: LeaseAction, now_ns: int) -> tuple[LeaseAnswer, ...]:
        return tuple(self._lease(row, session, action, now_ns) for row in range(len(self)))

    def _lease(self, row: int, session: int, action: LeaseAction, now_ns: int) -> LeaseAnswer:
        """Ask one gate for its lease: that is seldom, so it is done on records."""
        g, l = self._records(row)
        inputs, after, answer = link.take_lease(g, l, self._drives[row], self._memories[row], session, action, now_ns)
        if after is not g:
            if link.take_output(after, l, False, now_ns):
                l.left_written, l.right_written = after.output
                self._bodies.write(row, *after.output)
            self._gates[row], self._links[row] = astuple(after), astuple(l)
            if self._probe is not None:
                self._probe(self._robots[row], now_ns, inputs, after)
        self._deadline_ns = min(self._deadline_ns, after.deadline_ns)
        return answer

    def keep(self, *, due: bool) -> None:
        if self._pending & link.TO_STORE:
            for row, memory in enumerate(self._memories):
                g, l = self._records(row)
                link.store(g, l, memory, due=due)
                self._links[row] = astuple(l)

    def _records(self, row: int) -> tuple[GateState, Link]:
        return record_of(GateState, self._gates[row]), record_of(Link, self._links[row])

    def statuses(self, now_ns: int, refused: int) -> NDArray[Any]:
        _fill_statuses(self._gates, self._links, self._statuses, now_ns, refused)
        self._pending &= ~link.NEW_LATCH
        return self._statuses

    def truths(self) -> NDArray[Any]:
        b = self._bodies
        _fill_truths(b.bodies, b.builds, b.coming, b.noise, self._truths, b.prepare())
        return self._truths

    def sensors(self) -> SensorMessage:
        sensing = self._bodies.sensing
        assert sensing is not None
        robots = np.zeros(len(sensing.rows), UNIT_SENSORS.item_dtype)
        robots["place"], robots["parts"], robots["distances"] = sensing.rows, sensing.parts, sensing.counts
        return robots, self._bodies.sense()[sensing.has]

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            world_ns = self._bodies.prepare()
            for row in range(len(self)):
                simulated.write(*self._bodies.row(row), 0.0, 0.0, world_ns)
            self.say()


@kernel
def _pass_on(  # type: ignore[no-untyped-def]
    gates, inputs, links, drives, bodies, builds, coming, noise, command, commands, enable, enables, now_ns, world_ns,
    due,
):  # fmt: skip
    pending, deadline_ns = 0, NEVER_NS
    for k in range(len(gates)):
        g, l, b, p = gates[k], links[k], bodies[k], builds[k]
        if due:
            _look(g, l, b, p, coming[k], noise[k], now_ns, world_ns)
        inputs[k] = _NOTHING[0]
        if len(commands) > 0:
            _put_command(inputs[k], command[0], commands[k])
        if len(enables) > 0:
            _put_permission(inputs[k], enable[0], enables[k])
        if _pass_to_gate(g, l, drives[k], inputs[k], command[0].exposure_ns, now_ns):
            _write(l, b, p, coming[k], noise[k], g.output_left, g.output_right, world_ns)
        pending |= _settle(g, l, now_ns)
        deadline_ns = min(deadline_ns, g.deadline_ns)
    return pending, deadline_ns


@kernel
def _look(g, l, b, p, coming, noise, now_ns, world_ns):  # type: ignore[no-untyped-def]
    """Read a robot, and command it again to stand, as ``GatedRobot.look``."""
    _advance(b, p, coming, noise, world_ns)
    l.left_angle, l.right_angle, l.left_speed, l.right_speed, l.battery = _measured(b, p)
    l.faults = b.faults
    if _look_at(g, l, now_ns):
        _command(b, p, coming, 0.0, 0.0, world_ns + WATCHDOG_NS)
        l.left_written, l.right_written = 0.0, 0.0


@kernel
def _write(l, b, p, coming, noise, left, right, world_ns):  # type: ignore[no-untyped-def]
    _write_wheels(b, p, coming, noise, left, right, world_ns)
    l.left_written, l.right_written = left, right


@kernel
def _fill_statuses(gates, links, statuses, now_ns, refused):  # type: ignore[no-untyped-def]
    for k in range(len(gates)):
        _fill_status(statuses[k], gates[k], links[k], now_ns, refused)


@kernel
def _fill_truths(bodies, builds, coming, noise, truths, world_ns):  # type: ignore[no-untyped-def]
    for k in range(len(bodies)):
        b, t = bodies[k], truths[k]
        _advance(b, builds[k], coming[k], noise[k], world_ns)
        t.x_m, t.y_m, t.psi_rad, t.v_m_s, t.omega_rad_s = b.x, b.y, b.psi, b.v, b.omega


KERNELS = (_pass_on, _look, _fill_statuses, _fill_truths, simulated.advance_all, simulated.write)


def compile_kernels(say: Say) -> None:
    """Compile every kernel, or load it from the cache, by calling it for no robots; ``say`` is told how far it is."""
    gates, inputs, links, drives = (np.ones(1, kind) for kind in (GATE, INPUT, LINK, DRIVE))
    bodies, builds = np.zeros(1, simulated.BODY), np.ones(1, simulated.BUILD)
    coming, noise = np.zeros((1, 1), simulated.COMING), np.zeros((1, 1))
    body = bodies[0], builds[0], coming[0], noise[0]
    nobody = bodies[:0], builds[:0], coming[:0], noise[:0]
    statuses, truths = np.zeros(0, UNIT_STATUS.item_dtype), np.zeros(0, UNIT_TRUTH.item_dtype)
    with told(KERNELS, say):
        _pass_on(gates[:0], inputs[:0], links[:0], drives[:0], *nobody, *_NO_COMMAND, *_NO_ENABLE, 0, 0, False)
        _look(gates[0], links[0], *body, 0, 0)
        simulated.write(*body, 0.0, 0.0, 0)
        _fill_statuses(gates[:0], links[:0], statuses, 0, 0)
        _fill_truths(*nobody, truths, 0)
        simulated.advance_all(*nobody, 0)
