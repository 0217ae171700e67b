"""A gate with its clock, and messages for it: right ones, of which a test changes one field."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from robofleet.safety.gate import Command, GateOutput, GateState, Inputs, Latch, LeaseAction, Permission
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import WheelSpeeds
from tests.robots import GTERNAL

MS, S = 1_000_000, 1_000_000_000
BOOT, SESSION, OTHER, NOW = 7, 21, 22, 1_000 * S
DRIVE = replace(GTERNAL, max_speed=0.16)
WHEELS, FAST = WheelSpeeds(3.0, -4.0), WheelSpeeds(12.5, -12.5)

Step = Callable[[GateState, DifferentialDrive, Inputs, int], tuple[GateState, GateOutput]]


class Gate:
    """A gate, an instant, and what the gate said last."""

    def __init__(self, step: Step, state: GateState | None = None) -> None:
        self._step, self.state, self.now = step, state or GateState(BOOT), NOW
        self.out: GateOutput
        self.turning = False
        self.held = Latch.NONE  # the robot's own reason to stop
        self.give()

    def give(self, **inputs: Any) -> GateOutput:
        """Step the gate now."""
        arrived = Inputs(latch=self.held, turning=self.turning)._replace(**inputs)
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
        right = Permission(state.epoch, state.enabled[1] + 1, state.boot_id, self.now, Latch.NONE, 0, 12.5)
        return right._replace(**changes)

    def refuses(self, **inputs: Any) -> bool:
        """Give a message; return whether it was refused, and check that it then changed only the counter."""
        untouched, _ = self._step(self.state, DRIVE, Inputs(latch=self.held, turning=self.turning), self.now)
        refused = self.state.refused
        self.give(**inputs)
        if self.state.refused == refused:
            return False
        assert self.state == untouched._replace(refused=refused + 1), "a refused message changed more than the counter"
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
