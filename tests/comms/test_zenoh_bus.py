"""The bus over Zenoh's own router on loopback: one router, two clients, in this process."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import pytest

from robofleet.clock import MS, S, WallClock
from robofleet.comms.endpoint import bind_endpoint
from robofleet.comms.keys import COMMAND, STATE, STATUS, TICK, everything
from robofleet.comms.zenoh_bus import ZenohBus, open_router

CLOCK = WallClock()


class Net(NamedTuple):
    """Two clients of one router, and the way to a third."""

    a: ZenohBus
    b: ZenohBus
    endpoint: str


@pytest.fixture(scope="module")
def net() -> Iterator[Net]:
    endpoint = bind_endpoint("tcp/127.0.0.1:0")
    opened: list[ZenohBus] = []
    router = open_router(endpoint)
    try:
        for name in ("a", "b"):
            opened.append(ZenohBus("lab", endpoint, name, CLOCK))
        yield Net(*opened, endpoint)
    finally:
        for bus in opened:
            bus.close()
            bus.close()  # idempotent
        router.close()


R = TypeVar("R")


def until(poll: Callable[[], R], say: Callable[[], None] = lambda: None) -> R:
    """Poll until the answer is true; ``say`` is repeated, since the first messages may find no route yet."""
    deadline = CLOCK.now_ns() + 5 * S
    while CLOCK.now_ns() < deadline:
        say()
        CLOCK.sleep_until(CLOCK.now_ns() + 2 * MS)
        if answer := poll():
            return answer
    raise AssertionError("nothing came within 5 s")


def test_a_subscription_keeps_the_newest(net: Net) -> None:
    publish, inbox = net.a.publisher(COMMAND, "r1"), net.b.newest(COMMAND, "r1")
    other = net.b.newest(COMMAND, "r2")
    assert until(inbox.take, lambda: publish(b"route")) == b"route"
    for k in range(20):
        publish(b"%d" % k)
    taken = until(lambda: inbox.take() == b"19" or None)  # the last one stays, and it stays once
    assert taken
    assert inbox.take() is None
    assert other.take() is None


def test_a_wake_comes_with_the_arrival(net: Net) -> None:
    woken: list[int] = []
    publish, inbox = net.a.publisher(STATUS, "r1"), net.b.newest(STATUS, "r1", wake=woken.append)
    before = CLOCK.now_ns()
    until(lambda: woken, lambda: publish(b"x"))
    assert inbox.take() == b"x"
    assert before < inbox.arrival_ns <= CLOCK.now_ns()
    assert inbox.arrival_ns in woken


def test_a_stream_hears_the_whole_arena_and_no_other(net: Net) -> None:
    stream = net.b.stream(everything("lab"), 100)
    publishers = {"rf/lab/tick": net.a.publisher(TICK), "rf/lab/state": net.a.publisher(STATE)}
    foreign = ZenohBus("elsewhere", net.endpoint, "c", CLOCK)
    try:
        publish_foreign = foreign.publisher(TICK)
        heard: dict[str, bytes] = {}

        def say() -> None:
            publish_foreign(b"not for the lab")
            for full, publish in publishers.items():
                publish(full.encode())

        def both() -> bool:
            heard.update(stream.drain())
            return len(heard) >= 2

        until(both, say)
        assert heard == {full: full.encode() for full in publishers}
    finally:
        foreign.close()


def test_a_full_stream_drops_the_oldest(net: Net) -> None:
    stream, publish = net.b.stream("rf/lab/robot/r9/cmd", 4), net.a.publisher(COMMAND, "r9")
    witness = net.b.newest(COMMAND, "r9")
    until(witness.take, lambda: publish(b"route"))
    for k in range(30):
        publish(b"%d" % k)
        CLOCK.sleep_until(CLOCK.now_ns() + MS)
    until(lambda: witness.take() == b"29" or None)
    assert [payload for _, payload in stream.drain()] == [b"26", b"27", b"28", b"29"]


def ask(bus: ZenohBus, process: str, text: str) -> tuple[str, int]:
    """Return the answer and how long it took [ns]; repeated while the router has not heard who serves."""
    deadline = CLOCK.now_ns() + 5 * S
    while True:
        began = CLOCK.now_ns()
        try:
            return bus.ask(process, text), CLOCK.now_ns() - began
        except TimeoutError:
            if CLOCK.now_ns() > deadline:
                raise
            CLOCK.sleep_until(CLOCK.now_ns() + 5 * MS)


def test_a_request_is_answered_by_the_process_that_serves_it(net: Net) -> None:
    take = net.b.serve("supervisor")
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(ask, net.a, "supervisor", "start")
        request = until(take)
        assert request is not None
        assert request.text == "start"
        request.reply("armed")
        text, took_ns = answer.result()
    assert text == "armed"
    assert took_ns < 0.9 * S  # at once, not when the asker gives up
    assert take() is None


def test_nobody_answers(net: Net) -> None:
    with pytest.raises(TimeoutError, match="nobody does not answer on rf/lab/request/nobody"):
        net.a.ask("nobody", "start")
