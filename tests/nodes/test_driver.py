"""The driver process: nothing moves without command and permission, both fresh; nothing blocks it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import COMMAND, ENABLE, LEASE, STATUS, TRUTH
from robofleet.core.clock import MS, S
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, WIRED_STOP, WheelSpeeds
from tests.bus.alone import Enable, WheelCommand

Make = Callable[..., Any]
FORWARD = WheelSpeeds(3.0, 4.0)
EXPOSURE_NS = 77


def moves(stand: Any, robot: str = "r1") -> list[tuple[int, WheelSpeeds]]:
    return [(at, wheels) for at, wheels in stand.made[robot].writes if wheels != STOP]


@pytest.mark.parametrize(
    ("commands", "limit", "why"),
    [(True, None, GateStatus.NO_ENABLE), (False, 12.5, GateStatus.NO_COMMAND), (True, 0.0, GateStatus.NO_ENABLE)],
    ids=["no permission", "no command", "a permission to stand"],
)
def test_without_command_or_permission_nothing_moves(
    stand: Any, commands: bool, limit: float | None, why: GateStatus
) -> None:
    stand.acquire("r1")
    others = [(33 * MS, lambda: stand.command("r1"))] * commands
    others += [(40 * MS, lambda: stand.enable("r1", limit=limit))] * (limit is not None)
    stand.bench.run(stand.node, S // 2, *others)
    assert moves(stand) == []
    assert (stand.newest("r1").gate, stand.newest("r1").rejected) == (why, 0)


def test_with_both_the_wheels_do_what_they_are_told(stand: Any) -> None:
    stand.run(S // 2)
    assert all(left / 3.0 == pytest.approx(right / 4.0) for _, (left, right) in moves(stand))  # up along one line
    assert stand.made["r1"].target == FORWARD
    status = stand.newest("r1")
    assert (status.gate, status.applied_exposure_ns) == (GateStatus.OPEN, EXPOSURE_NS)
    assert 0 < status.applied_ns < stand.bench.now_ns - 33 * MS  # said again, it is not applied again


@pytest.mark.parametrize("silent", ["commands", "enables"])
def test_wheels_stop_when_the_newest_echo_is_120_ms_old(stand: Any, silent: str) -> None:
    stand.run(S // 2)
    before = stand.bench.now_ns
    stand.run(S // 2, **{silent: False})
    falls = [at for at, wheels in stand.made["r1"].writes if wheels != FORWARD and at > before]
    stops = [at for at, wheels in stand.made["r1"].writes if wheels == STOP and at > before]
    assert stops
    nonce = stand.seen["r1"] if silent == "commands" else before
    assert nonce < falls[0] <= nonce + 120 * MS
    assert falls[0] < stops[0] <= nonce + 230 * MS
    status = stand.newest("r1")
    assert 0 <= status.target_after_ns <= 120 * MS < status.output_after_ns <= 230 * MS
    assert stand.made["r1"].target == STOP
    expected = GateStatus.NO_COMMAND if silent == "commands" else GateStatus.NO_ENABLE
    assert stand.newest("r1").gate == expected


def test_the_process_wakes_at_the_deadline_between_two_loops(stand: Any) -> None:
    """A loop that was late gave a nonce off the grid of 10 ms."""
    stand.acquire("r1")
    next_ns = stand.node.step(stand.bench.now_ns)
    for _ in range(20):
        stand.bench.clock.advance_to(next_ns + 3 * MS)
        stand.node.step(stand.bench.now_ns)
        stand.command("r1")
        stand.enable("r1")
        next_ns = stand.bench.now_ns + 10 * MS
    assert stand.made["r1"].target == FORWARD
    stand.bench.run(stand.node, S // 5)
    falls = [at for at, (left, _) in stand.made["r1"].writes if at >= stand.seen["r1"] and left < 3.0]
    assert falls[0] == stand.seen["r1"] + 120 * MS
    assert stand.newest("r1").target_after_ns == 120 * MS


def test_what_comes_late_moves_nothing_however_much_comes(stand: Any) -> None:
    """A network that stood still and resumes."""
    stand.run(S // 2, commands=False)
    late = 7  # statuses, 20 ms apart
    moved = len(moves(stand))
    stand.bench.run(
        stand.node, S // 2, (5 * MS, lambda: stand.command("r1", age=late)), (40 * MS, lambda: stand.enable("r1"))
    )
    assert len(moves(stand)) == moved == 0
    assert stand.newest("r1").rejected > 20


@pytest.mark.parametrize("what", ["a speed that cannot be", "rubbish"])
def test_what_is_refused_is_counted_and_does_not_reach_the_wheels(stand: Any, what: str) -> None:
    stand.run(S // 2)
    applied = stand.newest("r1").applied_exposure_ns
    if what == "rubbish":
        stand.bench.bus.publisher(COMMAND, "r1")(b"\x02rubbish")
    else:
        stand.command("r1", wheels=WheelSpeeds(99.0, 99.0), exposure_ns=EXPOSURE_NS + 1)
    stand.bench.run(stand.node, 30 * MS)
    status = stand.newest("r1")
    assert (status.applied_exposure_ns, status.rejected, status.gate) == (applied, 1, GateStatus.OPEN)
    assert stand.made["r1"].target == FORWARD


def test_one_process_keeps_its_robots_apart(stand: Any) -> None:
    stand.run(S // 2, robot="r2")
    assert moves(stand, "r1") == []
    assert stand.made["r2"].target == FORWARD
    first, other = stand.newest("r1"), stand.newest("r2")
    assert (first.gate, other.gate) == (GateStatus.NO_ENABLE, GateStatus.OPEN)
    assert first.rejected == other.rejected == 0


def test_a_status_and_the_truth_every_20_ms(bench_of: Make, platoon_of: Make, driver_of: Make) -> None:
    bench = bench_of(platoon_of("drivers.robots_per_process=2"))
    node = driver_of(bench, "r1", "r2")
    bench.run(node, S)
    for robot in ("r1", "r2"):
        statuses, truths = bench.heard(STATUS, robot), bench.heard(TRUTH, robot)
        assert set(np.diff([status.stamp_ns for status in statuses])) == {20 * MS}
        assert set(np.diff([truth.stamp_ns for truth in truths])) == {20 * MS}
        assert len({status.nonce for status in statuses}) == len(statuses)
        assert len({status.boot_id for status in statuses}) == 1
    start = bench.config.robot("r2").start
    truth = bench.heard(TRUTH, "r2")[-1]
    assert (truth.x_m, truth.y_m, truth.psi_rad) == pytest.approx((start.x_m, start.y_m, start.psi))


def test_a_robot_that_exists_has_no_truth_to_tell(stand: Any) -> None:
    stand.run(S // 10)
    assert stand.bench.heard(STATUS, "r1")
    assert not stand.bench.heard(TRUTH, "r1")
    assert stand.newest("r1").battery == -1.0


def test_a_missed_loop_is_not_made_up(stand: Any) -> None:
    stand.run(S // 10)
    before = len(stand.bench.heard(STATUS, "r1"))
    stand.bench.wait(S)
    for _ in range(5):
        next_ns = stand.node.step(stand.bench.now_ns)
        assert 0 < next_ns - stand.bench.now_ns <= 10 * MS
    assert len(stand.bench.heard(STATUS, "r1")) - before <= 1


def test_a_message_wakes_the_process(bench_of: Make, platoon_of: Make, recorded: Make, driver_of: Make) -> None:
    bench = bench_of(platoon_of(*recorded(0)))
    driver_of(bench, "r1", wake=bench.woken.append)
    bench.say(ENABLE, Enable(1, 1, 1, 1, 2, 0, 0, 1.0), "r2")
    assert bench.woken == []
    bench.say(ENABLE, Enable(1, 1, 1, 1, 2, 0, 0, 1.0), "r1")
    bench.say(COMMAND, WheelCommand(1, 1, 1, 1, 1, 0, 0.0, 0.0), "r1")
    bench.bus.ask(LEASE, "r1", b"")
    assert bench.woken == [bench.now_ns] * 3


def test_closing_stops_every_robot_whatever_one_of_them_does(stand: Any, fake_driver: Any) -> None:
    stand.run(S // 2, robot="r2")
    assert stand.made["r2"].target == FORWARD
    fake_driver.unwritable.add("r1")
    with pytest.raises(ExceptionGroup) as caught:
        stand.node.close()
    assert [str(error) for error in caught.value.exceptions] == ["r1 is unplugged"]
    assert stand.made["r2"].target == STOP
    stand.node.close()
    assert (stand.made["r1"].closed, stand.made["r2"].closed) == (1, 1)


def test_a_probe_sees_every_decision_and_none_is_made_where_nothing_can_change(
    bench_of: Make, platoon_of: Make, recorded: Make, fake_driver: Any, driver_of: Make
) -> None:
    seen: list[tuple[str, int, Any, Any]] = []
    bench = bench_of(platoon_of(*recorded(0)))
    node = driver_of(bench, "r1", probe=lambda *what: seen.append(what))
    bench.run(node, S)
    assert len(seen) == 1  # disarmed: a hundred loops, and nobody asked
    robot = fake_driver.instances["r1"]
    robot.faults = WIRED_STOP
    bench.run(node, S)
    assert len(seen) == 2
    name, _, inputs, state = seen[-1]
    assert (name, inputs.latch, state.latch, state.output) == ("r1", Latch.WIRED_STOP, Latch.WIRED_STOP, STOP)
    robot.faults = 0
    bench.run(node, S)
    assert len(seen) == 2


def test_a_clock_that_is_set_back_stops_the_wheels_by_the_loop_that_sees_it(stand: Any) -> None:
    stand.run(S // 5)
    boot_id, back_ns = stand.newest("r1").boot_id, 100 * MS
    stand.bench.clock._now_ns -= back_ns
    set_back_ns = stand.bench.now_ns
    next_ns = stand.node.step(set_back_ns)
    assert set_back_ns < next_ns <= set_back_ns + 10 * MS
    stand.bench.run(stand.node, 90 * MS)
    assert stand.made["r1"].target == STOP
    status = stand.newest("r1")
    assert (status.boot_id, status.target_after_ns, status.gate) == (boot_id + 1, -1, GateStatus.NO_ENABLE)
    stand.run(S // 5)
    assert stand.made["r1"].target == FORWARD


def test_a_command_that_waits_for_its_permission_reaches_the_wheels_with_it(stand: Any) -> None:
    stand.acquire("r1")
    stand.command("r1", exposure_ns=5)
    stand.bench.run(stand.node, 25 * MS)
    assert (stand.newest("r1").applied_exposure_ns, stand.newest("r1").applied_ns) == (0, 0)
    stand.enable("r1")
    enabled_ns = stand.bench.now_ns
    stand.bench.run(stand.node, 25 * MS)
    assert (stand.newest("r1").applied_exposure_ns, stand.newest("r1").applied_ns) == (5, enabled_ns)
