"""The compiled gates do what the gate does, to the last bit: from any state, for any input, at any instant."""

import math
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.core.clock import MS, S
from robofleet.safety import gate, gates
from robofleet.safety.gate import (
    LAPSE_NS,
    LONGEST_RAMP_NS,
    NEVER,
    RAMP_NS,
    TOLERANCE,
    UNKNOWN,
    VALID_NS,
    Command,
    GateOutput,
    GateState,
    Inputs,
    Latch,
    LeaseAction,
    Permission,
)
from robofleet.safety.gates import GATE, INPUT
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.robots import CREATE2, GTERNAL

DRIVES = (GTERNAL, CREATE2, replace(GTERNAL, max_wheel_acceleration=1e-3), replace(CREATE2, max_speed=1e3))
NOW_NS = 10 * S
SEEDS = st.integers(0, 2**64 - 1)
EXACT = settings(deadline=None, derandomize=True)

LAST = 2**64 - 1  # what the wire carries at most; what a gate counts itself begins at half of it at most
IDS = (0, 1, 2, 3, 2**32, 2**53, 2**53 + 1, 2**63 - 1, 2**63, 2**63 + 1)
AGES = (0, RAMP_NS, LONGEST_RAMP_NS, 33 * MS, VALID_NS // 2, VALID_NS, VALID_NS, 2 * VALID_NS, LAPSE_NS, -VALID_NS)
EXTREMES = (-(2**63), 2**63 - 1, 2**63 - VALID_NS)  # as an instant
LIMITS = [limit for d in DRIVES[:2] for limit in (d.max_wheel_speed, d.max_speed / d.wheel_radius)]
BOUNDS = [TOLERANCE * limit for limit in (*LIMITS, 5.0)]
SPEEDS = (
    0.0, -0.0, 3.0, -3.0, 4.0, 0.05, 5e-324, *LIMITS, *BOUNDS, *(-bound for bound in BOUNDS),
    *(math.nextafter(bound, towards) for bound in BOUNDS for towards in (0.0, math.inf)),
)  # fmt: skip
LATCHES = (Latch.NONE,) * 7 + tuple(Latch)


def instant(rng: Random, now_ns: int) -> int:
    return rng.choice((now_ns - rng.choice(AGES) + rng.choice((-1, 0, 0, 1)),) * 8 + (NEVER, 0))


def speed(rng: Random) -> float:
    return rng.choice((*SPEEDS, rng.uniform(-20.0, 20.0)))


def wheels(rng: Random) -> WheelSpeeds:
    one = speed(rng)
    return rng.choice((STOP, WheelSpeeds(one, one), WheelSpeeds(one, speed(rng))))


def permitted(rng: Random) -> float:
    return rng.choice((0.0, -0.0, 5.0, *LIMITS, -1.0, 1e300, rng.uniform(0.0, 20.0)))


def a_state(rng: Random) -> GateState:
    """Return any state of a gate; its target and output often agree, and its instants lie around NOW_NS."""
    target, (boot, epoch, latched, session, seq, enabled) = wheels(rng), rng.choices(IDS, k=6)
    at_ns, heard_ns, commanded_ns, enabled_ns, since_ns, moved_by = (instant(rng, NOW_NS) for _ in range(6))
    after_ns, lapsed_ns = rng.choices((UNKNOWN, 0, 5 * MS), k=2), NOW_NS - LAPSE_NS + rng.choice((-1, 0, 1))
    return GateState(
        boot, epoch, rng.choice(LATCHES), latched, session, rng.choice((heard_ns, lapsed_ns)), seq, commanded_ns,
        wheels(rng), (enabled_ns, enabled), permitted(rng), target, rng.choice((target, target, wheels(rng))), at_ns,
        rng.choice((since_ns, NEVER)), moved_by, *after_ns, rng.choice((0, 7)),
    )  # fmt: skip


def beside(rng: Random, number: int) -> int:
    """Return a number that a gate knows, its neighbour, or another one."""
    return rng.choice((number,) * 20 + (min(number + 1, LAST), max(0, number - 1), rng.choice((*IDS, LAST - 1, LAST))))


def an_input(rng: Random, state: GateState, now_ns: int) -> Inputs:
    """Return anything that may come to a gate in a state: often what it takes, and what just misses that."""

    def nonce() -> int:
        own = rng.choice((state.since_ns, state.enabled[0], rng.choice(EXTREMES)))
        return rng.choice((now_ns,) + 2 * (instant(rng, now_ns),) + (own,))

    command = permission = lease = None
    if rng.random() < 0.6:
        given_ = rng.choice((wheels(rng),) * 9 + (WheelSpeeds(1e300, 1e300), WheelSpeeds(1e300, -1e300)))
        seq = rng.choice((min(state.seq + 1, LAST), beside(rng, state.seq)))
        command = Command(
            beside(rng, state.epoch), beside(rng, state.session), seq,
            beside(rng, state.boot_id), nonce(), given_,
        )  # fmt: skip
    if rng.random() < 0.6:
        permission = Permission(
            beside(rng, state.epoch), beside(rng, state.enabled[1]), beside(rng, state.boot_id), nonce(),
            rng.choice(LATCHES), beside(rng, state.latch_id), permitted(rng),
        )  # fmt: skip
    if rng.random() < 0.4:
        lease = rng.choice((beside(rng, state.session), 77)), rng.choice(list(LeaseAction))
    return Inputs(command, permission, lease, rng.choice(LATCHES), rng.random() < 0.2)


def bits(value: Any) -> Any:
    """Return what tells -0.0 from 0.0."""
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    return value.hex() if isinstance(value, float) else value


class Compiled:
    """Gates in arrays; the one that is meant stands between two others, which nobody steps."""

    def __init__(self, state: GateState, drive: DifferentialDrive) -> None:
        self._gates, self._inputs = np.zeros(3, GATE), np.zeros(3, INPUT)
        self._limits = gates.limits([GTERNAL, drive, GTERNAL])
        gates.set_state(self._gates[1], state)
        assert bits(gates.state_of(self._gates[1])) == bits(state)

    def step(self, given: Inputs, now_ns: int) -> tuple[GateState, GateOutput]:
        gates.set_inputs(self._inputs[1], given)
        assert bits(gates.inputs_of(self._inputs[1])) == bits(given)
        granted = gates.step(self._gates[1], self._limits[1], self._inputs[1], now_ns)
        assert not self._gates[[0, 2]].tobytes().strip(b"\0")
        return gates.state_of(self._gates[1]), gates.output_of(self._gates[1], granted)


@settings(EXACT, max_examples=25)
@given(SEEDS)
def test_one_step_from_any_state(seed: int) -> None:
    rng = Random(seed)
    for _ in range(100):
        state, drive, now_ns = a_state(rng), rng.choice(DRIVES), NOW_NS + rng.choice((-1, 0, 1))
        what = an_input(rng, state, now_ns)
        assert bits(Compiled(state, drive).step(what, now_ns)) == bits(gate.step(state, drive, what, now_ns))


@settings(EXACT, max_examples=60)
@given(SEEDS)
def test_fifty_steps(seed: int) -> None:
    """What one step leaves behind, the next one finds; the clock also stands, jumps and is set back."""
    rng = Random(seed)
    state, drive, now_ns = rng.choice((GateState(2**63 + 5), a_state(rng))), rng.choice(DRIVES), NOW_NS
    compiled = Compiled(state, drive)
    for _ in range(50):
        now_ns += rng.choice((0, 1, RAMP_NS, RAMP_NS, 10 * MS, LONGEST_RAMP_NS, 33 * MS, VALID_NS, VALID_NS + 1, -1))
        what = an_input(rng, state, now_ns)
        state, output = gate.step(state, drive, what, now_ns)
        assert bits(compiled.step(what, now_ns)) == bits((state, output))


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_with_whatever_comes_between(seed: int) -> None:
    """Drawn states are seldom open: this one drives, and its ramps, stops and latches are those of a run."""
    rng = Random(seed)
    state, now_ns = GateState(2**63 + seed), NOW_NS
    compiled, seen = Compiled(state, GTERNAL), set()
    for k in range(2000):
        now_ns += rng.choice((MS, RAMP_NS, RAMP_NS, 10 * MS, 25 * MS, rng.choice((RAMP_NS, VALID_NS, 2 * S, -5 * MS))))
        what = Inputs(turning=rng.random() < 0.1)
        if k % 4 == 0:
            at_ns, seq, speeds = now_ns - rng.randrange(30 * MS), state.seq + 1, WheelSpeeds(speed(rng), speed(rng))
            what = Inputs(
                Command(state.epoch, state.session, seq, state.boot_id, at_ns, speeds),
                Permission(state.epoch, k + 1, state.boot_id, at_ns, Latch.NONE, 0, rng.choice((12.5, 12.5, 5.0))),
            )
        if rng.random() < 0.01:
            what = what._replace(latch=rng.choice(list(Latch)))
        if state.latch and rng.random() < 0.2:
            what = Inputs(None, Permission(state.epoch, k, state.boot_id, now_ns, Latch.NONE, state.latch_id, 1.0))
        if state.session == 0 or rng.random() < 0.01:
            what = what._replace(lease=(rng.randrange(1, 3), rng.choice(list(LeaseAction))))
        state, output = gate.step(state, GTERNAL, what, now_ns)
        assert bits(compiled.step(what, now_ns)) == bits((state, output))
        seen.add(output.status)
    assert len(seen) == 5, "every status was met"
