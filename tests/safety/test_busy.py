"""A busy machine: what is late by its load, and what a fleet that is only simulated does then, and never does."""

from itertools import pairwise, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety import busy, supervisor
from robofleet.safety.busy import CONTROLLER, DRIVERS, SUPERVISOR, TRACKER, BusyState, Lateness
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import MOVING, Event, Happening, Phase, RunStatus
from robofleet.safety.view import NEVER, FleetView, Machine, RobotView, Turns

MS = 1_000_000
S = 1000 * MS
NOW = 1000 * S
RUNNING = RunStatus(Phase.RUNNING, Event.PROVED)
LOAD_MAKES = {  # said here once more: what lateness can do to a fleet that drives
    Event.SUPERVISOR_STALLED, Event.DRIVER_SILENT, Event.CONTROLLER_SILENT, Event.TICKS_OVERRUN, Event.TRACKER_SILENT,
    Event.CAMERA_STALLED, Event.POSES_SILENT, Event.BEHAVIOUR_LATE,
}  # fmt: skip
LOAD_SPOILS = LOAD_MAKES | {  # ... and to its checks; not what wires, wheels and hands do
    Event.TAG_LOST, Event.LEASE_LOST, Event.GATE_LATCHED, Event.NOT_AT_REST, Event.ESTOP_UNANSWERED,
    Event.DID_NOT_MOVE, Event.WRONG_GAIN, Event.ARMED_TOO_LONG,
}  # fmt: skip


def seen(now_ns: int = NOW, contended_ns: int = 0, **robot: object) -> FleetView:
    """Return a view in which all is well; ``robot``: fields of the first of two robots."""
    well = RobotView(heard_ns=now_ns, session=5, seen_ns=now_ns)
    return FleetView(
        now_ns, (well._replace(**robot), well), controller_ns=now_ns, tracker_ns=now_ns,
        machine=Machine(contended_ns, 6.1, 2),
    )  # fmt: skip


def late(ago_ns: int = 0) -> BusyState:
    """Return the memory of a run in which the tracker was late by load some time ago."""
    memory = BusyState(recent=(Lateness(TRACKER, 310 * MS),), recent_ns=NOW - ago_ns, checks_ns=NOW - 5 * S)
    return memory._replace(last_heard=((NOW, 0),) * 5)


def watched(after_ns: int, contended_ns: int, silent: str = "", phase: Phase = Phase.RUNNING) -> dict[int, int]:
    """Return who is late after looks every 40 ms, of which ``silent`` was not heard in the last ones."""
    memory = busy.watch(BusyState(), phase, seen(contended_ns=S))
    for at_ns in range(40 * MS, after_ns + 1, 40 * MS):
        view = seen(NOW + at_ns, S + contended_ns * at_ns // after_ns)
        if silent == "driver":
            view = view._replace(robots=(view.robots[0]._replace(heard_ns=NOW), view.robots[1]))
        elif silent:
            view = view._replace(**{silent: NOW})
        memory = busy.watch(memory, phase, view)
    return dict(memory.recent)


@pytest.mark.parametrize(
    ("silent", "row"), [("controller_ns", CONTROLLER), ("tracker_ns", TRACKER), ("driver", DRIVERS)]
)
def test_who_is_silent_while_no_core_is_free_is_late_by_load(silent: str, row: int) -> None:
    assert watched(400 * MS, 400 * MS, silent) == {row: 360 * MS}
    assert watched(400 * MS, 200 * MS, silent) == {row: 360 * MS}  # half of the time
    assert watched(400 * MS, 199 * MS, silent) == {}  # less: somebody stopped it, or it hangs
    assert watched(80 * MS, 80 * MS, silent) == {}  # not long enough for a gate to notice
    assert watched(120 * MS, 120 * MS, silent) == {row: 80 * MS}


@pytest.mark.parametrize(
    ("waited_ns", "taken", "tried"),
    [(200 * MS, 0, True), (200 * MS - 10, 0, False), (0, 8, True), (0, 7, False)],
)
def test_who_is_counted_is_late_by_load_only_if_it_waited_for_half_of_the_time_or_ran_every_50_ms(
    waited_ns: int, taken: int, tried: bool
) -> None:
    memory = BusyState()
    for k in range(-5, 11):
        since_silent = (
            Turns(7 * S + waited_ns * k // 10, 900 + taken * k // 10) if k > 0 else Turns(7 * S * (k == 0), 900)
        )
        machine = Machine(S + 40 * MS * k, 6.1, 2, (Turns(S, 1), Turns(S, 1), since_silent, None, Turns(S, 1)))
        view = seen(NOW + 40 * MS * k)._replace(machine=machine, tracker_ns=NOW + min(0, 40 * MS * k))
        memory = busy.watch(memory, Phase.RUNNING, view)
    assert memory.unexplained == (frozenset() if tried else {TRACKER})
    assert memory.recent == ((Lateness(TRACKER, 360 * MS),) if tried else ())


def test_who_is_not_counted_is_believed_to_have_tried() -> None:
    hung = Turns(7 * S, 900)
    assert busy.tries(None, hung, S)
    assert busy.tries(hung, None, S)
    assert not busy.tries(hung, hung, S)


@pytest.mark.parametrize("phase", Phase)
def test_nobody_is_late_while_processes_start_and_end(phase: Phase) -> None:
    active = phase in (Phase.ARMED, Phase.HOLD, *MOVING)
    assert bool(watched(400 * MS, 400 * MS, "tracker_ns", phase)) is active


def test_the_supervisors_own_lateness_is_nobody_elses() -> None:
    memory = busy.watch(BusyState(), Phase.RUNNING, seen())
    stalled = seen(NOW + 700 * MS, 600 * MS)._replace(tracker_ns=NOW)  # what came in between is heard in this look
    memory = busy.watch(memory, Phase.RUNNING, stalled)
    assert memory.recent == (Lateness(SUPERVISOR, 660 * MS),)
    assert (memory.recent_ns, memory.worst) == (NOW + 700 * MS, memory.recent)


def test_without_a_measured_machine_and_before_the_first_word_nobody_is_late() -> None:
    blind = seen(NOW + S)._replace(machine=None)
    assert busy.watch(BusyState(), Phase.RUNNING, blind) == BusyState()
    memory = busy.watch(BusyState(), Phase.RUNNING, seen()._replace(tracker_ns=0))
    memory = busy.watch(memory, Phase.RUNNING, seen(NOW + 40 * MS, S)._replace(tracker_ns=0))
    assert memory.recent == ()


def test_the_most_of_each_stays_and_the_newest_is_told() -> None:
    memory = busy.watch(BusyState(), Phase.RUNNING, seen())
    for at_ms, contended_ms in ((440, 400), (540, 500), (580, 500)):
        memory = busy.watch(memory, Phase.RUNNING, seen(NOW + at_ms * MS, contended_ms * MS))
    assert memory.recent == (Lateness(SUPERVISOR, 60 * MS),)
    assert memory.recent_ns == NOW + 540 * MS
    assert memory.worst == (Lateness(SUPERVISOR, 400 * MS),)


def test_every_cell() -> None:
    for phase, event in product(Phase, Event):
        assert_cell(phase, event)


def assert_cell(phase: Phase, event: Event) -> None:
    status, happening = RunStatus(phase, Event.NOTHING, 1, 0.5), Happening(event, 0, 1.0)
    table = supervisor.step(status, happening)
    assert busy.step(late(), status, happening, NOW, simulated=False) == (late(), table)  # robots that exist: as it is
    assert busy.step(late(S + 1), status, happening, NOW, simulated=True)[1] == (
        table if phase is not Phase.ARMED or event not in LOAD_SPOILS else status
    )
    memory, after = busy.step(late()._replace(fresh_ns=NOW - S), status, happening, NOW, simulated=True)
    if phase in MOVING and event in LOAD_MAKES:
        assert after == RunStatus(Phase.HOLD, event, 0, 1.0, phase)
        assert (memory.held_ns, memory.fresh_ns) == (NOW, NEVER)
    elif phase is Phase.HOLD and event in LOAD_MAKES:
        assert after is status
    elif phase is Phase.ARMED and event in LOAD_SPOILS and table is not status:
        assert after is status
        assert (memory.checks_ns, memory.attempts) == (NOW, 1)
    else:
        assert after == table
        assert memory.held_ns == 0


@pytest.mark.parametrize("event", sorted(LOAD_MAKES))
def test_without_anybody_late_everything_stops_as_it_does(event: Event) -> None:
    happening = Happening(event, 0)
    for memory in (BusyState(), late(S + 1)):
        stopped, after = busy.step(memory, RUNNING, happening, NOW, simulated=True)
        assert after == supervisor.step(RUNNING, happening)
        assert settled(stopped, after, 100) == []


def test_lateness_explains_what_happens_within_a_second() -> None:
    assert busy.explains(late(S), Event.TRACKER_SILENT, 0, NOW)
    assert not busy.explains(late(S + 1), Event.TRACKER_SILENT, 0, NOW)


@pytest.mark.parametrize(
    ("event", "row"),
    [
        (Event.SUPERVISOR_STALLED, SUPERVISOR), (Event.CONTROLLER_SILENT, CONTROLLER), (Event.TRACKER_SILENT, TRACKER),
        (Event.CAMERA_STALLED, TRACKER), (Event.POSES_SILENT, TRACKER), (Event.DRIVER_SILENT, DRIVERS + 1),
    ],
)  # fmt: skip
def test_lateness_does_not_explain_the_silence_of_a_process_that_hangs(event: Event, row: int) -> None:
    armed, happening = RunStatus(Phase.ARMED, Event.START_REQUESTED), Happening(event, 1)
    for hangs in range(DRIVERS + 2):
        memory = late()._replace(unexplained=frozenset({hangs}))
        assert busy.explains(memory, event, 1, NOW) is (hangs != row)
        _, after = busy.step(memory, armed, happening, NOW, simulated=True)
        assert after == (armed if hangs != row else supervisor.step(armed, happening))


def test_before_any_process_was_heard_none_is_gone_for_good() -> None:
    unheard = late()._replace(last_heard=())
    assert busy.step(unheard, RUNNING, Happening(Event.SUPERVISOR_STALLED), NOW, simulated=True)[1].phase is Phase.HOLD


def test_a_start_counts_its_checks_anew_and_what_follows_keeps_the_count() -> None:
    memory, status = held()._replace(attempts=3), RunStatus(Phase.IDLE, Event.NOTHING)
    memory, status = busy.step(memory, status, Happening(Event.START_REQUESTED), NOW, simulated=True)
    assert status.phase is Phase.ARMED
    assert (memory.held_ns, memory.checks_ns, memory.attempts) == (NEVER, NOW, 0)
    memory, status = busy.step(memory._replace(attempts=2), status, Happening(Event.PROVED), NOW + S, simulated=True)
    assert status.phase in MOVING
    assert (memory.checks_ns, memory.attempts) == (NOW + S, 2)


def test_a_process_that_does_not_come_back_ends_the_run() -> None:
    held = RunStatus(Phase.HOLD, Event.DRIVER_SILENT, 1)
    for ago_ns, phase in ((10 * S, Phase.HOLD), (10 * S + 1, Phase.FAULT)):
        memory = late()._replace(last_heard=((NOW, 0), (NOW, 0), (NOW, 0), (NOW, 0), (NOW - ago_ns, 0)))
        assert busy.step(memory, held, Happening(Event.DRIVER_SILENT, 1), NOW, simulated=True)[1].phase is phase


def test_checks_that_load_spoils_begin_anew_five_times_and_what_lasts_counts_once() -> None:
    armed, happening = RunStatus(Phase.ARMED, Event.START_REQUESTED), Happening(Event.WRONG_GAIN, 0, 1.4)
    memory = late()
    for attempt in range(1, busy.ATTEMPTS + 1):
        now_ns = NOW + attempt * 3 * S
        memory, after = busy.step(memory._replace(recent_ns=now_ns), armed, happening, now_ns, simulated=True)
        assert (after, memory.attempts, memory.checks_ns) == (armed, attempt, now_ns)
        memory, after = busy.step(  # the next look
            memory._replace(recent_ns=now_ns + 40 * MS), armed, happening, now_ns + 40 * MS, simulated=attempt < 5
        )
        assert memory.attempts == attempt
    now_ns += 3 * S
    _, after = busy.step(memory._replace(recent_ns=now_ns), armed, happening, now_ns, simulated=True)
    assert after.phase is Phase.FAULT


def test_checks_that_began_anew_five_times_refuse_the_start_also_by_a_process_that_was_late() -> None:
    armed, memory = RunStatus(Phase.ARMED, Event.START_REQUESTED), late()._replace(attempts=busy.ATTEMPTS)
    _, after = busy.step(memory, armed, Happening(Event.DRIVER_SILENT, 0), NOW, simulated=True)
    assert after.phase is Phase.FAULT


def test_what_spoils_the_checks_for_a_second_counts_once_more() -> None:
    armed, happening = RunStatus(Phase.ARMED, Event.START_REQUESTED), Happening(Event.WRONG_GAIN, 0, 1.4)
    for apart_ns, attempts in ((S - 1, 0), (S, 1)):
        memory = late()._replace(checks_ns=NOW - apart_ns)
        assert busy.step(memory, armed, happening, NOW, simulated=True)[0].attempts == attempts


def test_several_that_are_silent_in_one_look_begin_the_checks_anew_once() -> None:
    memory, armed = late(), RunStatus(Phase.ARMED, Event.START_REQUESTED)
    for row in range(2):
        memory, after = busy.step(memory, armed, Happening(Event.DRIVER_SILENT, row), NOW, simulated=True)
        assert (after, memory.attempts) == (armed, 1)


def test_checks_in_which_nobody_was_late_and_what_load_cannot_do_refuse_the_start() -> None:
    armed = RunStatus(Phase.ARMED, Event.START_REQUESTED)
    before, at_once = late(1)._replace(checks_ns=NOW), late(1)._replace(checks_ns=NOW - 1)
    grave = Happening(Event.GATE_LATCHED, 0, float(Latch.ROBOT_FAULT))
    wrong = Happening(Event.WRONG_GAIN, 0)
    for memory, happening in ((before, wrong), (at_once, wrong), (late(), grave)):
        assert busy.step(memory, armed, happening, NOW, simulated=True)[1].phase is Phase.FAULT


def settled(memory: BusyState, status: RunStatus, duration_s: int, **robot: object) -> list[float]:
    """Return when a run that is held goes on [s], with a view every 40 ms in which all is well, but ``robot``."""
    for k in range(1, duration_s * 25):
        view = seen(NOW + k * 40 * MS, **{"seen_ns": NOW + k * 40 * MS, "heard_ns": NOW + k * 40 * MS, **robot})
        memory, happening = busy.go_on(memory, status, view, ())
        if happening is not None:
            assert happening.event is Event.CAUGHT_UP
            return [k * 0.04]
    return []


HELD = RunStatus(Phase.HOLD, Event.TRACKER_SILENT)


def held(*goes_on_s: float) -> BusyState:
    return late()._replace(held_ns=NOW, goes_on_ns=tuple(NOW - round(ago_s * S) for ago_s in goes_on_s))


@pytest.mark.parametrize(
    ("goes_on_s", "after_s"),
    [
        ((), 0.52),
        ((1,), 1.0),
        ((2, 1), 2.0),
        ((50,) * 3, 4.0),
        ((50,) * 4, 8.0),
        ((10,) * 9, 8.0),
        ((61,) * 9, 0.52),
        ((59.48,), 0.52),
    ],
)
def test_the_more_often_it_was_held_the_longer_it_waits(goes_on_s: tuple[float, ...], after_s: float) -> None:
    assert settled(held(*goes_on_s), HELD, 20) == [pytest.approx(after_s)]


@pytest.mark.parametrize(
    "robot",
    [
        {"heard_ns": NOW - S}, {"seen_ns": NOW - S}, {"unseen_ns": 150 * MS}, {"session": 0}, {"session": 6},
        {"latch": Latch.RUNAWAY}, {"left_speed": 0.1}, {"right_output": -0.1},
    ],
)  # fmt: skip
def test_it_stays_held_until_everybody_is_heard_seen_ours_and_at_rest(robot: dict[str, object]) -> None:
    assert settled(held(), HELD, 30, **robot) == []


def test_all_must_be_well_for_300_ms() -> None:
    for well_ns, event in ((300 * MS - 1, None), (300 * MS, Event.CAUGHT_UP)):
        memory = held()._replace(held_ns=NOW - S, fresh_ns=NOW - well_ns)
        _, happening = busy.go_on(memory, HELD, seen(), ())
        assert (happening and happening.event) is event


def test_all_must_be_well_for_a_while() -> None:
    memory, began = held(), []
    for k in range(1, 100):
        view = seen(NOW + k * 40 * MS)
        view = view._replace(tracker_ns=0) if k == 30 else view
        memory, happening = busy.go_on(memory._replace(held_ns=NOW - 60 * S), HELD, view, ())
        began += [k] * (happening is not None)
        memory = memory._replace(goes_on_ns=())
    gaps = [after - before for before, after in pairwise(began)]
    assert began[0] == 9  # 8 steps of 40 ms after the first one
    assert set(gaps) == {1, 10}  # a look in which somebody was missing, then as at first


@pytest.mark.parametrize("event", sorted(set(Event) - LOAD_MAKES - {Event.TAG_LATE, Event.TAG_LOST}))
def test_whatever_else_would_stop_a_run_keeps_it_held(event: Event) -> None:
    memory, after = busy.step(held(), HELD, Happening(event, 0, 1.0), NOW, simulated=True)
    would_stop = supervisor.step(RUNNING, Happening(event, 0, 1.0)).phase is not Phase.RUNNING
    if would_stop:  # by hand, too close, outside, an emergency stop, an operator's hold
        assert settled(memory, after, 100) == []
    elif after.phase is Phase.HOLD:
        assert settled(memory, after, 100) != []


def test_a_tag_that_is_still_lost_is_waited_for() -> None:
    lost = Happening(Event.TAG_LOST, 0)
    memory, after = busy.step(held(), HELD, lost, NOW, simulated=True)
    assert after is HELD
    for k in range(100):
        memory, happening = busy.go_on(memory, HELD, seen(NOW + k * 40 * MS), (lost,))
        assert happening is None
    assert settled(memory, HELD, 10) != []


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=60))
def test_it_goes_on_at_most_ten_times_a_minute_however_late_who_is(runs: list[int]) -> None:
    memory, status, went_on, left = BusyState(checks_ns=NOW), RUNNING, [], iter(runs * 50)
    drives = next(left)
    for k in range(25 * 180):
        now_ns = NOW + k * 40 * MS
        memory = memory._replace(recent=(Lateness(TRACKER, S),), recent_ns=now_ns, last_heard=((now_ns, 0),) * 5)
        if status.phase is Phase.RUNNING and drives == 0:
            memory, status = busy.step(memory, status, Happening(Event.TRACKER_SILENT), now_ns, simulated=True)
            drives = next(left)
        drives -= status.phase is Phase.RUNNING
        memory, happening = busy.go_on(memory, status, seen(now_ns), ())
        if happening is not None:
            memory, status = busy.step(memory, status, happening, now_ns, simulated=True)
            went_on.append(now_ns)
    assert memory.resumed == len(went_on) > 0
    assert all(b - a > 60 * S for a, b in zip(went_on, went_on[10:], strict=False))


def test_words() -> None:
    robots = ("r1", "r2")
    lateness = [Lateness(TRACKER, 310 * MS), Lateness(DRIVERS + 1, 120 * MS), Lateness(SUPERVISOR, 70 * MS)]
    assert busy.words(lateness, 6.13, 2, robots) == (
        "load 6.1 on 2 cores, the tracker was late by 310 ms, the driver of r2 was late by 120 ms, "
        "the supervisor was late by 70 ms"
    )
    assert busy.words([*lateness, Lateness(CONTROLLER, 1)], 1.0, 1, robots).startswith("load 1.0 on 1 core, ")
    assert "controller" not in busy.words([*lateness, Lateness(CONTROLLER, 1)], 1.0, 1, robots)  # three are enough
    names = [
        "the supervisor",
        "the controller",
        "the tracker",
        "the driver of r1",
        "the driver of r2",
        "another driver",
    ]
    assert [busy.name([process], robots) for process in range(DRIVERS + 3)] == names


def test_the_driver_process_of_several_robots_is_late_once() -> None:
    robots = tuple(f"r{k}" for k in range(1, 9))
    late = [*(Lateness(DRIVERS + row, 120 * MS) for row in range(3)), Lateness(DRIVERS + 3, 90 * MS)]
    assert busy.words(late, 6.0, 2, robots).endswith(
        ", the driver of r1, r2, r3 was late by 120 ms, the driver of r4 was late by 90 ms"
    )
    every = [Lateness(DRIVERS + row, 120 * MS) for row in range(8)]
    assert busy.words(every, 6.0, 2, robots).endswith(", the driver of r1, r2, r3 and 5 more was late by 120 ms")


def test_the_latest_process_is_named_first() -> None:
    late_ = [Lateness(TRACKER, 70 * MS), Lateness(DRIVERS, 310 * MS), Lateness(CONTROLLER, 120 * MS)]
    assert [process for process, _ in busy.latest(late_)] == [DRIVERS, CONTROLLER, TRACKER]
