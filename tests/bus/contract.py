"""What every bus does, in memory and over Zenoh."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

from robofleet.bus.bus import Bus, Request
from robofleet.bus.keys import COMMAND, LEASE, STATUS, key
from robofleet.core.clock import MS, Clock, S, WallClock

R = TypeVar("R")
CLOCK = WallClock()


class Until(Protocol):
    """Polls until the answer is true; ``say`` is repeated, since the first messages may find no route yet."""

    def __call__(self, poll: Callable[[], R], say: Callable[[], object] = ...) -> R: ...


def until(poll: Callable[[], R], say: Callable[[], object] = lambda: None, within_s: float = 5.0) -> R:
    """Poll in real time; AssertionError where the answer is never true."""
    deadline = CLOCK.now_ns() + round(within_s * S)
    while CLOCK.now_ns() < deadline:
        say()
        CLOCK.sleep_until(CLOCK.now_ns() + 2 * MS)
        if answer := poll():
            return answer
    raise AssertionError(f"nothing came within {within_s} s")


def answering(take: Callable[[], Request | None], requests: list[bytes], reply: bytes) -> Callable[[], None]:
    """Return what answers every request that came."""

    def serve() -> None:
        while (request := take()) is not None:
            requests.append(request.payload)
            request.reply(reply)

    return serve


class Joined(NamedTuple):
    """A bus of the arena ``lab`` as two processes have it; ``b`` has the roles driver-r1 to driver-r4."""

    a: Bus
    b: Bus
    clock: Clock
    until: Until


class BusContract:
    """The tests of a bus; a subclass has the fixture ``bus``."""

    def test_a_subscription_keeps_the_newest_of_its_own_key(self, bus: Joined) -> None:
        publish, inbox, other = bus.a.publisher(COMMAND, "r1"), bus.b.newest(COMMAND, "r1"), bus.b.newest(COMMAND, "r2")
        bus.until(inbox.take, lambda: publish(b"route"))

        def burst() -> None:
            for k in range(100):
                publish(b"%d" % k)

        bus.until(lambda: inbox.take() == b"99" or None, burst)  # a busy link may drop one of a burst
        assert other.take() is None

    def test_a_wake_comes_with_the_arrival(self, bus: Joined) -> None:
        woken: list[int] = []
        publish, inbox = bus.a.publisher(STATUS, "r1"), bus.b.newest(STATUS, "r1", woken.append)
        before_ns = bus.clock.now_ns()
        bus.until(lambda: woken, lambda: publish(b"x"))
        assert inbox.take() == b"x"
        assert before_ns < inbox.arrival_ns <= bus.clock.now_ns()
        assert inbox.arrival_ns in woken

    def test_a_full_stream_drops_the_oldest_and_counts_them(self, bus: Joined) -> None:
        stream, publish = bus.b.stream(key("lab", COMMAND, "r9"), capacity=4), bus.a.publisher(COMMAND, "r9")
        received: list[bytes] = []
        bus.b.listen(COMMAND, "r9", lambda _, payload: received.append(payload))
        probe = bus.b.newest(COMMAND, "r9")
        bus.until(probe.take, lambda: publish(b"route"))
        for k in range(30):
            publish(b"%d" % k)
            bus.until(lambda: received[-1:] == [b"%d" % k])  # noqa: B023
        bus.until(lambda: len(received) == stream.dropped + 4)
        arrivals = stream.drain()
        assert [arrival.payload for arrival in arrivals] == [b"26", b"27", b"28", b"29"]
        assert {arrival.key for arrival in arrivals} == {"rf/lab/unit/r9/cmd"}
        instants = [arrival.at_ns for arrival in arrivals]
        assert instants == sorted(instants) and instants[-1] <= bus.clock.now_ns()
        assert stream.drain() == []

    def test_a_request_wakes_who_serves_it_and_its_answer_is_taken_once(self, bus: Joined) -> None:
        woken: list[int] = []
        requests: list[bytes] = []
        take, other = bus.b.serve(LEASE, "r1", woken.append), bus.b.serve(LEASE, "r2")
        bus.until(lambda: requests, lambda: (bus.a.ask(LEASE, "r1", b"route"), answering(take, requests, b"")())[1])
        answer = bus.a.ask(LEASE, "r1", b"mine")
        request = bus.until(lambda: next((found for found in iter(take, None) if found.payload == b"mine"), None))
        assert answer.take() is None
        request.reply(b"granted")
        assert bus.until(answer.take) == b"granted"
        assert (answer.take(), take(), other()) == (None, None, None)
        assert 0 < max(woken) <= bus.clock.now_ns()

    def test_where_nobody_serves_no_answer_comes_and_nobody_waits(self, bus: Joined) -> None:
        answer = bus.a.ask(LEASE, "nobody", b"mine")
        take = bus.b.serve(LEASE, "nobody")
        assert (answer.take(), take()) == (None, None), "who serves later is not told what was asked before"
