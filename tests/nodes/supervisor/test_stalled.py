"""A wheel that stands though it is told to turn: named, and the run held, through the supervisor as it runs."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Event, Phase
from tests.nodes.stand import Stand

TURNS = {"left_angle_rad": 1.0, "left_output_rad_s": 12.5, "left_rad_s": 12.4}
STANDS = TURNS | {"left_rad_s": 0.0}


def test_a_robot_that_does_not_turn_is_named_after_a_second_and_the_run_is_held(stand: Stand) -> None:
    stand.running()
    stand.robots["r2"].says = STANDS
    stand.run(900 * MS)
    assert stand.state.phase == Phase.RUNNING
    stand.run(200 * MS)
    assert stand.cause == (Phase.HOLD, Event.WHEEL_STALLED, 1)
    assert "RUNNING -> HOLD: r2: a wheel does not turn, though it is told to" in stand.lines


def test_once_it_is_mended_the_run_goes_on_and_else_it_is_held_again(stand: Stand) -> None:
    stand.running()
    for mended in (False, True):
        stand.robots["r2"].says = STANDS
        stand.run(1100 * MS)
        assert stand.cause == (Phase.HOLD, Event.WHEEL_STALLED, 1)
        stand.robots["r2"].says = {"left_angle_rad": 1.0}
        stand.run(100 * MS)
        stand.robots["r2"].says = TURNS if mended else STANDS
        assert stand.ask("resume", 100 * MS) == "ok"
    stand.run(3 * S)
    assert stand.state.phase == Phase.RUNNING


@pytest.mark.parametrize(
    "says",
    [
        STANDS | {"left_output_rad_s": 1.9},
        STANDS | {"left_rad_s": 0.6},
        STANDS | {"left_angle_rad": 0.0},  # it counts nothing: nobody knows whether its wheels turn
        TURNS,
    ],
)
def test_who_turns_or_counts_nothing_is_left_alone(stand: Stand, says: dict[str, float]) -> None:
    stand.running()
    stand.robots["r2"].says = says
    stand.run(3 * S)
    assert stand.state.phase == Phase.RUNNING


def test_a_motor_that_is_unplugged_in_a_run_holds_it(platoon_of: Callable[..., Config]) -> None:
    """The control error stays small then: the law follows what is predicted, and says nothing."""
    run = Lockstep(platoon_of("tracker.source=truth", "faults=[{kind: motor_stuck, robot: r2, at_s: 1}]"))
    run.request(b"start")
    assert run.advance(20.0, lambda: run.status.phase is Phase.RUNNING)
    assert run.advance(1.0 + 1.2, lambda: run.status.phase is not Phase.RUNNING), "not a word"
    run.close()
    held: Any = run.status
    assert (held.phase, held.cause, held.robot) == (Phase.HOLD, Event.WHEEL_STALLED, 1)
