"""The bus over Zenoh's own router on loopback: what every bus does, between two clients of one router."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing

import pytest

from robofleet.bus.keys import REQUEST, STATE, STATUS, TICK, key
from robofleet.bus.requests import asked
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from tests.bus.contract import CLOCK, BusContract, Joined, until
from tests.endpoints import own_endpoint

ROLES = "supervisor", "driver-r1", "driver-r2", "driver-nobody"


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    path = own_endpoint()
    with closing(open_router(path)):
        yield path


@pytest.fixture(scope="module")
def joined(endpoint: str) -> Iterator[Joined]:
    with ExitStack() as opened:
        a, b = ZenohBus("lab", endpoint, "a", CLOCK), ZenohBus("lab", endpoint, "b", CLOCK, roles=ROLES)
        for bus in (a, b, a, b):  # leaving is idempotent
            opened.callback(bus.close)
        yield Joined(a, b, CLOCK, until)


class TestZenohBus(BusContract):
    @pytest.fixture
    def bus(self, joined: Joined) -> Joined:
        return joined


def test_a_stream_hears_the_keys_that_were_named_and_no_other(joined: Joined, endpoint: str) -> None:
    stream = joined.b.stream(key("lab", TICK), key("lab", STATE), capacity=100)
    publishers = {"rf/lab/tick": joined.a.publisher(TICK), "rf/lab/state": joined.a.publisher(STATE)}
    with closing(ZenohBus("elsewhere", endpoint, "c", CLOCK)) as foreign:
        publish_foreign, publish_unknown = foreign.publisher(TICK), joined.a.publisher(STATUS, "nobody")
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


@pytest.mark.slow
def test_an_operator_is_answered_or_told_that_nobody_is(joined: Joined) -> None:
    take = joined.b.serve(REQUEST, "supervisor")
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(asked, joined.a, CLOCK, "supervisor", b"start")
        request = until(take)
        assert request is not None and request.payload == b"start"
        request.reply(b"armed")
        assert answer.result() == b"armed"
    with pytest.raises(TimeoutError, match="the tracker does not answer"):
        asked(joined.a, CLOCK, "tracker", b"start")
