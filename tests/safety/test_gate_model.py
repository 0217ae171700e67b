"""The gate against a model that remembers everything it was ever sent."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety.gate import VALID_NS, Command, GateState, GateStatus, Permission, step
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, WheelSpeeds

BOOT, START = 3, 10_000_000_000
MS = 1_000_000
DRIVE = DifferentialDrive(
    wheel_radius=0.016,
    wheel_base=0.105,
    max_wheel_speed=12.5,
    max_speed=0.2,
    motor_lag=0.08,
    max_wheel_acceleration=150.0,
)

boots = st.sampled_from([BOOT, BOOT, BOOT, 4])
ages = st.sampled_from([-1, 0, 1, 40 * MS, VALID_NS - 1, VALID_NS, VALID_NS + 1]) | st.integers(-5, VALID_NS + 5)
speeds = st.sampled_from([0.0, 5.0, -12.5, 12.62, 12.63, math.nan, math.inf]) | st.floats()
commands = st.none() | st.tuples(boots, ages, st.tuples(speeds, speeds))
permissions = st.none() | st.tuples(boots, ages, st.booleans())
rounds = st.lists(st.tuples(st.integers(0, 130 * MS), commands, permissions), min_size=1, max_size=12)


def allowed(wheels: tuple[float, float]) -> bool:
    if not all(map(math.isfinite, wheels)):
        return False
    body = 0.016 * abs(wheels[0] + wheels[1]) / 2.0
    return max(map(abs, wheels)) <= 12.5 * 1.01 and body <= 0.2 * 1.01


@settings(deadline=None, derandomize=True, max_examples=300)
@given(rounds)
def test_wheels_turn_only_by_a_valid_command_and_a_valid_permission(
    script: list[tuple[int, tuple[int, int, tuple[float, float]] | None, tuple[int, int, bool] | None]],
) -> None:
    state, now, refused = GateState(BOOT), START, 0
    newest_command: tuple[int, tuple[float, float]] | None = None
    newest_enable: tuple[int, bool] | None = None
    for wait, c, p in script:
        now += wait
        state, output = step(
            state,
            DRIVE,
            None if c is None else Command(c[0], now - c[1], WheelSpeeds(*c[2])),
            None if p is None else Permission(p[0], now - p[1], p[2]),
            now,
        )
        if c is not None:
            if c[0] == BOOT and 0 <= c[1] < VALID_NS and allowed(c[2]):
                newest_command = now - c[1], c[2]
            else:
                refused += 1
        if p is not None:
            if p[0] == BOOT and 0 <= p[1] < VALID_NS:
                newest_enable = now - p[1], p[2]
            else:
                refused += 1
        may = newest_enable is not None and newest_enable[1] and now - newest_enable[0] < VALID_NS
        told = newest_command is not None and now - newest_command[0] < VALID_NS
        assert state.refused == refused
        assert (output.status is GateStatus.OPEN) == (may and told)
        if output.status is GateStatus.OPEN:
            assert newest_command is not None
            assert output.target == newest_command[1]
            assert output.deadline_ns is not None
            assert now < output.deadline_ns <= now + VALID_NS
            assert step(state, DRIVE, None, None, output.deadline_ns - 1)[1].target == output.target
            assert step(state, DRIVE, None, None, output.deadline_ns)[1].target == STOP
        else:
            assert output == (STOP, GateStatus.NO_COMMAND if may else GateStatus.NO_ENABLE, None)
