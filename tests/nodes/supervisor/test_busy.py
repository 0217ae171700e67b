"""The supervisor on a busy machine: a run that is only simulated goes on by itself; one of real robots only says it."""

from collections.abc import Callable

import pytest

from robofleet.bus.keys import BUSY
from robofleet.bus.messages import BusyMachine
from robofleet.core.clock import MS, S
from robofleet.recording.state_words import state_words
from robofleet.safety.arming import ArmingState, Stage
from robofleet.safety.supervisor import NOBODY, Event, Happening, Phase
from tests.nodes.stand import Stand

MakeStand = Callable[..., Stand]
SILENT = [
    ("tracker", Event.TRACKER_SILENT, NOBODY),
    ("controller", Event.CONTROLLER_SILENT, NOBODY),
    ("r2", Event.DRIVER_SILENT, 1),
]


def told(stand: Stand) -> BusyMachine | None:
    messages: list[BusyMachine] = stand.bench.heard(BUSY)
    return messages[-1] if messages else None


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("who", "event", "robot"), SILENT)
@pytest.mark.parametrize("counted", [False, True])
def test_a_simulated_run_goes_on_when_who_was_late_is_heard_again(
    stand_of: MakeStand, who: str, event: Event, robot: int, counted: bool
) -> None:
    """Whether its turns are counted, and show that it waited for a core, or not."""
    stand = stand_of(contended=0.9, counted=counted)
    stand.running()
    stand.silent.add(who)
    stand.run(700 * MS)
    assert stand.cause == (Phase.HOLD, event, robot)
    assert stand.limits() == [0.0] * 4
    message = told(stand)
    assert message is not None
    assert (message.cause, message.goes_on, message.resumed) == (event, 1, 0)
    stand.silent.clear()
    stand.run(S)
    assert stand.cause == (Phase.RUNNING, Event.CAUGHT_UP, NOBODY)
    assert min(stand.limits()) > 0.0
    message = told(stand)
    assert message is not None
    assert (message.cause, message.goes_on, message.resumed) == (Event.NOTHING, 0, 1)
    assert len([line for line in stand.lines if line.startswith("this machine is busy: load 6.1 on 2 cores")]) == 1


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("who", "event", "robot"), SILENT)
def test_who_was_stopped_or_hangs_on_a_busy_machine_is_not_late_by_load(
    stand_of: MakeStand, who: str, event: Event, robot: int
) -> None:
    """Others are, at the same time: that does not explain it."""
    stand = stand_of(contended=0.9, counted=True)
    stand.running()
    stand.silent.add("r3")
    stand.run(160 * MS)
    stand.silent = {who}
    stand.stuck.add(who)
    stand.run(700 * MS)
    assert told(stand) is not None, "r3 was late by load"
    assert stand.cause == (Phase.HOLD if who == "tracker" else Phase.FAULT, event, robot)
    stand.silent.clear()
    stand.stuck.clear()
    stand.run(2 * S)
    assert stand.state.phase != Phase.RUNNING
    message = told(stand)
    assert message is not None
    assert (message.cause, message.goes_on, message.resumed) == (Event.NOTHING, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("who", "event", "robot"), SILENT)
@pytest.mark.parametrize(("contended", "driver"), [(None, "simulated"), (0.3, "simulated"), (0.9, "gternal")])
def test_without_evidence_and_with_a_robot_that_exists_it_stands_as_ever(
    stand_of: MakeStand, who: str, event: Event, robot: int, contended: float | None, driver: str
) -> None:
    """Where there is evidence the load is named."""
    stand = stand_of(f"robots.3.driver={driver}", contended=contended)
    stand.running()
    stand.silent.add(who)
    stand.run(700 * MS)
    stopped = (Phase.HOLD if who == "tracker" else Phase.FAULT, event, robot)
    assert stand.cause == stopped
    if driver == "simulated":
        assert told(stand) is None
    else:
        words = state_words(stand.state, told(stand), ("r1", "r2", "r3", "r4"))
        assert "(this machine was busy: load 6.1 on 2 cores, " in words.advice
        assert words.advice.endswith("): end other programs that keep this machine busy")
        assert not words.goes_on
    stand.silent.clear()
    stand.run(10 * S)
    assert stand.cause == stopped


@pytest.mark.slow
def test_an_operator_who_holds_a_held_run_keeps_it_held(stand_of: MakeStand) -> None:
    stand = stand_of(contended=0.9)
    stand.running()
    stand.silent.add("tracker")
    stand.run(400 * MS)
    assert stand.state.phase == Phase.HOLD
    assert stand.ask("hold") == "ok"
    stand.silent.clear()
    stand.run(10 * S)
    assert stand.cause == (Phase.HOLD, Event.TRACKER_SILENT, NOBODY)
    assert stand.ask("resume") == "ok"


@pytest.mark.slow
def test_a_driver_that_does_not_come_back_ends_the_run(stand_of: MakeStand) -> None:
    stand = stand_of(contended=0.9)
    stand.running()
    stand.silent.add("r2")
    stand.run(9 * S)
    assert stand.state.phase == Phase.HOLD
    stand.run(2 * S)
    assert stand.cause == (Phase.FAULT, Event.DRIVER_SILENT, 1)


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("contended", "phase"), [(0.9, Phase.RUNNING), (0.3, Phase.FAULT)])
def test_checks_that_a_late_process_has_spoilt_begin_anew(stand_of: MakeStand, contended: float, phase: Phase) -> None:
    begun: list[int] = []

    def prove(state: ArmingState, _: object, view: object, start: bool) -> tuple[ArmingState, Happening | None]:
        if state.stage is Stage.CHECKS:
            begun.append(stand.bench.now_ns)
            return state._replace(stage=Stage.WIGGLE), None
        if stand.bench.now_ns - begun[-1] < S:
            return state, None
        return state, Happening(Event.WRONG_GAIN, 0, 1.4) if len(begun) == 1 else Happening(Event.PROVED)

    stand = stand_of(contended=contended, prove=prove)
    stand.run(S)
    stand.ask("start")
    stand.run(S // 2)
    stand.silent.add("r2")
    stand.run(200 * MS)
    stand.silent.clear()
    stand.run(3 * S)
    assert stand.state.phase == phase
    assert len(begun) == 1 + (phase == Phase.RUNNING)
    again = [
        line for line in stand.lines if line.startswith("the checks begin anew, this machine is busy: r1: it travels")
    ]
    assert len(again) == len(begun) - 1
