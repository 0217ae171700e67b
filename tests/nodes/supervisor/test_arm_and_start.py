"""The two steps of a start: the fleet is armed, and waits; then it is started. Either can be asked for alone."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import REQUEST, STATE, STATUS, key
from robofleet.bus.messages import RUN_STATE
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.runs.lockstep import Lockstep
from robofleet.safety import arming
from robofleet.safety.arming import ArmingState, Stage
from robofleet.safety.supervisor import Event, Happening, Phase
from tests.nodes.stand import Stand, proved

Make = Callable[..., Any]


def armed(stand: Stand) -> None:
    stand.run(S // 5)
    assert stand.ask("arm") == "ok"
    stand.run(2 * S)
    assert (stand.state.phase, stand.state.stage) == (Phase.ARMED, Stage.DONE)
    assert stand.limits() == [0.0] * 4


def test_an_armed_fleet_waits_and_starts_at_once_when_asked(stand: Stand) -> None:
    armed(stand)
    assert stand.ask("status") == "ok: ARMED: arming requested; every check is passed: start it, or stop"
    assert stand.ask("start") == "ok"
    assert stand.state.phase == Phase.RUNNING
    assert min(stand.limits()) > 0.0


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
    armed(stand)
    seen.clear()
    for wish in (b"stop", b"start"):
        stand.bench.bus.ask(REQUEST, "supervisor", wish)
    stand.run(40 * MS)
    assert seen[0].stage is Stage.CHECKS
    assert stand.state.phase == Phase.RUNNING


def test_a_fleet_is_not_started_while_a_robot_is_missing(stand: Stand) -> None:
    armed(stand)
    stand.hidden.add("r3")
    stand.run(S // 2)
    assert stand.ask("start") == "refused: r3: the tracker lost the robot: mend it, then start, or stop"
    assert stand.state.phase == Phase.ARMED
    stand.hidden.clear()
    stand.run(S // 5)
    assert stand.ask("start") == "ok"
    assert stand.state.phase == Phase.RUNNING


@pytest.mark.parametrize("silent", ["controller", "tracker", "r2"])
def test_whoever_goes_silent_meanwhile_ends_it_by_a_fault(stand: Stand, silent: str) -> None:
    armed(stand)
    stand.silent.add(silent)
    stand.run(S)
    assert stand.state.phase == Phase.FAULT
    assert stand.ask("start").startswith("refused")


def test_a_fleet_that_nobody_starts_is_idle_again_and_can_be_armed_at_once(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of()
    armed(stand)
    arming.step = lambda state, *_: (state, Happening(Event.NOT_STARTED))
    stand.run(40 * MS)
    assert (stand.state.phase, stand.state.cause) == (Phase.IDLE, Event.NOT_STARTED)
    arming.step = proved
    armed(stand)


@pytest.mark.parametrize(("before", "way_out"), [(["start"], "hold it"), (["start", "hold"], "resume it")])
def test_a_fleet_that_runs_is_not_armed(stand: Stand, before: list[str], way_out: str) -> None:
    stand.run(S // 5)
    for wish in before:
        stand.ask(wish)
        stand.run(S // 5)
    assert way_out in stand.ask("arm")


def test_who_arms_a_fleet_and_goes_away_stops_it(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(attended=True)
    stand.run(S // 5)
    stand.silent.add("operator")
    stand.run(2 * S)
    assert stand.ask("arm") == "ok"
    assert stand.state.phase == Phase.ARMED
    stand.run(2 * S)
    assert (stand.state.phase, stand.state.cause) == (Phase.ESTOP, Event.OPERATOR_LOST)


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
