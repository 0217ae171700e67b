"""The gate beside a model that states its rules anew and remembers everything it was ever sent."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from robofleet.safety import gate
from robofleet.safety.gate import GateState, LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.safety.gated import BOOT, DRIVE, MS, NOW, OTHER, SESSION, Arrived, Command, Permission, S, plain

step = plain(gate.step)
FRESH_NS, RAMP_S = 120 * MS, 12.5 * 1.01 / 150.0
AGES = st.sampled_from([-1, 0, 0, 0, 1, 40 * MS, FRESH_NS - 1, FRESH_NS]) | st.integers(-5, FRESH_NS + 5)
MOSTLY_RIGHT = st.sampled_from([0, 0, 0, 0, 0, 0, 1, -1])
SPEEDS = st.sampled_from([0.0, 5.0, -12.5, 12.62, 12.63, 10.0, math.nan, math.inf]) | st.floats(-13.0, 13.0)
SESSIONS = st.sampled_from([SESSION, SESSION, SESSION, OTHER, 0])
WAITS = st.sampled_from([0, 1, 5 * MS, 7 * MS, 33 * MS, 60 * MS, 119 * MS, FRESH_NS, S]) | st.integers(0, 250 * MS)


@dataclass
class Accepted:
    """Everything that was accepted, and what follows from it."""

    boot: int = BOOT
    commands: list[Command] = field(default_factory=list)  # accepted, of all leases
    permissions: list[Permission] = field(default_factory=list)  # accepted, since the clock ran on
    given_at: int = 0  # how many of both there were when the lease was given
    permitted_from: int = 0
    epoch: int = 0
    holder: int = 0
    heard_ns: int = 0
    latch: Latch = Latch.NONE
    latches: int = 0
    refused: int = 0

    def command(self) -> Command | None:
        """Return the command that counts."""
        return self.commands[-1] if len(self.commands) > self.given_at else None

    def limit(self) -> float:
        """Return what the newest permission permits; one before the lease or before a reset permits nothing."""
        return self.permissions[-1].limit if len(self.permissions) > self.permitted_from else 0.0


def fits(wheels: WheelSpeeds) -> bool:
    if not all(map(math.isfinite, wheels)):
        return False
    return max(map(abs, wheels)) <= 12.5 * 1.01 and 0.016 * abs(sum(wheels)) / 2.0 <= 0.16 * 1.01


class GateMachine(RuleBasedStateMachine):
    """Messages right and wrong, waits, stops, resets, leases and a clock that is set back, in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.now, self.model, self.state = NOW, Accepted(), GateState(boot_id=BOOT)
        self.pressed, self.turning = Latch.NONE, False
        self.deadline: int | None = None
        self.was_open, self.closed_since = False, NOW
        self.after()

    # What happens.

    @rule(ns=WAITS)
    def wait(self, ns: int) -> None:
        """The driver steps the gate at every deadline."""
        end = self.now + ns
        while self.deadline is not None and self.deadline <= end:
            assert self.deadline > self.now
            self.now = self.deadline
            self.after()
        self.now = end
        self.after()

    @rule(wheels=st.sampled_from([(9.0, -4.0), (-12.5, 7.0), (12.62, 0.0), (10.0, 10.0), (-10.0, -10.05), (1.0, 12.6)]))
    def drive(self, wheels: tuple[float, float]) -> None:
        """A healthy robot, controller and supervisor; what was latched is reset."""
        model, self.pressed, self.turning = self.model, Latch.NONE, False
        if model.latch:
            self.enable(0, 0, 0, 0, Latch.NONE, 0, 0.0)
        if not model.holder:
            self.lease(SESSION, LeaseAction.ACQUIRE)
        self.enable(0, 0, 0, 0, Latch.NONE, None, 12.5)
        self.command(0, 0, 0, model.holder, 0, wheels)

    @rule(
        boot=MOSTLY_RIGHT, age=AGES, epoch=MOSTLY_RIGHT, session=SESSIONS, seq=MOSTLY_RIGHT,
        wheels=st.tuples(SPEEDS, SPEEDS),
    )  # fmt: skip
    def command(self, boot: int, age: int, epoch: int, session: int, seq: int, wheels: tuple[float, float]) -> None:
        model = self.model
        last = max((c.seq for c in model.commands if c.epoch == model.epoch), default=0)
        sent = Command(
            model.epoch + epoch, session, last + 1 + seq, model.boot + boot, self.now - age, WheelSpeeds(*wheels)
        )
        fine = boot == 0 and 0 <= age < FRESH_NS and epoch == 0 and session == model.holder != 0
        if fine and sent.seq > last and fits(sent.wheels):
            model.commands.append(sent)
            model.heard_ns = self.now
            self.after(command=sent)
        else:
            model.refused += 1
            self.after(refused=True, command=sent)

    @rule(
        boot=MOSTLY_RIGHT, age=AGES, epoch=MOSTLY_RIGHT, seq=MOSTLY_RIGHT,
        latch=st.sampled_from([Latch.NONE] * 6 + [Latch.DRILL, Latch.EMERGENCY_STOP]),
        clear=st.none() | MOSTLY_RIGHT, limit=st.sampled_from([12.5, 12.5, 9.0, 4.0, 0.0]),
    )  # fmt: skip
    def enable(self, boot: int, age: int, epoch: int, seq: int, latch: Latch, clear: int | None, limit: float) -> None:
        model = self.model
        newest = max(((p.nonce, p.seq) for p in model.permissions), default=(-1, 0))
        clears = 0 if clear is None else model.latches + clear
        sent = Permission(
            model.epoch + epoch, newest[1] + 1 + seq, model.boot + boot, self.now - age, latch, clears, limit
        )
        fine = boot == 0 and 0 <= age < FRESH_NS and (epoch == 0 or latch) and (sent.nonce, sent.seq) > newest
        if not fine:
            model.refused += 1
            self.after(refused=True, permission=sent)
            return
        model.permissions.append(sent)
        if latch:
            self.hold(latch)
            model.permitted_from = len(model.permissions)
        elif model.latch and clears == model.latches and self.at_rest() and not self.pressed:
            model.latch = Latch.NONE
            model.permitted_from = len(model.permissions)
        self.after(permission=sent)

    @rule(session=SESSIONS, action=st.sampled_from(LeaseAction))
    def lease(self, session: int, action: LeaseAction) -> None:
        model = self.model
        if action is LeaseAction.RELEASE:
            granted = session == model.holder != 0
            model.holder = 0 if granted else model.holder
        elif session in (0, model.holder):
            granted = session != 0
        else:
            free = not model.holder or self.now - model.heard_ns >= S or action is LeaseAction.TAKE_OVER
            granted = free and self.at_rest()
            if granted:
                model.epoch, model.holder, model.heard_ns = model.epoch + 1, session, self.now
                model.given_at, model.permitted_from = len(model.commands), len(model.permissions)
        assert self.after(lease=(session, action)).granted is granted

    @rule(pressed=st.sampled_from([Latch.NONE, Latch.NONE, Latch.WIRED_STOP, Latch.DRIVER_FAILED]))
    def press(self, pressed: Latch) -> None:
        """The robot's own e-stop, or its driver."""
        self.pressed = pressed
        self.after()

    @rule(turning=st.booleans())
    def turn(self, turning: bool) -> None:
        """A wheel is measured to turn, or not."""
        self.turning = turning

    @precondition(lambda self: len(self.model.commands) > 3)
    @rule(ns=st.integers(1, 2 * S))
    def set_back(self, ns: int) -> None:
        """The clock."""
        model = self.model
        self.now -= ns
        model.boot, model.heard_ns = model.boot + 1, self.now
        model.permissions, model.given_at, model.permitted_from = [], len(model.commands), 0
        self.closed_since = self.now
        self.after()

    # What must hold.

    def at_rest(self) -> bool:
        return self.state.output == STOP and not self.turning

    def hold(self, latch: Latch) -> None:
        if latch > self.model.latch:
            self.model.latch, self.model.latches = latch, self.model.latches + 1

    def expected(self) -> tuple[WheelSpeeds, GateStatus]:
        """Return what is allowed now, from all that was accepted."""
        model, command = self.model, self.model.command()
        enabled = bool(model.permissions) and self.now - model.permissions[-1].nonce < FRESH_NS
        if model.latch:
            return STOP, GateStatus.LATCHED
        if not model.holder:
            return STOP, GateStatus.NO_LEASE
        if not (enabled and model.limit() > 0):
            return STOP, GateStatus.NO_ENABLE
        if command is None or self.now - command.nonce >= FRESH_NS:
            return STOP, GateStatus.NO_COMMAND
        if max(map(abs, command.wheels)) > 1.01 * model.limit():
            return STOP, GateStatus.NO_ENABLE
        return command.wheels, GateStatus.OPEN

    def after(self, *, refused: bool = False, **arrived: Any) -> Any:
        """Step the gate and hold what it did against the rules."""
        before, model = self.state, self.model
        self.hold(self.pressed)
        inputs = Arrived(latch=self.pressed, turning=self.turning)
        self.state, out = step(before, DRIVE, inputs._replace(**arrived), self.now)
        if refused:
            alone, _ = step(before, DRIVE, inputs, self.now)
            assert self.state == replace(alone, refused=before.refused + 1)
        assert (out.target, out.status) == self.expected()
        state = self.state
        assert (state.boot_id, state.epoch, state.session) == (model.boot, model.epoch, model.holder)
        assert (state.latch, state.latch_id, state.refused) == (model.latch, model.latches, model.refused)
        accepted = [(c.epoch, c.seq) for c in model.commands[-2:]]
        assert accepted == sorted(set(accepted))
        self.moved(before, out)
        self.deadline = out.deadline_ns
        return out

    def moved(self, before: GateState, out: Any) -> None:
        """Speed, acceleration, and the way of a stop."""
        passed_s = max(0, self.now - before.at_ns) / S
        for was, now, target in zip(before.output, out.output, out.target, strict=True):
            assert abs(now) <= 12.5 * 1.01
            assert abs(now - was) <= 150.0 * min(passed_s, 0.020) + 1e-9
            assert min(was, target) - 1e-12 <= now <= max(was, target) + 1e-12  # towards the target, never past it
        if out.target != STOP:
            self.was_open = True
            assert out.deadline_ns is not None
            return
        if self.was_open:
            self.was_open, self.closed_since = False, self.now
        if before.output != STOP and passed_s:
            assert max(map(abs, out.output)) < max(map(abs, before.output))
        if self.now - self.closed_since > (RAMP_S + 0.005) * S:
            assert out.output == STOP  # with the 120 ms before: within 230 ms of the nonce
        self.times()

    def times(self) -> None:
        target_ns, output_ns = self.state.target_after_ns, self.state.output_after_ns
        assert -1 <= target_ns <= FRESH_NS
        assert output_ns == -1 or target_ns <= output_ns <= 230 * MS


class TestGate(GateMachine.TestCase):  # type: ignore[misc]
    settings = settings(deadline=None, derandomize=True, max_examples=30, stateful_step_count=40)


@pytest.mark.slow
class TestGateAtLength(GateMachine.TestCase):  # type: ignore[misc]
    settings = settings(deadline=None, derandomize=True, max_examples=200, stateful_step_count=40)
