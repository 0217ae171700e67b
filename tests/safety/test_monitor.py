"""What the supervisor makes of what it sees: each threshold from both sides, and what must raise nothing."""

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import Any

import pytest

from robofleet.safety import monitor
from robofleet.safety.latches import Latch
from robofleet.safety.monitor import SILENT_NS, MonitorSettings, MonitorState
from robofleet.safety.supervisor import MOVING, NOBODY, Event, Happening, Phase
from robofleet.safety.view import NEVER, FleetView, RobotView
from robofleet.vehicles.interface import WIRED_STOP, RobotFault
from robofleet.vehicles.solids import Solid

MS = 1_000_000
S = 1000 * MS
NOW = 1000 * S
BUILD, SESSION = 77, 5
SETTINGS = MonitorSettings(
    build=BUILD,
    body_radius=(0.05, 0.06, 0.05),
    wheel_radius=(0.016,) * 3,
    wheel_base=(0.105,) * 3,
    arena=(3.0, 2.0),
    max_speed=(0.5, 0.5, 0.5),
    attended=True,
    stale_ticks=15,
)
UNATTENDED = replace(SETTINGS, attended=False)
ACTIVE = (Phase.ARMED, Phase.RUNNING, Phase.HOLD)

Change = Callable[[FleetView], FleetView]


def healthy(now_ns: int = NOW) -> FleetView:
    robots = tuple(
        RobotView(
            heard_ns=now_ns, build=BUILD, session=SESSION, boot_id=10 + row, battery=0.9, seen_ns=now_ns,
            image=30, pose=(0.5 * row - 0.5, 0.0, 1.0),
        )
        for row in range(3)
    )  # fmt: skip
    return FleetView(
        now_ns, robots, controller_ns=now_ns, controller_epoch=3, controller_build=BUILD, tick=600, overruns=7,
        tracker_ns=now_ns, tracker_epoch=4, tracker_build=BUILD, image=30, image_tick=599, operator_ns=now_ns,
    )  # fmt: skip


def fleet(**changes: Any) -> Change:
    return lambda view: view._replace(**changes)


def robot(row: int, **changes: Any) -> Change:
    return lambda view: view._replace(
        robots=tuple(r._replace(**changes) if k == row else r for k, r in enumerate(view.robots))
    )


def all_of(*changes: Change) -> Change:
    return lambda view: reduce(lambda changed, change: change(changed), changes, view)


def only_first(view: FleetView) -> FleetView:
    return view._replace(robots=view.robots[:1])


def told(
    change: Change,
    phase: Phase = Phase.RUNNING,
    *,
    before: Change = lambda view: view,
    settings: MonitorSettings = SETTINGS,
) -> list[Happening]:
    """Return what is told of a view that was changed, 40 ms after a healthy one."""
    memory, _ = monitor.watch(MonitorState(), settings, phase, before(healthy(NOW - 40 * MS)))
    return list(monitor.watch(memory, settings, phase, change(healthy()))[1])


def follow(views: list[FleetView], phase: Phase) -> list[list[Happening]]:
    """Return what is told of each view in turn."""
    memory, all_told = MonitorState(), []
    for view in views:
        memory, happenings = monitor.watch(memory, SETTINGS, phase, view)
        all_told.append(list(happenings))
    return all_told


AGO = {
    name: NOW - ns for name, ns in {"500": 500 * MS, "501": 500 * MS + 1, "250": 250 * MS, "251": 250 * MS + 1}.items()
}

NAMED = [fault for fault in RobotFault if fault not in (RobotFault.WIRED_STOP, RobotFault.OWN)]

# Just not, just so, and what is told then.
STANDING: list[tuple[Change, Change, Happening]] = [
    (robot(1, heard_ns=AGO["500"]), robot(1, heard_ns=AGO["501"]), Happening(Event.DRIVER_SILENT, 1)),
    (robot(1, heard_ns=NEVER, build=0), robot(1, build=BUILD + 1), Happening(Event.OTHER_BUILD, 1)),
    (robot(2, latch=0), robot(2, latch=Latch.DRIVER_FAILED), Happening(Event.GATE_LATCHED, 2, 4)),
    (robot(2, faults=0), robot(2, faults=WIRED_STOP), Happening(Event.WIRED_STOP, 2)),
    (robot(2, latch=0), robot(2, latch=Latch.RUNAWAY), Happening(Event.RUNAWAY, 2)),
    (robot(2, latch=0), robot(2, latch=Latch.WIRED_STOP), Happening(Event.WIRED_STOP, 2)),
    (robot(2, faults=0), robot(2, faults=5 << 16), Happening(Event.ROBOT_FAULT, 2, 5 << 16)),
    *((robot(2, faults=0), robot(2, faults=fault), Happening(Event[fault.name], 2)) for fault in NAMED),
    (robot(0, battery=0.10), robot(0, battery=0.0999), Happening(Event.BATTERY_LOW, 0, 0.0999)),
    (robot(0, battery=-1.0), robot(0, battery=0.0), Happening(Event.BATTERY_LOW, 0, 0.0)),
    (robot(0, unseen_ns=100 * MS - 1), robot(0, unseen_ns=100 * MS), Happening(Event.TAG_LATE, 0)),
    (robot(0, lost=False), robot(0, lost=True), Happening(Event.TAG_LATE, 0)),
    (robot(0, pose=(-1.45, 0.0, 0.0)), robot(0, pose=(-1.4501, 0.0, 0.0)), Happening(Event.OUTSIDE_ARENA, 0)),
    (robot(1, pose=(0.0, 0.94, 0.0)), robot(1, pose=(0.0, 0.9401, 0.0)), Happening(Event.OUTSIDE_ARENA, 1)),
    (robot(1, pose=(0.3849, 0.0, 0.0)), robot(1, pose=(0.3851, 0.0, 0.0)), Happening(Event.TOO_CLOSE, 1, 2)),
    (robot(0, pose=(0.0, 0.1151, 0.0)), robot(0, pose=(0.0, 0.1149, 0.0)), Happening(Event.TOO_CLOSE, 0, 1)),
    (fleet(controller_ns=AGO["500"]), fleet(controller_ns=AGO["501"]), Happening(Event.CONTROLLER_SILENT)),
    (fleet(controller_build=BUILD), fleet(controller_build=BUILD + 1), Happening(Event.OTHER_BUILD)),
    (fleet(tracker_ns=AGO["250"]), fleet(tracker_ns=AGO["251"]), Happening(Event.TRACKER_SILENT)),
    (fleet(image_tick=585), fleet(image_tick=584), Happening(Event.TRACKER_SILENT)),
    (fleet(image_tick=0), fleet(image_tick=1), Happening(Event.TRACKER_SILENT)),
    (fleet(tracker_build=BUILD), fleet(tracker_build=BUILD + 1), Happening(Event.OTHER_BUILD)),
    (fleet(free_bytes=200_000_000), fleet(free_bytes=199_999_999), Happening(Event.DISK_FULL)),
    (fleet(operator_ns=NOW - S), fleet(operator_ns=NOW - S - 1), Happening(Event.OPERATOR_LOST)),
]  # fmt: skip


@pytest.mark.parametrize("phase", ACTIVE)
@pytest.mark.parametrize(("quiet", "loud", "happening"), STANDING)
def test_what_stands_is_told_beyond_its_threshold_and_not_before(
    quiet: Change, loud: Change, happening: Happening, phase: Phase
) -> None:
    if (phase, happening.event) == (Phase.ARMED, Event.TRACKER_SILENT):
        assert told(loud, phase, before=quiet) == [], "the checks have a patience of their own"
        return
    assert told(quiet, phase, before=quiet) == []
    assert told(loud, phase, before=quiet) == [happening]
    assert told(loud, phase, before=loud) == [happening], "it is told as long as it stands"


@pytest.mark.parametrize("phase", Phase)
def test_nothing_is_told_of_a_healthy_fleet(phase: Phase) -> None:
    assert follow([healthy(NOW + k * 40 * MS) for k in range(100)], phase) == [[]] * 100


def test_a_tag_that_is_unseen_for_two_seconds_is_lost_and_no_longer_late() -> None:
    assert told(robot(1, unseen_ns=2 * S - 1)) == [Happening(Event.TAG_LATE, 1)]
    assert told(robot(1, unseen_ns=2 * S, lost=True)) == [Happening(Event.TAG_LOST, 1)]


def test_a_robot_that_only_a_camera_sees_that_is_out_is_not_lost() -> None:
    assert told(robot(1, unseen_ns=2 * S - 1, camera_out=4)) == [Happening(Event.TAG_LATE, 1)]
    assert told(robot(1, unseen_ns=2 * S, camera_out=4)) == [Happening(Event.CAMERA_OUT, 1, 3)]


@pytest.mark.parametrize(("x_m", "outside"), [(-0.05, False), (-0.0499, True), (0.7, True)])
def test_a_robot_off_a_floor_that_is_a_polygon_is_outside(x_m: float, outside: bool) -> None:
    corners = ((-1.5, -1.0), (1.5, -1.0), (1.5, 0.3), (0.0, 0.3), (0.0, 1.0), (-1.5, 1.0))
    settings, placed = replace(SETTINGS, floors=(Solid("floor", corners, floor=True),)), robot(0, pose=(x_m, 0.6, 0.0))
    assert told(placed, before=placed, settings=settings) == [Happening(Event.OUTSIDE_ARENA, 0)] * outside


def test_a_robot_is_not_outside_where_it_was_seen_long_ago() -> None:
    late = robot(2, pose=(1.6, 0.0, 0.0), unseen_ns=100 * MS)
    fresh = robot(2, pose=(1.6, 0.0, 0.0), unseen_ns=100 * MS - 1)
    assert told(late, before=late) == [Happening(Event.TAG_LATE, 2)]
    assert told(fresh, before=late) == [Happening(Event.OUTSIDE_ARENA, 2)]


def test_nothing_is_told_of_what_was_never_there() -> None:
    """The checks before a start wait for it; a robot of which nothing is known is nowhere."""
    nobody = FleetView(NOW, (RobotView(), RobotView(), RobotView()))
    assert (
        follow([nobody, nobody._replace(now_ns=NOW + 40 * MS)], Phase.ARMED) == [[Happening(Event.OPERATOR_LOST)]] * 2
    )
    only_unseen = robot(1, seen_ns=NEVER, pose=(9.0, 0.0, 0.0), unseen_ns=3 * S, lost=True)
    assert told(only_unseen, before=only_unseen) == []
    on_top = robot(1, seen_ns=NEVER, pose=(0.5, 0.0, 0.0))
    assert told(on_top, before=on_top) == []


@pytest.mark.parametrize("y", [-0.8, 0.0, 0.8])
def test_two_are_too_close_wherever_they_are(y: float) -> None:
    def pair(gap_m: float) -> Change:
        return all_of(robot(1, pose=(gap_m - 1.0, y, 0.0)), robot(0, pose=(-1.0, y, 0.0)))

    far, close = pair(0.115 + 5e-10), pair(0.115 - 5e-10)
    assert told(far, before=far) == []
    assert told(close, before=close) == [Happening(Event.TOO_CLOSE, 0, 1)]


def test_two_that_are_just_as_far_apart_as_they_must_be_are_not_too_close() -> None:
    points = replace(SETTINGS, body_radius=(0.0, 0.0, 0.0))

    apart = all_of(robot(2, pose=(0.0, 0.0, 0.0)), robot(1, pose=(0.005, 0.0, 0.0)))
    assert told(apart, before=apart, settings=points) == []


def test_a_robot_that_is_not_seen_still_stands_in_the_way() -> None:
    standing = robot(1, pose=(0.45, 0.0, 0.0), unseen_ns=S)
    assert told(standing, before=standing) == [
        Happening(Event.TAG_LATE, 1),
        Happening(Event.TOO_CLOSE, 1, 2),
    ]


@pytest.mark.parametrize("phase", ACTIVE)
@pytest.mark.parametrize(
    ("change", "happening"),
    [
        (robot(2, boot_id=99), Happening(Event.DRIVER_RESTARTED, 2)),
        (fleet(controller_epoch=99), Happening(Event.CONTROLLER_RESTARTED)),
        (fleet(tracker_epoch=99), Happening(Event.TRACKER_RESTARTED)),
        (fleet(news=(Happening(Event.POSE_JUMPED, 1, 0.3),)), Happening(Event.POSE_JUMPED, 1, 0.3)),
    ],
)
def test_a_change_is_told_once(change: Change, happening: Happening, phase: Phase) -> None:
    views = [healthy(NOW), change(healthy(NOW + 40 * MS)), change(healthy(NOW + 80 * MS))._replace(news=())]
    assert follow(views, phase) == [[], [happening], []]


@pytest.mark.parametrize("way", [(1.0, 0.0), (0.0, 1.0), (-0.6, 0.8)])
def test_a_robot_that_is_seen_where_it_cannot_have_driven_was_moved(way: tuple[float, float]) -> None:
    def moved(by_m: float, seen_again_ns: int) -> list[list[Happening]]:
        """Robot 1 has a body of 60 mm and drives 0.5 m/s."""
        body = robot(1, pose=(by_m * way[0], by_m * way[1], 0.0))
        later = healthy(NOW + seen_again_ns)
        return follow([healthy(NOW), body(later), body(healthy(NOW + seen_again_ns + 40 * MS))], Phase.RUNNING)

    assert moved(0.0799, 40 * MS) == [[], [], []]
    quiet, jump, after = moved(0.0801, 40 * MS)
    assert (quiet, after) == ([], [])
    assert [(h.event, h.robot) for h in jump] == [(Event.POSE_JUMPED, 1)]
    assert jump[0].detail == pytest.approx(0.0801)
    assert moved(0.259, 400 * MS) == [[], [], []], "it had the time"


def test_a_jump_as_far_as_a_body_is_none() -> None:
    exact = replace(SETTINGS, body_radius=(0.05, 0.0625, 0.05))
    shown_again = robot(1, pose=(0.0625, 0.0, 0.0), seen_ns=NOW - 40 * MS)
    assert told(shown_again, settings=exact) == []


def test_a_robot_that_is_seen_first_has_not_jumped() -> None:
    """Also where the clock began just now."""
    unseen = robot(0, seen_ns=NEVER, pose=(0.0, 0.0, 0.0))
    assert follow([unseen(healthy(S)), robot(0, pose=(-1.0, 0.5, 0.0))(healthy(S + 40 * MS))], Phase.RUNNING) == [
        [],
        [],
    ]


def test_a_first_start_is_no_restart() -> None:
    assert told(fleet(), before=robot(0, boot_id=0)) == []
    assert told(fleet(), before=fleet(controller_epoch=0, tracker_epoch=0)) == []


def test_three_ticks_overrun_in_a_row_are_told_while_the_fleet_drives() -> None:
    assert told(fleet(overruns=9)) == []
    assert told(fleet(overruns=10)) == [Happening(Event.TICKS_OVERRUN, NOBODY, 3)]
    for phase in set(Phase) - set(MOVING):
        assert told(fleet(overruns=10), phase) == []
    single = [healthy(NOW + 40 * k * MS)._replace(overruns=k) for k in range(20)]
    assert follow(single, Phase.RUNNING) == [[]] * 20, "one and one and one are not three in a row"


@pytest.mark.parametrize("session", [0, SESSION + 1])
def test_a_lease_that_another_controller_or_nobody_holds_is_lost_once_the_run_was_proved(session: int) -> None:
    given_up = robot(1, session=session)
    views = [healthy(NOW), *(given_up(healthy(NOW + k * 40 * MS)) for k in (1, 2))]
    for phase in (Phase.RUNNING, Phase.HOLD):
        lost = [Happening(Event.LEASE_LOST, 1)]
        assert follow(views, phase) == [[], lost, lost], "it stands"
    for phase in (Phase.IDLE, Phase.ARMED, Phase.FAULT, Phase.ESTOP):
        assert follow(views, phase) == [[], [], []], "the checks before a start look at leases themselves"


def test_a_computer_of_its_own_that_is_silent_or_starts_again_has_lost_its_link() -> None:
    """Its radio comes back, and the run goes on; another controller, or another configuration, is no link."""
    elsewhere = replace(SETTINGS, elsewhere=frozenset({1}))
    silent, restarted = {"heard_ns": NOW - SILENT_NS - 1}, {"boot_id": 99}
    for what in (silent, restarted, {"session": 0}):
        events = [
            [happening.event for happening in told(robot(row, **what), Phase.RUNNING, settings=elsewhere)]
            for row in (0, 1)
        ]
        assert events[0] != events[1] == [Event.LINK_LOST]
    for what in ({"session": SESSION + 1}, {"build": 99}):
        assert [told(robot(row, **what), Phase.RUNNING, settings=elsewhere)[0].event for row in (0, 1)] == [
            told(robot(0, **what), Phase.RUNNING)[0].event
        ] * 2


def test_the_lease_of_a_robot_that_drives_alone_is_lost_too() -> None:
    alone = replace(SETTINGS, body_radius=(0.05,), max_speed=(0.5,))
    taken = robot(0, session=SESSION + 1)
    lost = told(lambda view: only_first(taken(view)), before=only_first, settings=alone)
    assert lost == [Happening(Event.LEASE_LOST, 0)]


def test_all_leases_taken_at_once_are_lost_too() -> None:
    taken = all_of(*(robot(row, session=SESSION + 1) for row in range(3)))
    assert told(taken) == [Happening(Event.LEASE_LOST, row) for row in range(3)]


def test_a_lease_that_changed_between_two_runs_counts_from_the_second() -> None:
    memory, _ = monitor.watch(MonitorState(), SETTINGS, Phase.RUNNING, healthy(NOW))
    other = all_of(*(robot(row, session=9) for row in range(3)))(healthy(NOW + 40 * MS))
    memory, _ = monitor.watch(memory, SETTINGS, Phase.IDLE, other)
    assert monitor.watch(memory, SETTINGS, Phase.RUNNING, other._replace(now_ns=NOW + 80 * MS))[1] == ()


def test_a_drill_latches_gates_while_armed_and_at_no_other_time() -> None:
    drilled = robot(0, latch=Latch.DRILL)
    assert told(drilled, Phase.ARMED) == []
    for phase in set(Phase) - {Phase.ARMED}:
        assert told(drilled, phase) == [Happening(Event.GATE_LATCHED, 0, Latch.DRILL)]


def test_a_wired_stop_that_was_pressed_shortly_is_seen_by_its_latch_but_can_be_reset() -> None:
    pressed = robot(0, latch=Latch.WIRED_STOP)
    for phase in set(Phase) - {Phase.IDLE}:
        assert told(pressed, phase) == [Happening(Event.WIRED_STOP, 0)]
    assert told(pressed, Phase.IDLE) == [Happening(Event.GATE_LATCHED, 0, Latch.WIRED_STOP)]
    assert told(robot(0, faults=WIRED_STOP), Phase.IDLE) == [Happening(Event.WIRED_STOP, 0)]


@pytest.mark.parametrize("phase", list(Phase))
def test_an_emergency_stop_that_only_the_gates_know_of_ends_whatever_is_under_way(phase: Phase) -> None:
    under_way = phase not in (Phase.IDLE, Phase.ESTOP)
    event = Event.STOPPED_AT_GATE if under_way else Event.GATE_LATCHED
    assert told(robot(0, latch=Latch.EMERGENCY_STOP), phase) == [Happening(event, 0, Latch.EMERGENCY_STOP)]


def test_a_latch_of_another_version_is_a_latch() -> None:
    assert told(robot(0, latch=200)) == [Happening(Event.GATE_LATCHED, 0, 200)]


def test_a_robot_can_report_its_e_stop_and_a_fault_at_once() -> None:
    pressed, bumped = Happening(Event.WIRED_STOP, 0), Happening(Event.BUMPED, 0)
    assert told(robot(0, faults=WIRED_STOP | RobotFault.BUMPED)) == [pressed, bumped]


@pytest.mark.parametrize("phase", list(Phase))
def test_a_latch_that_a_fault_explains_is_no_news_of_its_own(phase: Phase) -> None:
    for latch in (Latch.ROBOT_FAULT, Latch.DRIVER_FAILED):
        assert told(robot(0, latch=latch, faults=RobotFault.CLIFF), phase) == [Happening(Event.CLIFF, 0)]
        assert told(robot(0, latch=latch), phase) == [Happening(Event.GATE_LATCHED, 0, latch)]


def test_a_robot_that_is_lost_is_lost_before_all_that_was_true_then() -> None:
    told_of = told(robot(0, faults=RobotFault.UNREACHABLE | RobotFault.BUMPED | RobotFault.OWN))
    assert [happening.event for happening in told_of] == [Event.UNREACHABLE, Event.BUMPED, Event.ROBOT_FAULT]


def test_a_filter_without_an_answer_is_told_after_half_a_second_of_driving() -> None:
    def told_at(infeasible_for_ms: int, phase: Phase, filtered: int = 2) -> list[Happening]:
        views = [robot(2, filtered=filtered)(healthy(NOW + k * 20 * MS)) for k in range(infeasible_for_ms // 20 + 1)]
        return follow(views, phase)[-1]

    assert told_at(480, Phase.RUNNING) == []
    assert told_at(500, Phase.RUNNING) == [Happening(Event.FILTER_INFEASIBLE, 2)]
    assert told_at(600, Phase.HOLD) == []
    assert told_at(600, Phase.RUNNING, filtered=1) == []


def test_a_filter_that_found_an_answer_in_between_is_given_its_time_again() -> None:
    stuck, free = robot(2, filtered=2), robot(2, filtered=1)
    views = [(free if k == 15 else stuck)(healthy(NOW + k * 20 * MS)) for k in range(40)]
    assert follow(views, Phase.RUNNING) == [[]] * 40
    assert follow([*views, stuck(healthy(NOW + 820 * MS))], Phase.RUNNING)[-1] == [
        Happening(Event.FILTER_INFEASIBLE, 2)
    ]


@pytest.mark.parametrize("wheel", ["left", "right"])
def test_a_wheel_that_is_much_too_slow_is_told_after_a_second(wheel: str) -> None:
    """Commanded 2 rad/s or more, and slower than five eighths of it, less 0.5; of a robot with encoders."""
    other = "right" if wheel == "left" else "left"

    def told_at(stalled_for_ms: int, output: float = -2.0, speed: float = 0.5, turned: float = 0.1) -> list[Happening]:
        standing = {f"{wheel}_output": output, f"{wheel}_speed": speed, f"{wheel}_angle": turned}
        turning = {f"{other}_output": 12.0, f"{other}_speed": 0.0 if turned == 0.0 else 12.0}
        views = [robot(2, **standing, **turning)(healthy(NOW + k * 20 * MS)) for k in range(stalled_for_ms // 20 + 1)]
        return follow(views, Phase.RUNNING)[-1]

    assert told_at(980) == []
    assert told_at(1000) == told_at(1100, speed=-0.75) == [Happening(Event.WHEEL_STALLED, 2)]
    assert told_at(1100, output=2.0) == told_at(1100, output=-12.0, speed=-7.0) == [Happening(Event.WHEEL_STALLED, 2)]
    assert told_at(1100, speed=-0.76) == told_at(1100, output=1.99) == told_at(1100, output=12.0, speed=7.01) == []
    assert told_at(1100, speed=0.0, turned=0.0) == [], "it counts nothing"


def test_robots_that_block_each_other_are_told_while_they_drive() -> None:
    assert told(robot(1, blocked=True)) == [Happening(Event.DEADLOCKED, 1)]
    assert told(robot(1, blocked=True), Phase.HOLD) == []


@pytest.mark.parametrize("phase", MOVING)
def test_a_behaviour_that_failed_is_told_with_its_robot_while_the_fleet_moves(phase: Phase) -> None:
    failed = robot(1, failed=int(Event.BEHAVIOUR_NOT_FINITE))
    assert told(failed, phase) == [Happening(Event.BEHAVIOUR_NOT_FINITE, 1)]
    assert told(failed, Phase.HOLD) == []


@pytest.mark.parametrize(
    ("phase", "event"),
    [
        (Phase.POSITIONING, Event.AT_START),
        (Phase.RUNNING, Event.ACCOMPLISHED),
        (Phase.PARKING, Event.PARKED),
    ],
)
def test_behaviours_that_have_done_all_end_their_own_phase_alone(phase: Phase, event: Event) -> None:
    assert told(fleet(arrived=int(phase)), phase) == [Happening(event)]
    for other in {*MOVING, Phase.HOLD} - {phase}:
        assert told(fleet(arrived=int(phase)), other) == []


@pytest.mark.parametrize("jump_ns", [500 * MS + 1, -500 * MS - 1])
def test_a_supervisor_that_stood_still_or_whose_clock_jumped_says_so_of_itself(jump_ns: int) -> None:
    views = [healthy(NOW), healthy(NOW + jump_ns), healthy(NOW + jump_ns + 40 * MS)]
    assert follow(views, Phase.RUNNING) == [[], [Happening(Event.SUPERVISOR_STALLED)], []]
    short = jump_ns - 1 if jump_ns > 0 else jump_ns + 1
    assert follow([healthy(NOW), healthy(NOW + short)], Phase.RUNNING) == [[], []]


@pytest.mark.parametrize(
    ("phase", "limit_ns", "event"),
    [
        (Phase.ARMED, 39 * S, Event.ARMED_TOO_LONG),
        (Phase.HOLD, 120 * S, Event.HELD_TOO_LONG),
        (Phase.POSITIONING, 300 * S, Event.UNDER_WAY_TOO_LONG),
        (Phase.PARKING, 300 * S, Event.UNDER_WAY_TOO_LONG),
    ],
)
def test_patience_ends(phase: Phase, limit_ns: int, event: Event) -> None:
    memory, _ = monitor.watch(MonitorState(), SETTINGS, Phase.RUNNING, healthy(NOW - 400 * MS))
    for ns in range(0, limit_ns + 1, 250 * MS):
        memory, happenings = monitor.watch(memory, SETTINGS, phase, healthy(NOW + ns))
        assert happenings == ()
    memory, happenings = monitor.watch(memory, SETTINGS, phase, healthy(NOW + limit_ns + 1))
    assert happenings == (Happening(event),)
    fresh, _ = monitor.watch(memory, SETTINGS, Phase.RUNNING, healthy(NOW + limit_ns + 2))
    assert monitor.watch(fresh, SETTINGS, phase, healthy(NOW + limit_ns + 3))[1] == (), "it begins anew"


def test_a_fleet_that_waits_for_its_start_has_passed_its_checks_and_needs_images_again() -> None:
    memory, silent_ns = MonitorState(), NOW + 600 * S
    for ns in range(0, 600 * S, 400 * MS):
        memory, happenings = monitor.watch(memory, SETTINGS, Phase.ARMED, healthy(NOW + ns), proved=True)
        assert happenings == ()
    blind = healthy(silent_ns)._replace(tracker_ns=silent_ns - 300 * MS)
    assert Happening(Event.TRACKER_SILENT) in monitor.watch(memory, SETTINGS, Phase.ARMED, blind, proved=True)[1]
    assert Happening(Event.TRACKER_SILENT) not in monitor.watch(memory, SETTINGS, Phase.ARMED, blind)[1]


def test_running_needs_no_patience() -> None:
    views = [healthy(NOW + k * 400 * MS) for k in range(400)]
    assert follow(views, Phase.RUNNING) == [[]] * 400


def test_an_operator_is_missed_only_where_one_must_attend() -> None:
    assert told(fleet(operator_ns=NEVER), settings=UNATTENDED) == []
    assert told(fleet(operator_ns=NEVER)) == [Happening(Event.OPERATOR_LOST)]


def test_everything_that_is_wrong_is_told_at_once() -> None:
    worse = all_of(robot(0, battery=0.01), robot(2, boot_id=1, latch=2), fleet(tracker_ns=NOW - S, free_bytes=0))
    assert {h.event for h in told(worse)} == {
        Event.BATTERY_LOW, Event.DRIVER_RESTARTED, Event.STOPPED_AT_GATE, Event.TRACKER_SILENT, Event.DISK_FULL,
    }  # fmt: skip


def test_a_runaways_latch_is_told_and_in_idle_only_while_the_wheel_turns() -> None:
    latched = robot(0, latch=Latch.RUNAWAY)
    turning = robot(0, latch=Latch.RUNAWAY, right_speed=-6.1)
    for phase in (Phase.ARMED, Phase.RUNNING, Phase.HOLD, Phase.FAULT, Phase.ESTOP):
        assert told(latched, phase) == [Happening(Event.RUNAWAY, 0)]
    for phase in Phase:
        assert told(turning, phase) == [Happening(Event.RUNAWAY, 0)]
    assert told(latched, Phase.IDLE) == [Happening(Event.GATE_LATCHED, 0, Latch.RUNAWAY)], "what a reset clears"
    assert told(robot(0, right_speed=-6.1), Phase.IDLE) == []


def rolled_on(phase: Phase, images: int, **changes: Any) -> list[Happening]:
    """Return what is told when robot 1 has rolled 10 mm in each of so many windows of 240 ms and one view."""
    memory, happenings = MonitorState(), []
    for k in range(images):
        now_ns = NOW + k * 250 * MS
        x = 0.01 * k
        view = robot(1, pose=(x * 0.5403023, x * 0.8414710, 1.0), **changes)(healthy(now_ns))
        memory, told_now = monitor.watch(memory, SETTINGS, phase, view)
        happenings.append([happening for happening in told_now if happening.event is Event.RUNAWAY])
    return happenings[-1]


@pytest.mark.parametrize("phase", list(Phase))
def test_a_robot_without_encoders_that_rolls_by_itself_is_told_in_every_phase(phase: Phase) -> None:
    assert rolled_on(phase, 4) == []
    assert rolled_on(phase, 5) == rolled_on(phase, 9) == [Happening(Event.RUNAWAY, 1)]
    assert rolled_on(phase, 9, left_angle=1.0) == [], "its encoders are judged, by its driver"


@pytest.mark.parametrize("phase", list(Phase))
def test_a_robot_without_encoders_that_stands_though_it_is_commanded_is_told_while_the_fleet_moves(
    phase: Phase,
) -> None:
    memory, happenings = MonitorState(), []
    for k in range(7):
        view = robot(1, left_output=6.0, left_told=6.0 * 0.25 * k)(healthy(NOW + k * 250 * MS))
        memory, told_now = monitor.watch(memory, SETTINGS, phase, view)
        happenings.append([happening for happening in told_now if happening.event is Event.WHEEL_STALLED])
    named = [Happening(Event.WHEEL_STALLED, 1)] if phase in MOVING else []
    assert happenings[:5] == [[]] * 5
    assert happenings[5:] == [named] * 2


def test_a_jump_without_bounds_is_told() -> None:
    far = robot(0, pose=(1.7e308, -1.7e308, 1.0))
    assert Happening(Event.POSE_JUMPED, 0, float("inf")) in told(far, before=robot(0, pose=(-1.7e308, 1.7e308, 1.0)))


PARKED = robot(2, driven=False)  # a bystander, 1 m from the first robot's place and 0.5 m from the second one's


def of_bystander(change: Change, phase: Phase = Phase.RUNNING) -> list[Happening]:
    """Return what is told of a view in which the third robot is nobody's."""
    return told(lambda view: change(PARKED(view)), phase, before=PARKED)


@pytest.mark.parametrize("phase", Phase)
def test_a_bystander_says_what_it_likes_of_itself(phase: Phase) -> None:
    """Its driver may be there or not, its battery empty, it may stand at its charger or outside the arena."""
    for change in (
        robot(2),
        robot(2, heard_ns=NEVER),
        robot(2, heard_ns=NOW - 10 * S),
        robot(2, boot_id=99),
        robot(2, build=BUILD + 1),
        robot(2, session=SESSION + 1),
        robot(2, battery=0.0),
        robot(2, faults=sum(NAMED)),
        robot(2, latch=Latch.EMERGENCY_STOP),
        robot(2, lost=True, filtered=2, blocked=True),
        robot(2, pose=(0.55, 0.04, 0.0)),
    ):
        assert of_bystander(change, phase) == []
    outside = robot(2, driven=False, pose=(1.6, 0.0, 0.0))
    assert told(outside, phase, before=outside) == []


@pytest.mark.parametrize("pressed", [{"faults": WIRED_STOP}, {"latch": Latch.WIRED_STOP}])
def test_a_bystanders_own_stop_is_one_as_everybodys(pressed: dict[str, int]) -> None:
    assert of_bystander(robot(2, **pressed)) == [Happening(Event.WIRED_STOP, 2)]


@pytest.mark.parametrize("phase", ACTIVE)
def test_a_bystander_that_is_not_seen_for_2_s_is_told(phase: Phase) -> None:
    assert of_bystander(robot(2, unseen_ns=2 * S - 1), phase) == []
    assert of_bystander(robot(2, unseen_ns=2 * S), phase) == [Happening(Event.BYSTANDER_LOST, 2)]


def test_a_bystander_that_is_carried_is_told_and_one_that_is_pushed_is_not() -> None:
    least = 0.05 + 0.5 * 0.04  # its body, and what it may go in 40 ms
    (jumped,) = of_bystander(robot(2, pose=(0.5 + least + 1e-6, 0.0, 1.0)))
    assert (jumped.event, jumped.robot, jumped.detail) == (Event.BYSTANDER_MOVED, 2, pytest.approx(least, abs=1e-5))
    assert of_bystander(robot(2, pose=(0.5 + least - 1e-6, 0.0, 1.0))) == []


def test_what_the_tracker_says_of_a_carried_bystander_ends_no_run() -> None:
    for row, event in ((1, Event.POSE_JUMPED), (2, Event.BYSTANDER_MOVED)):
        assert of_bystander(fleet(news=(Happening(Event.POSE_JUMPED, row, 0.3),))) == [Happening(event, row, 0.3)]
    for news in (Happening(Event.TAG_TWICE, 2), Happening(Event.CAMERA_FROZEN), Happening(Event.POSE_JUMPED)):
        assert of_bystander(fleet(news=(news,))) == [news]


def test_a_bystander_is_as_close_as_a_robot() -> None:
    bodies = 0.06 + 0.05
    for gap, events in ((0.005 - 1e-6, [Happening(Event.TOO_CLOSE, 1, 2)]), (0.005 + 1e-6, [])):
        beside = robot(2, driven=False, pose=(bodies + gap, 0.0, 0.0))
        assert told(beside, before=beside) == events


def test_two_bystanders_may_stand_side_by_side_and_robots_beside_them_are_looked_at() -> None:
    side_by_side = robot(1, driven=False, pose=(0.5, 0.05, 0.0))
    for at, events in ((-0.5, []), (0.4, [Happening(Event.TOO_CLOSE, 0, 1), Happening(Event.TOO_CLOSE, 0, 2)])):
        seen = all_of(PARKED, side_by_side, robot(0, pose=(at, 0.0, 0.0)))
        assert told(seen, before=seen) == events


@pytest.mark.parametrize("phase", Phase)
def test_a_bystanders_wheel_that_turns_by_itself_is_told(phase: Phase) -> None:
    latched, turning = robot(2, latch=Latch.RUNAWAY), robot(2, latch=Latch.RUNAWAY, right_speed=6.1)
    assert of_bystander(turning, phase) == [Happening(Event.RUNAWAY, 2)]
    assert of_bystander(latched, phase) == ([] if phase is Phase.IDLE else [Happening(Event.RUNAWAY, 2)])


def test_a_bystander_that_is_pushed_along_does_not_turn_its_wheels_by_itself() -> None:
    assert rolled_on(Phase.RUNNING, 9, driven=False) == []


def test_a_bystanders_stop_that_was_pressed_waits_for_its_reset_in_idle() -> None:
    assert of_bystander(robot(2, latch=Latch.WIRED_STOP), Phase.IDLE) == []


def test_every_bystander_is_looked_at() -> None:
    two = all_of(robot(1, driven=False), robot(2, driven=False, unseen_ns=2 * S))
    assert told(two, before=two) == [Happening(Event.BYSTANDER_LOST, 2)]


def test_a_tag_that_is_nobodys_is_told_as_it_came() -> None:
    for nobody in (3, NOBODY):
        news = Happening(Event.POSE_JUMPED, nobody, 0.3)
        assert of_bystander(fleet(news=(news,))) == [news]
