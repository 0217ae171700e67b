"""The bus inside one process: what every bus does, each after an exact delay."""

from collections.abc import Callable

import pytest

from robofleet.bus.bus import Inbox, MemoryBus
from robofleet.bus.keys import COMMAND, LEASE, TICK
from robofleet.bus.messages import RUN_STATE, RobotState, RunState
from robofleet.core.clock import SimulatedClock
from tests.bus.contract import BusContract, Joined, R

MakeBus = Callable[[int], MemoryBus]


class TestMemoryBus(BusContract):
    @pytest.fixture
    def bus(self, memory_bus: MakeBus, clock: SimulatedClock) -> Joined:
        shared = memory_bus(100)

        def until(poll: Callable[[], R], say: Callable[[], object] = lambda: None) -> R:
            for _ in range(3):  # a request and its answer take the bus's time each
                say()
                clock.advance_to(clock.now_ns() + 100)
                if answer := poll():
                    return answer
            raise AssertionError("nothing came")

        return Joined(shared, shared, clock, until)


def test_a_message_arrives_after_the_delay_and_not_before(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(100)
    inbox, publish = bus.newest(TICK), bus.publisher(TICK)
    for instant, payload in ((0, b"a"), (10, b"b"), (60, b"c")):
        clock.advance_to(instant)
        publish(payload)
    clock.advance_to(99)
    assert inbox.take() is None
    clock.advance_to(120)
    assert (inbox.take(), inbox.arrival_ns, inbox.take()) == (b"b", 110, None)
    clock.advance_to(160)
    assert (inbox.take(), inbox.arrival_ns, inbox.take()) == (b"c", 160, None)


def test_everybody_gets_his_own_copy_of_his_own_key(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    early = bus.newest(COMMAND, "r1")
    publish, publish_other = bus.publisher(COMMAND, "r1"), bus.publisher(COMMAND, "r2")
    late, other = bus.newest(COMMAND, "r1"), bus.newest(COMMAND, "r2")  # after the publisher: heard the same
    publish(b"a")
    assert (early.take(), late.take(), other.take()) == (b"a", b"a", None)
    publish_other(b"b")
    assert (early.take(), other.take()) == (None, b"b")
    publish(b"nobody is told what was said before")
    assert bus.newest(COMMAND, "r1").take() is None


def test_a_tap_hears_all_at_the_moment_of_saying(memory_bus: MakeBus) -> None:
    bus = memory_bus(1000)
    messages: list[tuple[str, bytes]] = []
    bus.tap(messages.append)
    bus.publisher(COMMAND, "r1")(b"a")
    bus.publisher(TICK)(b"b")
    assert messages == [("rf/lab/unit/r1/cmd", b"a"), ("rf/lab/tick", b"b")]


def test_a_request_and_its_answer_take_the_bus_s_time_each(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(100)
    take = bus.serve(LEASE, "r1")
    answer = bus.ask(LEASE, "r1", b"a")
    bus.ask(LEASE, "r1", b"b")
    assert take() is None
    clock.advance_to(100)
    first, second = take(), take()
    assert first is not None and second is not None
    assert (first.payload, second.payload) == (b"a", b"b")
    first.reply(b"yes")
    clock.advance_to(199)
    assert answer.take() is None
    clock.advance_to(200)
    assert answer.take() == b"yes"


def test_a_server_that_comes_later_takes_over(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    old, new = bus.serve(LEASE, "r1"), bus.serve(LEASE, "r1")
    bus.ask(LEASE, "r1", b"a")
    assert old() is None and new() is not None


def test_requests_that_nobody_takes_do_not_pile_up(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    take = bus.serve(LEASE, "r1")
    for k in range(1000):
        bus.ask(LEASE, "r1", b"%d" % k)
    waiting = [request.payload for request in iter(take, None) if request is not None]
    assert 1 <= len(waiting) <= 64 and waiting[-1] == b"999"


@pytest.mark.parametrize("damaged", [b"", b"\0" * 14, b"\1too short"])
def test_an_inbox_counts_and_drops_what_cannot_be_read(memory_bus: MakeBus, damaged: bytes) -> None:
    bus = memory_bus(0)
    inbox, publish = Inbox(bus.newest(TICK), RUN_STATE.decode), bus.publisher(TICK)
    assert (inbox.take(), inbox.rejected) == (None, 0)
    publish(damaged)
    assert (inbox.take(), inbox.rejected) == (None, 1)
    message = RunState(1, 2, 3, 4, 5, 0.5, 6, (RobotState(1, 0, 9),))
    publish(RUN_STATE.encode(message))
    assert (inbox.take(), inbox.rejected) == (message, 1)
