"""The bus inside one process: delay, order, newest only, bounded streams."""

from collections.abc import Callable

import pytest

from robofleet.bus.bus import Inbox, MemoryBus
from robofleet.bus.keys import COMMAND, LEASE, REQUEST, STATUS, TICK, key
from robofleet.bus.messages import RUN_STATE, RobotState, RunState
from robofleet.core.clock import SimulatedClock

MakeBus = Callable[[int], MemoryBus]


def test_a_message_arrives_after_the_delay_and_not_before(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(100)
    publish, inbox = bus.publisher(TICK), bus.newest(TICK)
    clock.advance_to(1000)
    publish(b"a")
    assert inbox.take() is None
    clock.advance_to(1099)
    assert inbox.take() is None
    clock.advance_to(1100)
    assert inbox.take() == b"a"
    assert inbox.arrival_ns == 1100
    assert inbox.take() is None


def test_a_subscription_keeps_the_newest_of_those_that_arrived(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(100)
    inbox, publish = bus.newest(TICK), bus.publisher(TICK)
    for instant, payload in ((0, b"a"), (10, b"b"), (60, b"c")):
        clock.advance_to(instant)
        publish(payload)
    clock.advance_to(120)
    assert inbox.take() == b"b"
    assert inbox.arrival_ns == 110
    assert inbox.take() is None
    clock.advance_to(160)
    assert inbox.take() == b"c"


def test_newest_means_newest_also_when_nobody_looked_for_long(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    inbox, publish = bus.newest(TICK), bus.publisher(TICK)
    for k in range(1000):
        publish(str(k).encode())
    assert inbox.take() == b"999"
    assert inbox.take() is None


def test_a_stream_gives_everything_in_order_and_drops_the_oldest(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(5)
    stream, publish = bus.stream(key("lab", STATUS, "r1"), capacity=3), bus.publisher(STATUS, "r1")
    for k in range(5):
        publish(bytes([k]))
    assert stream.drain() == []
    clock.advance_to(5)
    messages = stream.drain()
    assert [(full, payload) for _, full, payload in messages] == [
        ("rf/lab/unit/r1/status", bytes([k])) for k in (2, 3, 4)
    ]
    assert stream.dropped == 2
    assert stream.drain() == []


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


def test_a_wake_is_called_with_the_instant_of_the_arrival(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(40)
    woken: list[int] = []
    bus.newest(COMMAND, "r1", wake=woken.append)
    clock.advance_to(7)
    bus.publisher(COMMAND, "r1")(b"a")
    bus.publisher(COMMAND, "r2")(b"b")
    assert woken == [47]


def test_a_tap_hears_all_at_the_moment_of_saying(memory_bus: MakeBus) -> None:
    bus = memory_bus(1000)
    messages: list[tuple[str, bytes]] = []
    bus.tap(messages.append)
    bus.publisher(COMMAND, "r1")(b"a")
    bus.publisher(TICK)(b"b")
    assert messages == [("rf/lab/unit/r1/cmd", b"a"), ("rf/lab/tick", b"b")]


def test_requests_reach_the_process_that_serves_them(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus, woken = memory_bus(0), list[int]()
    take, other = bus.serve(REQUEST, "supervisor", woken.append), bus.serve(REQUEST, "tracker")
    answer = bus.ask(REQUEST, "supervisor", b"start")
    assert woken == [clock.now_ns()]
    request = take()
    assert request is not None
    assert request.payload == b"start"
    assert answer.take() is None
    request.reply(b"done")
    assert (answer.take(), answer.take()) == (b"done", None)
    assert take() is None
    assert other() is None


def test_a_request_and_its_answer_take_the_bus_s_time_each(memory_bus: MakeBus, clock: SimulatedClock) -> None:
    bus = memory_bus(100)
    take = bus.serve(LEASE, "r1")
    answer = bus.ask(LEASE, "r1", b"a")
    bus.ask(LEASE, "r1", b"b")
    assert take() is None
    clock.advance_to(100)
    first, second = take(), take()
    assert first is not None
    assert second is not None
    assert (first.payload, second.payload) == (b"a", b"b")
    first.reply(b"yes")
    clock.advance_to(199)
    assert answer.take() is None
    clock.advance_to(200)
    assert answer.take() == b"yes"


def test_where_nobody_serves_no_answer_comes(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    assert bus.ask(LEASE, "r1", b"a").take() is None
    assert bus.serve(LEASE, "r1")() is None  # who comes later is not told what was asked before


def test_a_server_that_comes_later_takes_over(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    old, new = bus.serve(LEASE, "r1"), bus.serve(LEASE, "r1")
    bus.ask(LEASE, "r1", b"a")
    assert old() is None
    assert new() is not None


def test_requests_that_nobody_takes_do_not_pile_up(memory_bus: MakeBus) -> None:
    bus = memory_bus(0)
    take = bus.serve(LEASE, "r1")
    for k in range(1000):
        bus.ask(LEASE, "r1", b"%d" % k)
    waiting = [request.payload for request in iter(take, None) if request is not None]
    assert 1 <= len(waiting) <= 64
    assert waiting[-1] == b"999"


@pytest.mark.parametrize("damaged", [b"", b"\0" * 14, b"\1too short"])
def test_an_inbox_counts_and_drops_what_cannot_be_read(memory_bus: MakeBus, damaged: bytes) -> None:
    bus = memory_bus(0)
    inbox, publish = Inbox(bus.newest(TICK), RUN_STATE.decode), bus.publisher(TICK)
    assert inbox.take() is None
    assert inbox.rejected == 0
    publish(damaged)
    assert inbox.take() is None
    assert inbox.rejected == 1
    message = RunState(1, 2, 3, 4, 5, 0.5, 6, (RobotState(1, 0, 9),))
    publish(RUN_STATE.encode(message))
    assert inbox.take() == message
    assert inbox.rejected == 1
    bus.close()
    bus.close()
