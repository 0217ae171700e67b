"""One observer: the newest message of each topic, when it came, and who is alive."""

from collections.abc import Callable

import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import REQUEST, STATE, STATUS, TICK
from robofleet.bus.messages import RUN_STATE, UNIT_STATUS, RobotStatus, RunState, UnitStatus
from robofleet.bus.observer import Observer, RobotObserved, robots_observed
from robofleet.core.clock import MS, SimulatedClock

MakeBus = Callable[[int], MemoryBus]


def state(seq: int) -> RunState:
    return RunState(1, seq, 3, 0, 0, 0.0, 0, ())


def test_the_newest_valid_message_of_each_topic_is_kept_with_its_arrival(
    memory_bus: MakeBus, clock: SimulatedClock
) -> None:
    bus = memory_bus(10)
    observer = Observer(bus, [STATE, (STATUS, "u1"), (STATUS, "u2")])
    publish = bus.publisher(STATE)
    assert observer.update(clock.now_ns()) == set()
    assert (observer[STATE], observer.arrival_ns(STATE), observer.age_ns(STATE, 5)) == (None, 0, None)
    publish(RUN_STATE.encode(state(1)))
    publish(RUN_STATE.encode(state(2)))
    bus.publisher(STATUS, "u2")(UNIT_STATUS.encode(UnitStatus(*[7] * 6, ())))
    clock.advance_to(100)
    assert observer.update(100) == {STATE, (STATUS, "u2")}
    assert observer[STATE] == state(2)
    assert observer[STATUS, "u2"].seq == 7
    assert observer[STATUS, "u1"] is None
    publish(b"no state")
    clock.advance_to(200)
    assert observer.update(200) == set(), "what cannot be decoded is nobody's word"
    assert (observer[STATE], observer.arrival_ns(STATE), observer.age_ns(STATE, 200)) == (state(2), 10, 190)


@pytest.mark.parametrize(("age_ns", "alive"), [(50 * MS, True), (50 * MS + 1, False)])
def test_who_has_spoken_within_a_time_is_alive(memory_bus: MakeBus, age_ns: int, alive: bool) -> None:
    bus = memory_bus(0)
    observer = Observer(bus, [STATE, TICK])
    bus.publisher(STATE)(RUN_STATE.encode(state(1)))
    observer.update(0)
    assert observer.alive(STATE, age_ns, 50 * MS) is alive
    assert not observer.alive(TICK, 0, 50 * MS), "it has never spoken"


def test_it_wakes_and_decodes_as_declared(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus, woken = memory_bus(10), list[int]()
    observer = Observer(bus, [TICK], woken.append)
    observer.declare([STATE], RUN_STATE.decode_head)
    bus.publisher(TICK)(b"")
    bus.publisher(STATE)(RUN_STATE.encode(state(4)))
    assert woken == [10, 10]
    clock.advance_to(10)
    assert observer.update(10) == {STATE}
    with pytest.raises(AssertionError):
        observer.declare([(REQUEST, "supervisor")])  # it is asked, not observed


def test_each_robot_has_the_newest_status_of_its_unit(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus, units = memory_bus(10), {"u1": ("r1", "r3"), "u2": ("r2",), "u3": ("r4",)}
    observer = Observer(bus, [(STATUS, unit) for unit in units])
    robots = [RobotStatus(*[number] * len(RobotStatus._fields)) for number in (1, 2, 3)]
    bus.publisher(STATUS, "u1")(UNIT_STATUS.encode(UnitStatus(*[7] * 6, (robots[0], robots[2]))))
    bus.publisher(STATUS, "u3")(UNIT_STATUS.encode(UnitStatus(*[7] * 6, (robots[0], robots[2]))))
    clock.advance_to(100)
    observer.update(100)
    observed = robots_observed(observer, units, ["r1", "r2", "r3", "r4"])
    assert observed[::2] == [RobotObserved(robots[0], 10), RobotObserved(robots[2], 10)]
    assert observed[1::2] == [RobotObserved(), RobotObserved()], "u2 is silent, u3 has other robots"
