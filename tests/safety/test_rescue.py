"""Who may be driven out of a held run: one robot at most, in HOLD, while a button is held that was pressed there."""

import dataclasses
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robofleet.safety.latches import Latch
from robofleet.safety.rescue import NEWER_TICKS, WORD_NS, WORD_TICKS, Rescue, Word, watch
from robofleet.safety.supervisor import NOBODY, Event, Happening, Phase, RunStatus
from robofleet.safety.view import FleetView, RobotView
from robofleet.vehicles.interface import RobotFault

MS = 1_000_000
NOW, TICK, N = 1_000_000 * MS, 1000, 3
BY_PAGE, BY_PAD = Event.DRIVEN_OUT_BY_PAGE, Event.DRIVEN_OUT_BY_GAMEPAD
WELL = RobotView(heard_ns=NOW, seen_ns=NOW)
BYSTANDER = WELL._replace(driven=False)
HELD = RunStatus(Phase.HOLD, Event.DEADLOCKED, 0)
ASKS = Word(1, True, 0, BY_PAGE, TICK)
LETS_GO = Word(1, False, NOBODY, Event.NOTHING, TICK)


def view(at_ns: int = NOW, tick: int = TICK, robots: tuple[RobotView, ...] = (WELL,) * N) -> FleetView:
    return FleetView(at_ns, (*robots, BYSTANDER), controller_ns=at_ns, tick=tick, tracker_ns=at_ns)


def pressed(word: Word = ASKS, *, status: RunStatus = HELD, seen: FleetView | None = None) -> Rescue:
    """Let a button be pressed that was heard to be up before."""
    before = watch(Rescue(), (LETS_GO._replace(hand=word.hand),), status, (), view())
    return watch(before, (word,), status, (), seen or view())


def test_a_button_that_is_pressed_in_a_held_run_lets_its_robot_crawl() -> None:
    rescue = pressed()
    assert (rescue.robot, rescue.request) == (0, BY_PAGE)
    assert rescue.cause(0) == BY_PAGE
    assert rescue.cause(1) == Event.NOTHING
    assert pressed(ASKS._replace(robot=2, request=BY_PAD))[-2:] == (2, BY_PAD)


def test_a_button_that_is_let_go_makes_it_stand_at_once() -> None:
    rescue = watch(pressed(), (LETS_GO,), HELD, (), view())
    assert (rescue.robot, rescue.request) == (NOBODY, Event.NOTHING)
    assert watch(rescue, (ASKS,), HELD, (), view()).robot == 0, "pressed again"
    assert watch(pressed(), (LETS_GO._replace(hand=2),), HELD, (), view()).robot == 0, "another one's button"


def test_a_hand_that_presses_while_another_one_holds_waits_and_one_that_presses_after_it_does_not() -> None:
    both, other = watch(pressed(), (LETS_GO._replace(hand=2),), HELD, (), view()), ASKS._replace(hand=2)
    assert both.robot == 0
    assert watch(both, (other,), HELD, (), view()).robot == NOBODY
    assert watch(both, (LETS_GO, other), HELD, (), view()).robot == 0


def test_what_is_just_young_enough_counts() -> None:
    assert pressed(seen=view()._replace(controller_ns=NOW - WORD_NS)).robot == 0
    assert pressed(seen=view(robots=(WELL._replace(heard_ns=NOW - 500 * MS),) * N)).robot == 0


@pytest.mark.parametrize("phase", [phase for phase in Phase if phase is not Phase.HOLD])
def test_nobody_is_driven_out_but_of_a_held_run(phase: Phase) -> None:
    assert pressed(status=RunStatus(phase)).robot == NOBODY


@pytest.mark.parametrize("held", [Phase.POSITIONING, Phase.PARKING])
def test_nobody_is_driven_out_on_the_way_to_the_start_or_the_park(held: Phase) -> None:
    assert pressed(status=HELD._replace(held=held)).robot == NOBODY


def test_a_button_that_was_held_when_the_run_was_held_moves_nothing() -> None:
    running = watch(Rescue(), (ASKS,), RunStatus(Phase.RUNNING), (), view())
    held = watch(running, (ASKS,), HELD, (), view())
    assert held.robot == NOBODY
    held = watch(held, (ASKS,), HELD, (), view())
    assert held.robot == NOBODY
    held = watch(held, (LETS_GO,), HELD, (), view())
    assert watch(held, (ASKS,), HELD, (), view()).robot == 0


def test_another_robot_and_another_hand_wait_for_the_release() -> None:
    for other in (ASKS._replace(robot=1), ASKS._replace(hand=2)):
        rescue = watch(pressed(), (other,), HELD, (), view())
        assert rescue.robot == NOBODY, other
        rescue = watch(rescue, (other,), HELD, (), view())
        assert rescue.robot == NOBODY, other
        rescue = watch(rescue, (LETS_GO._replace(hand=other.hand),), HELD, (), view())
        assert watch(rescue, (other,), HELD, (), view()).robot == other.robot


def test_after_a_silence_a_button_that_was_never_heard_up_moves_nothing() -> None:
    later = view(NOW + 200 * MS, TICK + 6, (WELL._replace(heard_ns=NOW + 200 * MS),) * N)
    again = ASKS._replace(tick=TICK + 6)
    rescue = watch(pressed(), (), HELD, (), later)
    assert rescue.robot == NOBODY
    for _ in range(3):
        rescue = watch(rescue, (again,), HELD, (), later)
        assert rescue.robot == NOBODY
    rescue = watch(rescue, (LETS_GO,), HELD, (), later)
    assert watch(rescue, (again,), HELD, (), later).robot == 0
    assert watch(pressed(), (again,), HELD, (), later).robot == NOBODY, "and where nobody looked in between"


def test_a_hand_that_was_not_heard_up_before_it_pressed_moves_nothing() -> None:
    assert watch(Rescue(), (ASKS,), HELD, (), view()).robot == NOBODY
    assert watch(watch(Rescue(), (), HELD, (), view()), (ASKS,), HELD, (), view()).robot == NOBODY


def test_who_still_holds_the_button_does_not_go_on_when_a_second_person_lets_go() -> None:
    second = ASKS._replace(hand=2)
    rescue = watch(pressed(), (second,), HELD, (), view())
    assert rescue.robot == NOBODY
    for words in ((LETS_GO._replace(hand=2),), (ASKS,), (ASKS,)):
        rescue = watch(rescue, words, HELD, (), view())
        assert rescue.robot == NOBODY
    rescue = watch(rescue, (LETS_GO,), HELD, (), view())
    assert watch(rescue, (ASKS,), HELD, (), view()).robot == 0


@pytest.mark.parametrize(
    ("age_ns", "age_ticks", "permitted"),
    [
        (WORD_NS, 0, True),
        (WORD_NS + 1, 0, False),
        (0, WORD_TICKS, True),
        (0, WORD_TICKS + 1, False),
        (0, -NEWER_TICKS, True),
        (0, -NEWER_TICKS - 1, False),
    ],
)
def test_a_command_counts_while_it_is_fresh_by_its_arrival_and_by_its_tick(
    age_ns: int, age_ticks: int, permitted: bool
) -> None:
    robots = (WELL._replace(heard_ns=NOW + age_ns),) * N
    rescue = watch(pressed(), (), HELD, (), view(NOW + age_ns, TICK + age_ticks, robots))
    assert (rescue.robot == 0) is permitted


def test_ticks_of_a_controller_that_is_silent_say_nothing_of_an_age() -> None:
    silent = view(NOW + WORD_NS + 1)._replace(controller_ns=NOW)
    assert watch(pressed(), (ASKS,), HELD, (), silent).robot == NOBODY


@pytest.mark.parametrize(
    "ill",
    [
        {"heard_ns": 0},
        {"heard_ns": NOW - 500 * MS - 1},
        {"seen_ns": 0},
        {"unseen_ns": 100 * MS},
        {"lost": True},
        {"faults": RobotFault.BUMPED},
        {"latch": Latch.WIRED_STOP},
        {"failed": Event.BEHAVIOUR_RAISED},
        {"driven": False},
    ],
)
def test_a_robot_that_is_not_well_stands_until_the_button_is_pressed_again(ill: dict[str, int]) -> None:
    robots = (WELL._replace(**ill), WELL, WELL)  # type: ignore[arg-type]
    if "driven" in ill:
        assert pressed(ASKS._replace(robot=N)).robot == NOBODY, "a bystander"
        return
    rescue = watch(pressed(), (ASKS,), HELD, (), view(robots=robots))
    assert rescue.robot == NOBODY
    assert watch(rescue, (ASKS,), HELD, (), view()).robot == NOBODY, "it was not let go"
    assert pressed(ASKS._replace(robot=1), seen=view(robots=robots)).robot == 1, "the others are well"


@pytest.mark.parametrize("event", [event for event in Event if event is not Event.TOO_CLOSE])
def test_nobody_is_driven_out_while_something_lasts(event: Event) -> None:
    assert watch(pressed(), (ASKS,), HELD, (Happening(event, 1),), view()).robot == NOBODY


def test_robots_that_are_too_close_may_be_driven_apart() -> None:
    assert watch(pressed(), (ASKS,), HELD, (Happening(Event.TOO_CLOSE, 0, 1),), view()).robot == 0


def test_a_robot_that_nobody_has_is_not_driven_out() -> None:
    for robot in (NOBODY, N + 1, -1):
        assert pressed(ASKS._replace(robot=robot)).robot == NOBODY


@dataclasses.dataclass
class Moment:
    """What comes in a step."""

    words: tuple[Word, ...]
    phase: Phase
    passed_ms: int
    ill: int  # row; N: nobody
    lasting: bool


WORDS = st.builds(
    Word, st.sampled_from([1, 1, 2]), st.sampled_from([True, True, False]), st.sampled_from([0, 1]),
    st.sampled_from([BY_PAGE, BY_PAD]), st.sampled_from([TICK] * 6 + [TICK - WORD_TICKS - 1]),
)  # fmt: skip
MOMENTS = st.builds(
    Moment, st.lists(WORDS, max_size=2).map(tuple), st.sampled_from([Phase.HOLD] * 9 + [Phase.RUNNING]),
    st.sampled_from([20] * 4 + [100, 160]), st.sampled_from([N] * 9 + [0]), st.sampled_from([False] * 9 + [True]),
)  # fmt: skip


@pytest.mark.slow
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])  # on a busy machine
@given(st.lists(MOMENTS, max_size=25))
def test_whatever_comes_one_robot_at_most_is_driven_out_and_none_without_a_button_pressed_in_this_hold(
    moments: list[Moment],
) -> None:
    """By an account of its own: what each hand holds, when it was heard, and whether it pressed after it let go."""
    rescue, now_ns = Rescue(), NOW
    permitted: list[int] = []
    newest: dict[int, tuple[Word, int]] = {}  # of each hand that holds its button
    pressed: set[int] = set()  # hands that let go, and held their button since in this HOLD alone, heard all the time
    for moment in moments:
        now_ns += moment.passed_ms * MS
        robots = tuple(WELL._replace(heard_ns=now_ns, faults=int(row == moment.ill)) for row in range(N))
        standing = (Happening(Event.TAG_LOST, 1),) * moment.lasting
        rescue = watch(rescue, moment.words, RunStatus(moment.phase), standing, view(now_ns, TICK, robots))
        pressed -= {hand for hand, (_, at_ns) in newest.items() if now_ns - at_ns > WORD_NS}
        for word in moment.words:
            newest.pop(word.hand, None)
            if word.held:
                newest[word.hand] = word, now_ns
            else:
                pressed.add(word.hand)
        if moment.phase is not Phase.HOLD:
            pressed -= newest.keys()
        permitted.append(rescue.robot)
        if rescue.robot != NOBODY:
            assert moment.phase is Phase.HOLD
            assert moment.ill != rescue.robot < N
            assert not moment.lasting
            holding = [
                word for word, at_ns in newest.values() if now_ns - at_ns <= WORD_NS and word.robot == rescue.robot
            ]
            assert holding, "somebody holds the button for this robot"
            assert any(TICK - word.tick <= WORD_TICKS for word in holding)
            assert any(word.hand in pressed for word in holding)
    for before, after in pairwise(permitted):
        assert NOBODY in (before, after) or before == after, "no robot takes another's place without a release"
