"""A gate with its clock, plain or compiled, and messages for it: right ones, of which a test changes one field."""

from collections.abc import Callable
from copy import copy
from dataclasses import astuple, replace
from typing import Any, NamedTuple

import numpy as np

from robofleet.core.kernels import kernel_of_plain
from robofleet.core.rows import record_of
from robofleet.safety import gate
from robofleet.safety.gate import GATE, INPUT, NEVER_NS, NOT_ASKED, GateState, Inputs, LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import WheelSpeeds
from tests.robots import GTERNAL

MS, S = 1_000_000, 1_000_000_000
BOOT, SESSION = 2**62 + 7, 2**63 + 21  # no float can hold these
OTHER, NOW = SESSION + 1, 1_000 * S
DRIVE = replace(GTERNAL, max_speed=0.16)
WHEELS, FAST = WheelSpeeds(3.0, -4.0), WheelSpeeds(12.5, -12.5)

compiled_step = kernel_of_plain(gate.step)


class Command(NamedTuple):
    """A motion command."""

    epoch: int
    session: int
    seq: int
    boot_id: int
    nonce: int
    wheels: WheelSpeeds


class Permission(NamedTuple):
    """An enable."""

    epoch: int
    seq: int
    boot_id: int
    nonce: int
    latch: Latch
    clear: int
    limit: float


class Arrived(NamedTuple):
    """What arrives at a gate between two steps."""

    command: Command | None = None
    permission: Permission | None = None
    lease: tuple[int, LeaseAction] | None = None
    latch: Latch = Latch.NONE
    turning: bool = False

    def inputs(self) -> Inputs:
        """Return it as the gate takes it."""
        inputs = Inputs(latch=self.latch, turning=self.turning)
        for name in ("command", "permission"):
            if (message := getattr(self, name)) is not None:
                setattr(inputs, name, True)
                for field, value in message._asdict().items():
                    if field == "wheels":
                        inputs.command_left, inputs.command_right = value
                    else:
                        setattr(inputs, f"{name}_{field}", value)
        if self.lease is not None:
            inputs.lease, (inputs.lease_session, inputs.lease_action) = True, self.lease
        return inputs


class GateOutput(NamedTuple):
    """What a gate decided."""

    output: WheelSpeeds
    target: WheelSpeeds
    status: GateStatus
    granted: bool | None
    deadline_ns: int | None


InPlace = Callable[[Any, Any, Any, int], int]  # gate.step, or one like it
Step = Callable[[GateState, DifferentialDrive, Arrived, int], tuple[GateState, GateOutput]]


def plain(step: InPlace) -> Step:
    """Return a step that leaves the state before it as it was."""

    def stepped(
        state: GateState, drive: DifferentialDrive, arrived: Arrived, now_ns: int
    ) -> tuple[GateState, GateOutput]:
        state = copy(state)
        return state, _output(state, step(state, drive, arrived.inputs(), now_ns))

    return stepped


def compiled(state: GateState, drive: DifferentialDrive, arrived: Arrived, now_ns: int) -> tuple[GateState, GateOutput]:
    """Step a gate in an array, between two others that stay as they are."""
    gates, inputs = np.zeros(3, GATE), np.array([astuple(arrived.inputs())], INPUT)
    gates[1] = astuple(state)
    assert record_of(GateState, gates[1]) == state
    granted = compiled_step(gates[1], np.array([astuple(drive)], gate.DRIVE)[0], inputs[0], now_ns)
    assert not gates[[0, 2]].tobytes().strip(b"\0")
    state = record_of(GateState, gates[1])
    return state, _output(state, granted)


def _output(state: GateState, granted: int) -> GateOutput:
    return GateOutput(
        state.output, state.target, GateStatus(state.status), None if granted == NOT_ASKED else bool(granted),
        None if state.deadline_ns == NEVER_NS else state.deadline_ns,
    )  # fmt: skip


class Gate:
    """A gate, an instant, and what the gate said last."""

    def __init__(self, step: Step, state: GateState | None = None) -> None:
        self._step, self.state, self.now = step, state or GateState(boot_id=BOOT), NOW
        self.out: GateOutput
        self.turning = False
        self.held = Latch.NONE  # the robot's own reason to stop
        self.give()

    def give(self, **inputs: Any) -> GateOutput:
        """Step the gate now."""
        arrived = Arrived(latch=self.held, turning=self.turning)._replace(**inputs)
        self.state, self.out = self._step(self.state, DRIVE, arrived, self.now)
        return self.out

    def wait(self, ns: int) -> GateOutput:
        """Step at every deadline and at the end, as the driver does."""
        end = self.now + ns
        while self.out.deadline_ns is not None and self.out.deadline_ns <= end:
            assert self.out.deadline_ns > self.now, "a deadline that has passed"
            self.now = self.out.deadline_ns
            self.give()
        self.now = end
        return self.give()

    def lease(self, session: int = SESSION, action: LeaseAction = LeaseAction.ACQUIRE) -> bool | None:
        return self.give(lease=(session, action)).granted

    def command(self, **changes: Any) -> GateOutput:
        return self.give(command=self.a_command(**changes))

    def enable(self, **changes: Any) -> GateOutput:
        return self.give(permission=self.an_enable(**changes))

    def a_command(self, **changes: Any) -> Command:
        state = self.state
        right = Command(state.epoch, SESSION, state.seq + 1, state.boot_id, self.now, WHEELS)
        return right._replace(**changes)

    def an_enable(self, **changes: Any) -> Permission:
        state = self.state
        right = Permission(state.epoch, state.enabled_seq + 1, state.boot_id, self.now, Latch.NONE, 0, 12.5)
        return right._replace(**changes)

    def refuses(self, **inputs: Any) -> bool:
        """Give a message; return whether it was refused, and check that it then changed only the counter."""
        untouched, _ = self._step(self.state, DRIVE, Arrived(latch=self.held, turning=self.turning), self.now)
        refused = self.state.refused
        self.give(**inputs)
        if self.state.refused == refused:
            return False
        assert self.state == replace(untouched, refused=refused + 1), "a refused message changed more than the counter"
        return True


def opened(step: Step, wheels: WheelSpeeds = WHEELS) -> Gate:
    """Return a gate whose output has reached its command; both nonces are of now."""
    gate = Gate(step)
    assert gate.lease()
    for _ in range(5):
        gate.enable()
        gate.command(wheels=wheels)
        gate.wait(30 * MS)
    gate.enable()
    gate.command(wheels=wheels)
    assert gate.out.output == wheels
    return gate


def written(gate: Gate, ns: int) -> list[tuple[int, WheelSpeeds]]:
    """Return (instant, output) of every step while a gate is left alone, the present one first."""
    seen, end = [(gate.now, gate.out.output)], gate.now + ns
    while gate.out.deadline_ns is not None and gate.out.deadline_ns <= end:
        gate.now = gate.out.deadline_ns
        seen.append((gate.now, gate.give().output))
    return seen
