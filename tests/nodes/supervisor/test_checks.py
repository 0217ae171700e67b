"""The checks before a start, as the supervisor runs them: the drill, the probe, and what they leave behind."""

from collections.abc import Callable

from robofleet.core.clock import S
from robofleet.safety.arming import ArmingState, Stage
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Happening, Phase
from robofleet.safety.wiggle import PROBE_RAD_S, Wiggle
from tests.nodes.stand import Stand


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
