"""The bus over Zenoh's own router on loopback: one router, two clients, in this process."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import pytest

from robofleet.bus.bus import Request
from robofleet.bus.keys import COMMAND, LEASE, REQUEST, STATE, STATUS, TICK, key
from robofleet.bus.requests import asked as operator_asks
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.core.clock import MS, S, WallClock
from tests.endpoints import own_endpoint

CLOCK = WallClock()


class Net(NamedTuple):
    """Two clients of one router, and the way to a third."""

    a: ZenohBus
    b: ZenohBus
    endpoint: str


@pytest.fixture(scope="module")
def net() -> Iterator[Net]:
    endpoint = own_endpoint()
    opened: list[ZenohBus] = []
    router = open_router(endpoint)
    try:
        opened.append(ZenohBus("lab", endpoint, "a", CLOCK))
        opened.append(
            ZenohBus("lab", endpoint, "b", CLOCK, roles=("supervisor", *(f"driver-r{k}" for k in range(1, 5))))
        )
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

    def burst() -> None:
        for k in range(20):
            publish(b"%d" % k)

    assert until(
        lambda: inbox.take() == b"19" or None, burst
    )  # the last one stays; a busy link may drop one of a burst
    assert other.take() is None


def test_a_wake_comes_with_the_arrival(net: Net) -> None:
    woken: list[int] = []
    publish, inbox = net.a.publisher(STATUS, "r1"), net.b.newest(STATUS, "r1", wake=woken.append)
    before = CLOCK.now_ns()
    until(lambda: woken, lambda: publish(b"x"))
    assert inbox.take() == b"x"
    assert before < inbox.arrival_ns <= CLOCK.now_ns()
    assert inbox.arrival_ns in woken


def test_a_stream_hears_the_keys_that_were_named_and_no_other(net: Net) -> None:
    stream = net.b.stream(key("lab", TICK), key("lab", STATE), capacity=100)
    publishers = {"rf/lab/tick": net.a.publisher(TICK), "rf/lab/state": net.a.publisher(STATE)}
    foreign = ZenohBus("elsewhere", net.endpoint, "c", CLOCK)
    try:
        publish_foreign, publish_unknown = foreign.publisher(TICK), net.a.publisher(STATUS, "nobody")
        messages: dict[str, bytes] = {}

        def say() -> None:
            publish_foreign(b"not for the lab")
            publish_unknown(b"of a robot that there is not")
            for full, publish in publishers.items():
                publish(full.encode())

        def both() -> bool:
            messages.update((full, payload) for _, full, payload in stream.drain())
            return len(messages) >= 2

        until(both, say)
        assert messages == {full: full.encode() for full in publishers}
    finally:
        foreign.close()


def test_a_full_stream_drops_the_oldest_and_counts_them(net: Net) -> None:
    stream, publish = net.b.stream("rf/lab/unit/r9/cmd", capacity=4), net.a.publisher(COMMAND, "r9")
    requests: list[bytes] = []
    net.b.listen(COMMAND, "r9", lambda _, payload: requests.append(payload))
    probe = net.b.newest(COMMAND, "r9")
    until(probe.take, lambda: publish(b"route"))
    began_ns = CLOCK.now_ns()
    for k in range(30):
        publish(b"%d" % k)
        CLOCK.sleep_until(CLOCK.now_ns() + MS)
    until(lambda: probe.take() == b"29" or None)
    arrivals = stream.drain()
    assert [payload for _, _, payload in arrivals] == [b"26", b"27", b"28", b"29"]
    until(lambda: len(requests) == stream.dropped + 4)
    instants = [at_ns for at_ns, _, _ in arrivals]
    assert began_ns < instants[0] < instants[-1] <= CLOCK.now_ns()
    assert instants == sorted(instants)


def asked(bus: ZenohBus, name: str, payload: bytes, serve: Callable[[], None]) -> tuple[bytes, int]:
    """Return the answer and how long it took [ns]; asked anew while the router has not heard who serves."""
    began, answer = 0, None
    deadline = CLOCK.now_ns() + 5 * S
    while CLOCK.now_ns() < deadline:
        if answer is None or CLOCK.now_ns() - began > S // 2:
            began, answer = CLOCK.now_ns(), bus.ask(LEASE, name, payload)
        serve()
        if (reply := answer.take()) is not None:
            return reply, CLOCK.now_ns() - began
        CLOCK.sleep_until(CLOCK.now_ns() + MS)
    raise AssertionError("no answer within 5 s")


def answering(take: Callable[[], Request | None], requests: list[bytes], reply: bytes) -> Callable[[], None]:
    def serve() -> None:
        while (request := take()) is not None:
            requests.append(request.payload)
            request.reply(reply)

    return serve


def test_a_request_wakes_who_serves_it_and_is_answered_at_once(net: Net) -> None:
    woken: list[int] = []
    requests: list[bytes] = []
    take = net.b.serve(LEASE, "r1", woken.append)
    others = net.b.serve(LEASE, "r2")
    before = CLOCK.now_ns()
    answer, took_ns = asked(net.a, "r1", b"\x02\0mine", answering(take, requests, b"yes"))
    assert answer == b"yes"
    assert set(requests) == {b"\x02\0mine"}
    assert woken
    assert all(before < instant_ns <= CLOCK.now_ns() for instant_ns in woken)
    quickest_ns = min(
        took_ns, *(asked(net.a, "r1", b"\x02\0mine", answering(take, requests, b"yes"))[1] for _ in range(2))
    )
    assert quickest_ns < 0.4 * S  # not when the asker gives up
    assert take() is None
    assert others() is None


def test_an_answer_is_taken_once(net: Net) -> None:
    take = net.b.serve(LEASE, "r3")
    asked(net.a, "r3", b"route", answering(take, [], b"yes"))
    answer = net.a.ask(LEASE, "r3", b"mine")
    request = until(take)
    assert request is not None
    assert answer.take() is None
    request.reply(b"granted")
    assert until(answer.take) == b"granted"
    assert answer.take() is None


def test_where_nobody_serves_no_answer_comes_and_nobody_waits(net: Net) -> None:
    took_ns = []
    for _ in range(3):  # the quickest: a busy machine may keep any of them
        before = CLOCK.now_ns()
        answer = net.a.ask(LEASE, "nobody", b"mine")
        took_ns.append(CLOCK.now_ns() - before)
    assert min(took_ns) < 0.2 * S
    CLOCK.sleep_until(CLOCK.now_ns() + 300 * MS)
    assert answer.take() is None


def test_an_operator_is_answered_or_told_that_nobody_is(net: Net) -> None:
    take = net.b.serve(REQUEST, "supervisor")
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(operator_asks, net.a, CLOCK, "supervisor", b"start")
        request = until(take)
        assert request is not None
        assert request.payload == b"start"
        request.reply(b"armed")
        assert answer.result() == b"armed"
    with pytest.raises(TimeoutError, match="the tracker does not answer"):
        operator_asks(net.a, CLOCK, "tracker", b"start")
