"""The supervisor beside what the table of transitions says: late tags, the recorder, a successor, a whole run."""

from collections.abc import Callable
from typing import Any

from robofleet.bus.keys import RECORDER
from robofleet.bus.messages import RecorderStatus
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Phase
from tests.nodes.stand import Stand


def test_a_run_is_resumed_while_a_tag_is_late_and_its_robot_stands(stand: Stand) -> None:
    stand.running()
    stand.ask("hold")
    stand.hidden.add("r1")
    stand.run(S // 2)
    assert stand.ask("resume") == "ok"
    assert [limit > 0.0 for limit in stand.limits()] == [False, True, True, True]


def test_a_recorder_that_cannot_write_is_a_full_disk_whatever_the_disk_says(stand: Stand) -> None:
    stand.running()
    for failed in (0, 1):
        stand.bench.say(RECORDER, RecorderStatus(1, 1 + failed, 100, 0, failed))
        stand.run(1000 * MS)
        assert stand.cause[:2] == ((Phase.HOLD, Event.DISK_FULL) if failed else (Phase.RUNNING, Event.PROVED))
    stand.bench.say(RECORDER, RecorderStatus(1, 3, 100, 50, 0))
    stand.run(40 * MS)
    assert stand.ask("resume") == "ok"


def test_a_new_supervisor_begins_in_idle_and_leaves_latches_as_they_are(stand: Stand) -> None:
    stand.running()
    stand.ask("estop")
    stand.run(S // 5)
    successor = Stand(stand.bench)
    successor.robots = stand.robots
    successor.run(S)
    assert successor.state.phase == Phase.IDLE
    assert {robot.latch for robot in successor.robots.values()} == {Latch.EMERGENCY_STOP}
    assert successor.ask("start").startswith("refused: r1, r2, r3, r4: the gate is latched")


def test_a_motor_that_is_unplugged_in_a_run_holds_it(platoon_of: Callable[..., Config]) -> None:
    """The control error stays small then: the law follows what is predicted, and says nothing."""
    run = Lockstep(platoon_of("tracker.source=truth", "faults=[{kind: motor_stuck, robot: r2, at_s: 1}]"))
    run.request(b"start")
    assert run.advance(20.0, lambda: run.status.phase is Phase.RUNNING)
    assert run.advance(1.0 + 1.2, lambda: run.status.phase is not Phase.RUNNING), "not a word"
    run.close()
    held: Any = run.status
    assert (held.phase, held.cause, held.robot) == (Phase.HOLD, Event.WHEEL_STALLED, 1)
