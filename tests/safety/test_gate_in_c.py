"""The gate in C (``drivers/firmware/gate.c``) does what ``safety/gate.py`` does, step by step, whatever comes.

Its clock counts milliseconds from 120 on, its speeds are integers; here both gates get the same values. Every field of
both states is then equal, but for the output's last bit: on its ramp C rounds to 2^-16 rad/s. Therefore Python goes on
from C's output after each step. Where one ramp arrives and the other one is that bit short, it arrives a step later.
"""

import random
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety import gate, runaway
from robofleet.safety.gate import GateState, Inputs
from robofleet.simulation import firmware_library
from robofleet.vehicles.differential_drive import DifferentialDrive
from tests.robots import GTERNAL

MS, VALID_MS, WRAP = 1_000_000, 120, 2**32
SPEED, OUTPUT = 2.0**-9, 2.0**-16  # [rad/s]
# Not multiples of 100: 1 % more than these is no whole number, so that no float decides what is within.
MAX_WHEEL, MAX_SUM, RAMP = 6413, 10253, 9831
DRIVE = DifferentialDrive(
    wheel_radius=2.0**-5, wheel_base=GTERNAL.wheel_base, max_wheel_speed=MAX_WHEEL * SPEED,
    max_speed=MAX_SUM * SPEED * 2.0**-6, motor_lag=GTERNAL.motor_lag, max_wheel_acceleration=RAMP * OUTPUT * 1000.0,
)  # fmt: skip
LIMITS = (*(6413,) * 6, 2051, 301, 0, -1)
SPEEDS = (0, 0, 2560, -6413, 6413, 6477, 6478, -6478, 5177, 5178, 303, 304, 2071, 2072, 32767, -32768)
SESSIONS = (*(21,) * 12, 22, 0)
WAITS = (0, 0, 1, 1, 2, 5, 5, 7, 20, 21, 33, 119, 120, 121, 1000, 5000)
ACTIONS = (1, 1, 2, 3)

_SPEEDS = {"left", "right", "limit", "target_left", "target_right"}
_INSTANTS = {
    "heard": "heard_ns", "command_nonce": "command_nonce", "enabled_nonce": "enabled_nonce", "at": "at_ns",
    "since": "since_ns", "moved_by": "moved_by",
}  # fmt: skip
_SAME = ("boot_id", "epoch", "latch", "latch_id", "session", "seq", "enabled_seq", "refused", "status")


@pytest.fixture(scope="module")
def library() -> Any:
    return firmware_library.firmware_library({}, firmware_library.SOURCES)


def ns(ms: int) -> int:
    return (ms - VALID_MS) * MS


class Pair:
    """Both gates, on one clock."""

    def __init__(self, library: Any, boot_id: int = 7, now: int = 100_000, latch: int = 0, latch_id: int = 0) -> None:
        self.ffi, self.c = library
        self.now, self.met = now, Counter[str]()
        self.limits = self.ffi.new(
            "struct gate_limits *", {"max_wheel": MAX_WHEEL, "max_sum": MAX_SUM, "max_ramp": RAMP}
        )
        self.in_c = self.ffi.new("struct gate *")
        self.c.gate_init(self.in_c, boot_id, latch, latch_id, now)
        self.state = GateState(boot_id=boot_id, latch=latch, latch_id=latch_id, heard_ns=ns(0), at_ns=ns(now))

    def step(self, **inputs: int) -> None:
        """Step both gates with inputs as C has them; every field must then be equal."""
        in_c = self.ffi.new("struct gate_inputs *", inputs)
        granted = self.c.gate_step(self.in_c, self.limits, in_c, self.now)
        expected = gate.step(self.state, DRIVE, _in_python(inputs), ns(self.now))
        self.met["steps"] += 1
        self.met[f"status {self.state.status}"] += 1
        self.met[f"granted {granted}"] += 1
        assert granted == expected
        self.compare()

    def compare(self) -> None:
        c, python = self.in_c, self.state
        for name in _SAME:
            assert getattr(c, name) == getattr(python, name), name
        for name in _SPEEDS:
            assert getattr(c, name) * SPEED == getattr(python, name), name
        for name, other in _INSTANTS.items():
            assert ns(getattr(c, name)) == getattr(python, other), name
        assert _figure(c.target_after) == python.target_after_ns
        same_arrival = True
        for name in ("output_left", "output_right"):
            exact, rounded = getattr(python, name), getattr(c, name) * OUTPUT
            assert abs(exact - rounded) <= OUTPUT, name
            same_arrival &= (exact == 0.0) == (rounded == 0.0)
            setattr(python, name, rounded)
        if not same_arrival:
            self.met["arrived a step apart"] += 1
            python.output_after_ns = _figure(c.output_after)
        assert _figure(c.output_after) == python.output_after_ns
        assert self.c.gate_stands(c) == (python.output_left == python.output_right == 0.0)

    def command(self, rng: "Draw") -> dict[str, int]:
        g = self.state
        return {
            "command": 1, "command_epoch": (g.epoch + rng.slip()) % 2**16, "command_session": rng.one(SESSIONS),
            "command_seq": (g.seq + 1 + rng.slip()) % WRAP, "command_boot_id": g.boot_id + rng.slip(),
            "command_nonce": self.nonce(rng), "command_left": rng.speed(), "command_right": rng.speed(),
        }  # fmt: skip

    def permission(self, rng: "Draw") -> dict[str, int]:
        g = self.state
        return {
            "permission": 1, "permission_epoch": (g.epoch + rng.slip()) % 2**16,
            "permission_seq": (g.enabled_seq + 1 + rng.slip()) % WRAP, "permission_boot_id": g.boot_id + rng.slip(),
            "permission_nonce": self.nonce(rng), "permission_latch": rng.rarely(1, 2, 3),
            "permission_clear": rng.one((0, g.latch_id, g.latch_id, g.latch_id + 1)),
            "permission_limit": rng.one(LIMITS),
        }  # fmt: skip

    def nonce(self, rng: "Draw") -> int:
        return min(WRAP - 1, max(0, self.now - rng.one((*(0,) * 6, 1, 40, 40, 119, 120, 121, -1, self.now))))

    def random_step(self, rng: "Draw") -> None:
        """Let time pass, or not, and step with whatever comes; a permission and a command that fit are frequent."""
        kind = rng.one(range(20))
        if kind == 0 and rng.one(range(8)) == 0:
            self.now = max(VALID_MS, self.now - rng.one((1, 5, 119, 5000)))
        else:
            self.now += rng.one(WAITS if kind < 4 else (0, 1, 5, 5))
            if self.now >= WRAP:
                self.now -= WRAP - VALID_MS  # as robot.c does
        inputs = {"latch": rng.rarely(3, 4, 6, 7), "turning": rng.rarely(1)}
        if kind >= 9:
            inputs |= self.command(rng)
        if kind >= 12 or kind == 1:
            inputs |= self.permission(rng)
        if rng.one(range(12)) == 0:
            inputs |= {"lease": 1, "lease_session": rng.one(SESSIONS), "lease_action": rng.one(ACTIONS)}
        self.step(**inputs)


class Draw:
    """Draws by a source of random numbers: ``pick(n)`` is one of 0 to n - 1."""

    def __init__(self, pick: Any) -> None:
        self.pick = pick

    def one(self, values: Any) -> int:
        return int(values[self.pick(len(values))])

    def slip(self) -> int:
        """Mostly 0."""
        kind = self.pick(80)
        return (1, -1)[kind] if kind < 2 else 0

    def rarely(self, *values: int) -> int:
        kind = self.pick(250)
        return values[kind] if kind < len(values) else 0

    def speed(self) -> int:
        return self.one(SPEEDS) if self.pick(12) == 0 else self.pick(256) * 16 - 2000


def _figure(ms: int) -> int:
    return gate.UNKNOWN if ms == -1 else ms * MS


def _in_python(inputs: dict[str, int]) -> Inputs:
    values: dict[str, Any] = dict(inputs)
    for name in ("command_left", "command_right", "permission_limit"):
        if name in values:
            values[name] *= SPEED
    for name in ("command_nonce", "permission_nonce"):
        if name in values:
            values[name] = ns(values[name])
    for name in ("command", "permission", "lease", "turning"):
        values[name] = bool(values.get(name))
    return Inputs(**values)


def walk(library: Any, steps: int, seed: int) -> Counter[str]:
    """Drive both gates at random; a gate lives for 2,000 steps, one of ten of them near the end of its clock."""
    source = random.Random(seed)
    rng, met = Draw(lambda n: int(source.random() * n)), Counter[str]()
    for life in range(steps // 2000):
        now = WRAP - 3000 if life % 10 == 9 else VALID_MS + source.randrange(10**6)
        pair = Pair(library, source.randrange(2**31), now, source.choice((0, 0, 2, 6)), source.randrange(9))
        for _ in range(2000):
            pair.random_step(rng)
        met += pair.met
    return met


class Driven(Pair):
    """Both gates with a lease of 21, and messages that fit but for what a test changes."""

    def __init__(self, library: Any) -> None:
        super().__init__(library)
        self.step(lease=1, lease_session=21, lease_action=1)

    def permit(self, **changes: int) -> None:
        g = self.state
        fits = {"permission_epoch": g.epoch, "permission_seq": g.enabled_seq + 1, "permission_boot_id": g.boot_id}
        self.step(permission=1, **fits | {"permission_nonce": self.now, "permission_limit": 6413} | changes)

    def move(self, left: int, right: int, **changes: int) -> None:
        g = self.state
        fits = {"command_epoch": g.epoch, "command_seq": g.seq + 1, "command_boot_id": g.boot_id}
        fits |= {"command_session": 21, "command_nonce": self.now, "command_left": left, "command_right": right}
        self.step(command=1, **fits | changes)


def test_a_lease_lapses_in_the_same_millisecond(library: Any) -> None:
    for wait, granted in ((999, 0), (1000, 1)):
        pair = Driven(library)
        pair.now += wait
        pair.step(lease=1, lease_session=22, lease_action=1)
        assert pair.in_c.epoch == 1 + granted


def test_a_command_and_a_permission_are_stale_in_the_same_millisecond(library: Any) -> None:
    for command_ms, permission_ms in ((0, 50), (50, 0)):
        pair = Driven(library)
        start = pair.now
        pair.now = start + min(command_ms, permission_ms)
        for at_ms in (0, 50, 119, 120, 121, 169, 170):
            pair.now = start + at_ms
            if at_ms == permission_ms:
                pair.permit()
            if at_ms == command_ms:
                pair.move(600, -300)
            pair.step()
        assert pair.met["status 0"] > 2


def test_no_motion_is_permitted_by_a_limit_of_zero_and_one_is_a_limit(library: Any) -> None:
    for limit, status in ((-1, 2), (0, 2), (1, 0)):
        pair = Driven(library)
        pair.permit(permission_limit=limit)
        pair.move(0, 0)
        assert pair.in_c.status == status


def test_one_per_cent_more_than_a_limit_is_within_it(library: Any) -> None:
    """In C alone: of limits where that is a whole number."""
    pair = Driven(library)
    limits = pair.ffi.new("struct gate_limits *", {"max_wheel": 6400, "max_sum": 9400, "max_ramp": RAMP})
    for left, right, within in ((6464, 0, 1), (6465, 0, 0), (0, -6465, 0), (4747, 4747, 1), (4747, 4748, 0)):
        inputs = {"command": 1, "command_epoch": 1, "command_session": 21, "command_seq": pair.in_c.seq + 1}
        inputs |= {"command_boot_id": 7, "command_nonce": pair.now, "command_left": left, "command_right": right}
        before = pair.in_c.refused
        pair.c.gate_step(pair.in_c, limits, pair.ffi.new("struct gate_inputs *", inputs), pair.now)
        assert pair.in_c.refused == before + 1 - within
    for limit, status in ((4700, 0), (4699, 2)):
        pair.in_c.limit, pair.in_c.enabled_nonce = limit, pair.now
        pair.c.gate_step(pair.in_c, limits, pair.ffi.new("struct gate_inputs *"), pair.now)
        assert pair.in_c.status == status


def test_a_gate_that_was_held_up_takes_what_is_issued_from_then_on(library: Any) -> None:
    for held_ms in (120, 121):
        pair = Driven(library)
        pair.permit()
        pair.move(600, -300)
        pair.now += 60
        pair.permit()
        pair.move(600, -300)
        pair.now += held_ms
        pair.step()
        for age in (1, 0):
            pair.permit(permission_nonce=pair.now - age)
            pair.move(600, -300, command_nonce=pair.now - age)
        assert pair.in_c.status == 0


def test_of_two_permissions_the_one_with_the_higher_nonce_or_sequence_counts(library: Any) -> None:
    pair = Driven(library)
    pair.permit(permission_seq=5)
    refused = pair.in_c.refused
    for seq, age, taken in ((5, 0, 0), (4, 0, 0), (6, 1, 0), (6, 0, 1)):
        pair.permit(permission_seq=seq, permission_nonce=pair.now - age)
        refused += 1 - taken
        assert pair.in_c.refused == refused


@settings(max_examples=100, derandomize=True, deadline=None)
@given(data=st.binary(max_size=1000))
def test_both_gates_agree_in_whatever_hypothesis_draws(library: Any, data: bytes) -> None:
    drawn = iter(data)
    pair, rng = Pair(library), Draw(lambda n: next(drawn, 0) * n // 256)
    for _ in range(30):
        pair.random_step(rng)


def test_both_gates_agree_at_random(library: Any) -> None:
    met = walk(library, 20_000, seed=1)
    assert min(met[f"status {status}"] for status in range(5)) > 200
    assert min(met[f"granted {granted}"] for granted in (0, 1)) > 100
    assert met["arrived a step apart"] < 20


@pytest.mark.long
def test_both_gates_agree_in_ten_million_steps(library: Any) -> None:
    assert walk(library, 10_000_000, seed=2)["steps"] == 10_000_000


def test_a_runaway_wheel_is_judged_as_in_python(library: Any) -> None:
    ffi, c = library
    source = random.Random(3)
    found = 0
    for _ in range(200):
        now = since = looked = 1000
        direction, way = 0, source.choice((1, -1))
        in_c = ffi.new("struct runaway *", {"since": now, "looked": now})
        for _ in range(60):
            now = max(0, now + source.choice((0, 5, 20, 20, 40, 100, 101, -3) if source.random() < 0.1 else (20, 40)))
            measured = way * (900 if source.random() < 0.95 else source.choice((0, 256, 257, -257, -900, 611, 612)))
            output = way * source.choice((0, 0, 20000, 33152, 59913, 59914) if source.random() < 0.99 else (60000, -99))
            before, direction = direction, runaway.direction(output * OUTPUT, measured * SPEED)
            since = runaway.turning_since_ns(since * MS, looked * MS, before, direction, now * MS) // MS
            looked = now
            runs = c.runaway_look(in_c, output, measured, now)
            judged = in_c.direction, in_c.since, in_c.looked, runs
            assert judged == (direction, since, now, runaway.runs(since * MS, now * MS))
            found += runs
    assert found > 100


def test_at_the_limit_of_what_obeys_both_judge_a_wheel_alike(library: Any) -> None:
    ffi, c = library
    for output in (-99, 99, *range(-40 * 1024, 41 * 1024, 1024)):
        for turning in (-256, 256):
            limit = 11 * output // 1024 + turning
            for measured in (turning - 1, turning, turning + 1, limit - 1, limit, limit + 1):
                in_c = ffi.new("struct runaway *")
                c.runaway_look(in_c, output, measured, 1000)
                assert in_c.direction == runaway.direction(output * OUTPUT, measured * SPEED), (output, measured)
