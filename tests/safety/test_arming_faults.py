"""Faults of fleets that wiggle at once: what is named is there, one fault or two, and nobody comes too close."""

import math
from itertools import combinations, pairwise, permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety.arming import Stage
from robofleet.safety.distances import room_m
from robofleet.safety.supervisor import Event, Happening
from tests.safety.arming_lab import BODY_M, Lab
from tests.safety.test_arming import WIRINGS

Accepted = set[tuple[Event, int]]
REACH_M = 2 * BODY_M + room_m(0.016)  # of two robots that may just start


def named(lab: Lab) -> Happening:
    happening = lab.arm()
    assert happening is not None
    return happening


@pytest.mark.slow
@pytest.mark.parametrize("exchange", ["tags", "bodies"])
def test_every_pair_of_exchanged_robots_is_named(exchange: str) -> None:
    """Ten robots need five rounds: most pairs share one, and many begin in one."""
    lab = Lab(10)
    lab.run(5.0, done=lambda state: state.stage is Stage.WIGGLE)
    rounds = lab.state.wiggle.rounds
    pairs = list(combinations(range(10), 2))
    assert sum(bool({*rounds[a]} & {*rounds[b]}) for a, b in pairs) > 20
    for pair in pairs:
        lab = Lab(10)
        who = getattr(lab, exchange)
        who[pair[0]], who[pair[1]] = pair[1], pair[0]
        happening = named(lab)
        assert happening.event is Event.WRONG_TAG_MOVED
        assert {happening.robot, int(happening.detail)} == {*pair}


def _exchange(lab: Lab, exchange: str, a: int, b: int) -> None:
    who = getattr(lab, exchange)
    who[a], who[b] = who[b], who[a]


def _accepted(lab: Lab, wired: dict[int, Event]) -> Accepted:
    """Return what may be said of a fleet: whoever moves whose tag, and faults by the driver or by the tag."""
    accepted: Accepted = set()
    for driver, body in enumerate(lab.bodies):
        tag = lab.tags.index(body)
        if tag != driver:
            accepted |= {(Event.WRONG_TAG_MOVED, driver), (Event.MOVED_UNASKED, tag)}
        if body in wired:
            accepted |= {(wired[body], driver), (wired[body], tag)}
    return accepted


@pytest.mark.slow_after_first
@pytest.mark.parametrize("exchange", ["tags", "bodies"])
@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_of_two_faults_one_is_named(exchange: str, data: st.DataObject) -> None:
    """Two exchanges, an exchange and a wheel, or two wheels: of robots that stand anywhere, also close."""
    n = data.draw(st.integers(4, 9))
    close = data.draw(st.booleans())
    places = [(k % 3 * (0.16 if close else 0.4), k // 3 * (0.16 if close else 0.4)) for k in range(n)]
    rows = data.draw(st.permutations(range(n)))
    wheels = data.draw(st.integers(0, 2))
    anybody = data.draw(st.booleans())  # a wheel of one that is exchanged, too
    faulty = [rows[0] if anybody else rows[2], rows[3]][:wheels]
    wirings = {row: data.draw(st.sampled_from([*WIRINGS, "stuck"])) for row in faulty}
    lab = Lab(n, data.draw(st.integers(0, 99)), {r: {"wiring": w} for r, w in wirings.items() if w != "stuck"}, places)
    lab.stuck = {row for row, wiring in wirings.items() if wiring == "stuck"}
    if wheels < 2:
        _exchange(lab, exchange, rows[0], rows[1])
    if wheels < 1:
        _exchange(lab, exchange, rows[2], rows[3])
    wired = {row: WIRINGS.get(wiring, Event.DID_NOT_MOVE) for row, wiring in wirings.items()}
    happening = named(lab)
    assert (happening.event, happening.robot) in _accepted(lab, wired)
    if happening.event is Event.WRONG_TAG_MOVED:
        assert lab.tags.index(lab.bodies[happening.robot]) == happening.detail


def test_two_exchanges_are_told_apart_by_earlier_rounds() -> None:
    """Both pairs are found out in the second round, in which 0 goes back and 1 begins."""
    lab = Lab(4)
    _exchange(lab, "tags", 0, 2)
    _exchange(lab, "tags", 1, 3)
    assert named(lab) == Happening(Event.WRONG_TAG_MOVED, 0, 2)
    assert lab.state.wiggle.rounds == ((0, 1), (1, 2), (0, 2), (2, 3))


@pytest.mark.parametrize(("first", "second"), [*permutations(range(3), 2)])
def test_who_goes_with_another_one_is_named(first: int, second: int) -> None:
    lab = Lab(3)
    lab.twins = {first: second}
    happening = named(lab)
    assert {happening.robot, int(happening.detail)} & {first} or happening.robot == first


@pytest.mark.slow
@given(
    st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 2), min_size=2, max_size=12),
    st.integers(0, 9),
)
@settings(max_examples=25, deadline=None)
def test_two_without_room_for_both_are_never_away_at_once(places: list[tuple[float, float]], seed: int) -> None:
    """Of random places those that may start; a robot is away from its first stroke until it is back."""
    apart: list[tuple[float, float]] = []
    for pose in places:
        if all(math.dist(pose, other) > REACH_M + 0.002 for other in apart):
            apart.append(pose)
    lab = Lab(len(apart), seed, places=apart)
    lab.run(5.0, done=lambda state: state.stage is Stage.WIGGLE)
    near = [
        pair for pair in combinations(range(len(apart)), 2) if math.dist(*(apart[k] for k in pair)) < REACH_M + 0.04
    ]
    starts = [plant.truth()[:2] for plant in lab.plants]
    while lab.run(0.02) is None:
        away = [math.dist(plant.truth()[:2], start) > 0.009 for plant, start in zip(lab.plants, starts, strict=True)]
        assert not [(a, b) for a, b in near if away[a] and away[b]]
    assert lab.state.stage is Stage.DONE


@pytest.mark.slow_after_first
@pytest.mark.parametrize("wirings", [*permutations([*WIRINGS, "straight"], 2)])
@pytest.mark.parametrize("exchanged", [None, (0, 2), (1, 2), (0, 3)])
def test_bodies_do_not_touch_whatever_is_exchanged_and_wired_wrongly(
    wirings: tuple[str, str], exchanged: tuple[int, int] | None
) -> None:
    """Four that stand as close as they may, two and two face to face."""
    closest = REACH_M + 0.002
    lab = Lab(4, 1, dict(enumerate({"wiring": w} for w in wirings)), [(closest * k, 0.0) for k in range(4)])
    for row, plant in enumerate(lab.plants):
        plant._pose = (closest * row, 0.0, math.pi * (row % 2))
    if exchanged is not None:
        _exchange(lab, "tags", *exchanged)
    gaps = [closest]
    while (happening := lab.run(0.02)) is None:
        gaps += [math.dist(a.truth()[:2], b.truth()[:2]) - 2 * BODY_M for a, b in pairwise(lab.plants)]
    assert happening.event is not Event.PROVED
    assert min(gaps) > 0.0
