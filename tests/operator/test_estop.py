"""The emergency stop with a supervisor that is frozen, gone or flooded: every gate latches all the same."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from robofleet.bus.bus import Answer, MemoryBus
from robofleet.bus.keys import ENABLE, REQUEST, SAFE_REQUEST, STATE, STATUS
from robofleet.bus.messages import RUN_STATE, RobotState, RunState
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.operator.estop import EmergencyStop, Stopped
from robofleet.operator.requests import by_supervisor
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Phase
from tests.process_fixtures import PLATOON, Stand

ROBOTS = ("r1", "r2", "r3", "r4")
_BOUND_MS = 100.0
_AT_S = 0.5  # since the fleet ran, trouble; the stop comes 0.1 s later


def stop(lockstep: Lockstep, *, by_gates: bool = True) -> Stopped:
    """Do what whoever stops does, in simulated time."""
    units = lockstep.recording.config.units if by_gates else None
    stopping = EmergencyStop(lockstep.bus, units, lockstep.clock.now_ns())
    while (stopped := stopping.step(lockstep.clock.now_ns())) is None:
        lockstep.advance(0.001)
    return stopped


def answered(lockstep: Lockstep, what: bytes) -> bytes:
    answer: Answer = lockstep.request(what)
    lockstep.advance(1.0)
    return answer.take() or b"no answer"


def latches(lockstep: Lockstep) -> set[int]:
    """Return what is kept of the robots' latches."""
    return {lockstep.state_store.load(robot).latch for robot in ROBOTS}


@pytest.fixture
def driving() -> Iterator[Callable[..., Lockstep]]:
    """Return what makes a fleet that drives and whose supervisor is in a trouble."""
    made: list[Lockstep] = []

    def make(kind: str | None, duration_s: float = 0.0) -> Lockstep:
        fault = {"kind": kind, "process": "supervisor", "at_s": _AT_S, "duration_s": duration_s}
        faults = [] if kind is None else [f"faults=[{fault}]".replace("'", "")]
        lockstep = Lockstep(load_config(PLATOON, ["tracker.source=truth", "robots.2.unit=third", *faults]))
        made.append(lockstep)
        lockstep.request(b"start")
        assert lockstep.advance(60.0, lambda: lockstep.status.phase is Phase.RUNNING)
        lockstep.advance(_AT_S + 0.1)
        assert lockstep.status.phase is Phase.RUNNING
        return lockstep

    yield make
    for lockstep in made:
        lockstep.close()


def flood(lockstep: Lockstep) -> None:
    """Ask the supervisor for so much that what was asked before is lost."""
    for _ in range(100):
        for topic in (REQUEST, SAFE_REQUEST):
            lockstep.bus.ask(topic, "supervisor", b"status")


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("kind", "duration_s"),
    [
        (None, 0.0),
        ("stopped", 0.4),
        ("killed", 2.0),
        *[pytest.param("stopped", duration_s, marks=pytest.mark.long) for duration_s in (0.2, 2.0)],
    ],
)
def test_every_gate_latches_and_nothing_goes_on_until_a_reset(
    driving: Callable[..., Lockstep], kind: str | None, duration_s: float
) -> None:
    lockstep = driving(kind, duration_s)
    stopped = stop(lockstep)
    assert stopped.silent == ()
    assert max(stopped.after_ms.values()) <= _BOUND_MS
    assert latches(lockstep) == {Latch.EMERGENCY_STOP}

    lockstep.advance(duration_s + 1.0)
    assert latches(lockstep) == {Latch.EMERGENCY_STOP}
    if kind == "killed":  # the new one knows nothing; the gates do
        assert lockstep.status.phase is Phase.IDLE
    else:
        assert lockstep.status.phase is Phase.ESTOP
        assert lockstep.status.cause in (Event.ESTOP_REQUESTED, Event.STOPPED_AT_GATE)
    assert answered(lockstep, b"start").startswith(b"refused: ")

    assert answered(lockstep, b"reset") == b"ok"
    assert latches(lockstep) == {Latch.NONE}
    assert answered(lockstep, b"start") == b"ok"
    assert lockstep.advance(60.0, lambda: lockstep.status.phase is Phase.RUNNING), "as after any emergency stop"


def test_of_another_computers_arena_the_supervisor_says_who_has_acknowledged(
    driving: Callable[..., Lockstep],
) -> None:
    lockstep = driving(None)
    stopped = stop(lockstep, by_gates=False)
    assert (stopped.silent, len(stopped.after_ms)) == ((), len(ROBOTS))
    assert by_supervisor(stopped).startswith("every robot acknowledged, after ")
    assert latches(lockstep) == {Latch.EMERGENCY_STOP}


@pytest.mark.parametrize(
    ("phase", "acknowledged", "words"),
    [
        (Phase.RUNNING, [1, 1, 1], "the supervisor does not answer: go and look"),
        (Phase.ESTOP, [1, 0, 0], "2 robots have not acknowledged: go and look"),
        (Phase.ESTOP, [1, 1, 1], "every robot acknowledged, after 40 ms"),
    ],
)
def test_of_another_computers_arena_it_is_said_who_has_not_acknowledged(
    phase: Phase, acknowledged: list[int], words: str
) -> None:
    clock = SimulatedClock()
    bus = MemoryBus("lab", clock, 0)
    stopping, publish = EmergencyStop(bus, None, 0), bus.publisher(STATE)
    stopped = None
    while stopped is None and clock.now_ns() < 2 * S:
        clock.advance_to(clock.now_ns() + 40 * MS)
        robots = tuple(RobotState(0, own, 0) for own in acknowledged)
        publish(RUN_STATE.encode(RunState(1, 1, phase, 0, 0, 0.0, 0, robots)))
        stopped = stopping.step(clock.now_ns())
    assert stopped is not None
    assert by_supervisor(stopped) == words


@pytest.mark.slow
def test_a_flood_of_requests_that_swallows_the_stop_keeps_no_gate_open(driving: Callable[..., Lockstep]) -> None:
    lockstep = driving(None)
    stopping = EmergencyStop(lockstep.bus, lockstep.recording.config.units, lockstep.clock.now_ns())
    while (stopped := stopping.step(lockstep.clock.now_ns())) is None:
        flood(lockstep)
        lockstep.advance(0.001)
    assert stopped.silent == ()
    assert max(stopped.after_ms.values()) <= _BOUND_MS
    lockstep.advance(0.5)
    assert lockstep.status.phase is Phase.ESTOP
    assert latches(lockstep) == {Latch.EMERGENCY_STOP}


def test_a_supervisor_that_only_sees_latched_gates_stops_the_others_and_says_why(
    driving: Callable[..., Lockstep],
) -> None:
    lockstep = driving(None)
    only = EmergencyStop(lockstep.bus, {"third": ("r3",)}, lockstep.clock.now_ns())
    only._answer = None
    flood(lockstep)  # the request is lost
    while only.step(lockstep.clock.now_ns()) is None:
        lockstep.advance(0.001)
    lockstep.advance(0.2)
    assert (lockstep.status.phase, lockstep.status.cause) == (Phase.ESTOP, Event.STOPPED_AT_GATE)
    assert lockstep.status.describe(ROBOTS).startswith("r3: an emergency stop closed its gate without the supervisor: ")
    assert latches(lockstep) == {Latch.EMERGENCY_STOP}


def poll(stopping: EmergencyStop, stand: Stand, within_ns: int) -> Stopped | None:
    """Let drivers and whoever stops go on, until it is over."""
    end_ns = stand.bench.now_ns + within_ns
    stopped = None
    while stopped is None and stand.bench.now_ns < end_ns:
        stopped = stopping.step(stand.bench.now_ns)
        stand.bench.run(stand.node, MS)
    return stopped


@pytest.mark.slow
@pytest.mark.parametrize("when", ["before", "after", "both"])
def test_a_permission_with_the_same_nonce_neither_forestalls_nor_undoes_it(stand: Stand, when: str) -> None:
    """Of a supervisor that is alive and has not heard, or that wakes: its words and the stop's meet at the gate."""
    stand.run(S)
    stopping = EmergencyStop(stand.bench.bus, {"r1": ("r1", "r2")}, stand.bench.now_ns)

    def word() -> None:
        stand.command("r1")
        if when != "after":
            stand.enable("r1")
            stand.node.step(stand.bench.now_ns)
        stopping.step(stand.bench.now_ns)
        stand.node.step(stand.bench.now_ns)
        if when != "before":
            stand.enable("r1")

    stand.bench.run(stand.node, 300 * MS, (5 * MS, word))
    for robot in ("r1", "r2"):
        assert stand.newest(robot).latch == Latch.EMERGENCY_STOP
    outputs = [status.left_output_rad_s for status in stand.bench.heard(STATUS, "r1")]
    assert outputs[-1] == 0.0


def test_what_is_lost_on_its_way_is_said_again_and_who_stays_silent_is_named(stand: Stand, monkeypatch: Any) -> None:
    stand.run(S)
    publisher, lost = stand.bench.bus.publisher, []

    def lossy(topic: Any, name: str = "") -> Any:
        publish = publisher(topic, name)

        def loses(payload: bytes) -> None:
            if topic is ENABLE and len(lost) < 4:
                lost.append(name)
            else:
                publish(payload)

        return loses

    monkeypatch.setattr(stand.bench.bus, "publisher", lossy)
    stopping = EmergencyStop(stand.bench.bus, {"r1": ("r1", "r2"), "r3": ("r3",)}, stand.bench.now_ns)
    stopped = poll(stopping, stand, S)
    assert stopped is not None
    assert stopped.silent == ("r3",)
    assert min(stopped.after_ms["r1"], stopped.after_ms["r2"]) > 40.0
    assert stopped.describe() == "NOT acknowledged within 200 ms by r3: stop them by hand"


def test_it_echoes_the_newest_word_of_each_robot_and_nothing_older(stand: Stand) -> None:
    """So what was recorded on the bus stops nobody later, and a robot that was started again is stopped too."""
    stand.run(S)
    messages: list[tuple[str, bytes]] = []
    stand.bench.bus.tap(messages.append)
    stopping = EmergencyStop(stand.bench.bus, {"r1": ("r1", "r2")}, stand.bench.now_ns)
    assert poll(stopping, stand, S) is not None
    latching = next(payload for full, payload in messages if full.endswith("/enable"))
    stand.bench.run(stand.node, 200 * MS)
    stand.enable("r1", clear=stand.newest("r1").latch_id)
    stand.bench.run(stand.node, 50 * MS)
    assert stand.newest("r1").latch == Latch.NONE
    rejected = stand.newest("r1").rejected
    stand.bench.bus.publisher(ENABLE, "r1")(latching)
    stand.bench.run(stand.node, 50 * MS)
    assert (stand.newest("r1").latch, stand.newest("r1").rejected) == (Latch.NONE, rejected + 1)
