"""Processes whose counters are near the end of 32 bits, and of 64: they go on, or nothing they say raises."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.bus import keys
from robofleet.bus.keys import key
from robofleet.bus.messages import FLEET_POSES, RUN_STATE, TICK_RECORD
from robofleet.core.clock import MS, S
from robofleet.nodes.unit.state_store import MemoryStateStore, StoredRobot
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.interface import STOP
from tests.bus.alone import ENABLE, ROBOT_STATUS, WHEEL_COMMAND

Make = Callable[..., Any]
LIMITS = [(1 << 31) - 3, (1 << 32) - 3, (1 << 63) - 1000]


@pytest.mark.slow
@pytest.mark.parametrize("near", LIMITS)
def test_a_fleet_runs_on_over_the_end_of_32_bits(platoon_of: Make, near: int) -> None:
    """Every count of every process begins there."""
    run = Lockstep(platoon_of("tracker.source=truth"))
    supervisor, tracker, controller = (run.nodes[name] for name in ("supervisor", "tracker", "controller"))
    supervisor._seq = supervisor._enable_seq = tracker._seq = tracker._news_seq = controller._seq = near  # type: ignore[attr-defined]
    for name, node in run.nodes.items():
        if name.startswith("driver"):
            node._seq = near  # type: ignore[attr-defined]
            for count in ("epoch", "latch_id", "refused"):
                node._robots._gates[count] = near  # type: ignore[attr-defined]
    run.request(b"start")
    assert run.advance(60.0, lambda: run.status.phase is Phase.RUNNING)
    run.advance(1.0)
    assert run.status.phase is Phase.RUNNING
    messages, arena = run.recording.messages, run.recording.config.arena.name
    for full, layout in (
        (key(arena, keys.STATE), RUN_STATE), (key(arena, keys.STATUS, "r1"), ROBOT_STATUS),
        (key(arena, keys.COMMAND, "r1"), WHEEL_COMMAND), (key(arena, keys.ENABLE, "r1"), ENABLE),
        (key(arena, keys.POSES, keys.CAMERA), FLEET_POSES),
    ):  # fmt: skip
        seqs = [message.seq for payload in messages[full] if (message := layout.decode(payload)) is not None]  # type: ignore[attr-defined]
        assert len(seqs) == len(messages[full]), "all of them can be read"
        assert seqs == sorted(seqs)
        assert near < seqs[0] < near + 20
        assert seqs[-1] > near + 20
    newest = TICK_RECORD.decode(messages[key(arena, keys.TICK)][-1])
    assert newest is not None
    assert newest.command_seq > near + 20
    run.close()


@pytest.mark.parametrize("near", [*LIMITS, (1 << 64) - 3])
def test_a_driver_goes_on_and_latches_near_the_end_of_its_numbers(stand: Any, driver_of: Make, near: int) -> None:
    state_store = MemoryStateStore()
    state_store.save("r1", StoredRobot(near, Latch.NONE, near))
    stand.node = driver_of(stand.bench, "r1", "r2", state_store=state_store, seed=5)
    stand._seq = near
    stand.node._seq = near
    stand.run(S // 5)
    assert stand.newest("r1").epoch == near + 1
    stand.bench.run(stand.node, S // 5, (40 * MS, lambda: stand.enable("r1", latch=Latch.EMERGENCY_STOP)))
    assert (stand.newest("r1").gate, stand.made["r1"].target) == (GateStatus.LATCHED, STOP)
    assert stand.newest("r1").latch == Latch.EMERGENCY_STOP


def test_what_is_used_up_stops_and_raises_nothing(stand: Any) -> None:
    """After the last number there is no newer one: nothing is obeyed any more."""
    stand.run(S // 5)
    assert stand.newest("r1").gate == GateStatus.OPEN
    stand._seq = (1 << 64) + 5
    stand.run(S // 2)
    assert stand.made["r1"].target == STOP
    assert stand.newest("r1").gate in (GateStatus.NO_COMMAND, GateStatus.NO_ENABLE)
    stand.bench.run(stand.node, 25 * MS)


def test_a_robot_far_beyond_all_numbers_is_a_state_that_can_be_read(platoon_of: Make) -> None:
    """A pose jumps by more than a double holds: the supervisor says so, and everybody hears it."""
    run = Lockstep(platoon_of("tracker.source=truth"))
    run.request(b"start")
    assert run.advance(60.0, lambda: run.status.phase is Phase.RUNNING)
    arena = run.recording.config.arena.name
    full = key(arena, keys.POSES, keys.CAMERA)
    newest = FLEET_POSES.decode(run.recording.messages[full][-1])
    assert newest is not None
    states = len(run.recording.messages[key(arena, keys.STATE)])
    for k in range(80):  # another place at each of the supervisor's looks
        far = 1.7e308 if k // 8 % 2 else -1.7e308
        poses = (newest.poses[0]._replace(x_m=far), *newest.poses[1:])
        newest = newest._replace(seq=newest.seq + 1000, poses=poses)
        run.bus.publisher(keys.POSES, keys.CAMERA)(FLEET_POSES.encode(newest))
        run.advance(0.005)
    run.advance(0.5, lambda: run.status.phase is not Phase.RUNNING)
    assert run.status.phase is not Phase.RUNNING
    payloads = run.recording.messages[key(arena, keys.STATE)][states:]
    assert payloads
    assert all(RUN_STATE.decode(payload) is not None for payload in payloads)
    run.close()
