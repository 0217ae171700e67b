"""What the supervisor says: permissions, states, lines in its log, and when it wakes."""

import numpy as np

from robofleet.bus.keys import ENABLE, REQUEST, SAFE_REQUEST, STATE
from robofleet.core.clock import MS, S
from robofleet.safety.supervisor import Phase
from tests.nodes.stand import ROBOTS, Stand


def test_status_says_where_the_run_is_and_whom_something_holds(stand: Stand) -> None:
    stand.running()
    assert stand.ask("status") == "ok: RUNNING: every check passed"
    stand.hidden.add("r3")
    stand.run(S // 5)
    assert stand.ask("status") == "ok: RUNNING: every check passed; r3: it is not seen"


def test_every_change_is_a_line_in_the_log(stand: Stand) -> None:
    stand.running()
    stand.ask("hold")
    stand.ask("stop")
    assert stand.lines == [
        "IDLE -> ARMED: start requested",
        "ARMED -> RUNNING: every check passed",
        "RUNNING -> HOLD: hold requested",
        "HOLD -> IDLE: stop requested",
    ]


def test_enables_echo_the_newest_nonce_and_the_epoch_of_the_lease(stand: Stand) -> None:
    stand.robots["r2"].says = {"epoch": 9}
    stand.running()
    for robot in ROBOTS:
        enable = stand.enable(robot)
        assert (enable.boot_id, enable.phase) == (stand.robots[robot].boot_id, Phase.RUNNING)
        assert enable.epoch == (9 if robot == "r2" else 1)
        assert 0 <= stand.robots[robot].nonce - enable.nonce <= 40 * MS
    stand.silent.add("r1")
    stand.run(S // 5)
    assert stand.enable("r1").nonce == stand.robots["r1"].nonce, "an old nonce is never made fresh"


def test_nobody_is_enabled_before_it_was_heard(stand: Stand) -> None:
    stand.silent.add("r3")
    stand.run(S // 5)
    assert stand.bench.heard(ENABLE, "r3") == []
    assert stand.bench.heard(ENABLE, "r2")


def test_a_state_every_40_ms_and_at_once_when_it_changes(stand: Stand) -> None:
    at: list[int] = []
    stand.bench.bus.tap(lambda tapped: at.append(stand.bench.now_ns) if tapped[0].endswith("/state") else None)
    stand.run(S)
    assert set(np.diff(at)) == {40 * MS}
    stand.bench.wait(5 * MS)
    before, enables = len(at), len(stand.bench.heard(ENABLE, "r1"))
    stand.ask("estop")
    assert len(at) == before + 1
    assert len(stand.bench.heard(ENABLE, "r1")) == enables + 1
    sequence = [state.seq for state in stand.bench.heard(STATE)]
    assert sequence == list(range(1, len(sequence) + 1))


def test_a_request_wakes_it(stand: Stand) -> None:
    stand.bench.bus.ask(REQUEST, "supervisor", b"estop")
    stand.bench.bus.ask(SAFE_REQUEST, "supervisor", b"estop")
    assert stand.woken == [stand.bench.now_ns] * 2


def test_who_may_only_look_asks_for_what_makes_nothing_move(stand: Stand) -> None:
    answers = {what: stand.bench.bus.ask(SAFE_REQUEST, "supervisor", what) for what in (b"start", b"status", b"reset")}
    stand.bench.run(stand.node, S // 10)
    replies = {what: (answer.take() or b"").decode() for what, answer in answers.items()}
    assert replies[b"status"].startswith("ok: IDLE")
    for what in (b"start", b"reset"):
        assert replies[what] == "refused: only status, hold, estop, pictures are for everybody: ask as an operator"


def test_missed_periods_are_not_made_up(stand: Stand) -> None:
    stand.run(S // 5)
    before = len(stand.bench.heard(STATE))
    stand.bench.wait(S)
    for _ in range(5):
        assert 0 < stand.node.step(stand.bench.now_ns) - stand.bench.now_ns <= 40 * MS
    assert len(stand.bench.heard(STATE)) == before + 1
    assert stand.node.step(stand.bench.now_ns - S) <= stand.bench.now_ns - S + 40 * MS, "a clock that went back"
