"""The checks before a start, as the supervisor runs them: the drill, the probe, what they leave, and the wait."""

from collections.abc import Callable
from typing import Any

import numpy as np

from robofleet.bus.keys import REQUEST, STATE, STATUS, key
from robofleet.bus.messages import RUN_STATE
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.runs.lockstep import Lockstep
from robofleet.safety import arming
from robofleet.safety.arming import ArmingState, Stage
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Happening, Phase
from robofleet.safety.wiggle import PROBE_RAD_S, Wiggle
from tests.nodes.stand import Stand, proved


def test_who_is_tried_alone_may_move_while_armed(stand_of: Callable[..., Stand]) -> None:
    tried = ArmingState(Stage.WIGGLE, wiggle=Wiggle(strokes=(2, 0, 1, 0)))
    stand = stand_of(prove=lambda *_: (tried, None))
    stand.run(S // 5)
    stand.ask("start")
    stand.run(S // 5)
    assert (stand.state.stage, [robot.stroke for robot in stand.state.robots]) == (Stage.WIGGLE, [2, 0, 1, 0])
    assert stand.limits() == [PROBE_RAD_S, 0.0, PROBE_RAD_S, 0.0]
    assert [robot.permitted for robot in stand.state.robots] == [1, 0, 1, 0]
    stand.hidden.add("r3")
    stand.run(S // 5)
    assert stand.limits() == [PROBE_RAD_S, 0.0, 0.0, 0.0]
    stand.ask("stop")
    assert (stand.state.stage, [robot.stroke for robot in stand.state.robots]) == (Stage.CHECKS, [0] * 4)


def test_a_drill_latches_every_gate_and_clears_it_again(stand_of: Callable[..., Stand]) -> None:
    wanted = [ArmingState(Stage.DRILL, latch=Latch.DRILL)]
    stand = stand_of(prove=lambda *_: (wanted[0], None))
    stand.run(S // 5)
    stand.ask("start")
    stand.run(S // 5)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.DRILL}
    wanted[0] = ArmingState(Stage.DRILL)
    stand.run(S // 5)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.DRILL}, "not before it is asked"
    wanted[0] = ArmingState(Stage.DRILL, clear=True)
    stand.run(S // 5)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.NONE}
    assert stand.state.phase == Phase.ARMED


def test_a_drill_that_was_broken_off_leaves_nothing_behind_and_clears_no_e_stop(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(prove=lambda *_: (ArmingState(Stage.DRILL, latch=Latch.DRILL), None))
    stand.run(S // 5)
    stand.ask("start")
    stand.run(S // 5)
    stand.ask("stop")
    stand.robots["r4"].latch, stand.robots["r4"].latch_id = Latch.EMERGENCY_STOP, 2
    stand.run(S // 5)
    assert [robot.latch for robot in stand.robots.values()] == [0, 0, 0, Latch.EMERGENCY_STOP]


def test_the_checks_can_refuse_a_fleet_by_name(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(prove=lambda state, *_: (state, Happening(Event.WHEELS_SWAPPED, 1)))
    stand.run(S // 5)
    stand.ask("start")
    assert stand.cause == (Phase.FAULT, Event.WHEELS_SWAPPED, 1)
    assert stand.lines[-1] == "ARMED -> FAULT: r2: its wheels are swapped"


def test_a_start_begins_the_checks_anew(stand_of: Callable[..., Stand]) -> None:
    seen: list[ArmingState] = []
    stand = stand_of(prove=lambda state, *_: (seen.append(state), (state._replace(stage=Stage.WIGGLE), None))[1])
    for _ in range(2):
        stand.run(S // 5)
        stand.ask("start")
        started_ns = stand.bench.now_ns
        stand.run(S // 5)
        assert Stage.WIGGLE in [state.stage for state in seen]
        assert (seen[0].stage, seen[0].since_ns) == (Stage.CHECKS, started_ns)
        stand.ask("stop")
        seen.clear()


def test_a_start_that_is_asked_for_during_the_checks_is_heard(stand_of: Callable[..., Stand]) -> None:
    passed: list[bool] = []
    stand = stand_of(prove=lambda *seen: proved(*seen) if passed else (seen[0], None))
    stand.run(S // 5)
    for wish in ("arm", "arm", "start"):
        assert stand.ask(wish) == "ok"
        stand.run(S)
    assert stand.state.phase == Phase.ARMED
    passed.append(True)
    stand.run(40 * MS)
    assert stand.state.phase == Phase.RUNNING


def test_the_start_of_an_earlier_time_is_forgotten(stand_of: Callable[..., Stand]) -> None:
    """Even where the wishes come one right behind the other."""
    stand = stand_of(prove=lambda state, *_: (state, None))
    stand.run(S // 5)
    assert stand.ask("start") == "ok"
    arming.step = proved
    for wish in (b"stop", b"arm"):
        stand.bench.bus.ask(REQUEST, "supervisor", wish)
    stand.run(S)
    assert (stand.state.phase, stand.state.stage) == (Phase.ARMED, Stage.DONE)


def test_checks_are_passed_anew_after_a_stop_that_a_start_follows_at_once(stand_of: Callable[..., Stand]) -> None:
    seen: list[ArmingState] = []
    stand = stand_of(prove=lambda state, *rest: (seen.append(state), proved(state, *rest))[1])
    stand.armed()
    seen.clear()
    for wish in (b"stop", b"start"):
        stand.bench.bus.ask(REQUEST, "supervisor", wish)
    stand.run(40 * MS)
    assert seen[0].stage is Stage.CHECKS
    assert stand.state.phase == Phase.RUNNING


def test_a_fleet_that_nobody_starts_is_idle_again_and_can_be_armed_at_once(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of()
    stand.armed()
    arming.step = lambda state, *_: (state, Happening(Event.NOT_STARTED))
    stand.run(40 * MS)
    assert (stand.state.phase, stand.state.cause) == (Phase.IDLE, Event.NOT_STARTED)
    arming.step = proved
    stand.armed()


def test_a_whole_fleet_is_armed_waits_at_rest_and_is_started(platoon_of: Callable[..., Config]) -> None:
    run = Lockstep(platoon_of("tracker.source=truth", "groups.0.robots=[r1, r2]"))
    run.request(b"arm")
    run.advance(0.1)

    def state() -> Any:
        return RUN_STATE.decode(run.recording.messages[key("platoon", STATE)][-1])

    assert run.advance(20.0, lambda: state().stage == Stage.DONE)
    before = len(run.recording.messages[key("platoon", STATUS, "r1")])
    run.advance(1.0)
    assert (run.status.phase, state().stage) == (Phase.ARMED, Stage.DONE)
    statuses = run.recording.of_robot(STATUS, "r1")
    assert not np.any(statuses["left_output_rad_s"][before:])
    run.request(b"start")
    assert run.advance(0.1, lambda: run.status.phase is Phase.RUNNING)
    run.advance(1.0)
    statuses = run.recording.of_robot(STATUS, "r1")
    assert statuses["left_output_rad_s"][-1] > 0.0
    run.close()
