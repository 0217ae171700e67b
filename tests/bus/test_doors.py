"""Who may not drive, cannot; who answers in another's name is not believed; what is too large goes no further."""

import json
import os
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from robofleet.bus.bus import Request
from robofleet.bus.keys import (
    ESTOP,
    LEASE,
    PICTURE,
    QUERIES,
    REQUEST,
    SAFE_REQUEST,
    STATE,
    STATUS,
    TOPICS,
    Topic,
    key,
    sender_key,
)
from robofleet.bus.living import RoleTakenError, alive_key
from robofleet.bus.requests import asked, on
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.core.clock import MS, S
from tests.bus.contract import CLOCK, answering, until
from tests.endpoints import free_port, own_endpoint, short_folder

SENDER = "operator/anna/1"


def session(endpoint: str, mode: str = "client") -> zenoh.Session:
    """Return a stranger's session: it knows Zenoh, and the endpoint."""
    config = zenoh.Config()
    where = "connect/endpoints" if mode == "client" else "listen/endpoints"
    given = {"mode": mode, where: [endpoint], "scouting/multicast/enabled": False, "scouting/delay": 0}
    for name, value in given.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


class Bus:
    """A router; an operator, a supervisor and a stranger on it."""

    def __init__(self, endpoint: str, stack: ExitStack, *, lax: bool = False) -> None:
        self.endpoint = endpoint
        router = session(endpoint, "router") if lax else open_router(endpoint)
        stack.callback(router.close)
        self.supervisor = ZenohBus("lab", endpoint, "supervisor", CLOCK, roles=("supervisor", "driver-r1"))
        stack.callback(self.supervisor.close)
        self.operator = ZenohBus("lab", endpoint, "operator", CLOCK)
        stack.callback(self.operator.close)
        self.stranger = session(endpoint)
        stack.callback(self.stranger.close)
        self.probe = session(endpoint)
        stack.callback(self.probe.close)

    def forge(self, full: str, reply: bytes | None, requests: list[bytes]) -> Any:
        """Let the stranger answer a key as the only one who is asked; without a reply it swallows what it hears."""

        def put(query: zenoh.Query) -> None:
            requests.append(b"" if query.payload is None else bytes(query.payload))
            if reply is not None:
                query.reply(query.key_expr, reply)
            held.append(query)  # it is never ended

        held: list[zenoh.Query] = []
        return self.stranger.declare_queryable(full, zenoh.handlers.Callback(put, indirect=False), complete=True)


@pytest.fixture
def bus() -> Iterator[Bus]:
    with ExitStack() as stack:
        yield Bus(own_endpoint(), stack)


@pytest.fixture(params=[False, True], ids=["router", "receiver"])
def bounding(request: pytest.FixtureRequest) -> Iterator[Bus]:
    """Return a bus whose router bounds what passes, and one where the receivers are left to themselves."""
    with ExitStack() as stack:
        yield Bus(own_endpoint(), stack, lax=request.param)


def serving(bus: ZenohBus) -> Callable[[], Request | None]:
    """Return what takes the next request, whoever may ask for it."""
    safe, other = (bus.serve(topic, "supervisor") for topic in (SAFE_REQUEST, REQUEST))
    return lambda: safe() or other()


def ask(bus: ZenohBus, serve: Callable[[], None], what: bytes = b"hold") -> bytes:
    return asked(bus, CLOCK, "supervisor", what, serve)


@pytest.mark.parametrize("what", [b"hold", b"stop", b"estop"])
@pytest.mark.parametrize("forged", [None, b"ok"])
def test_a_stranger_who_answers_for_the_supervisor_is_not_believed(bus: Bus, what: bytes, forged: bytes | None) -> None:
    """Nor does he keep the request from it, by saying that he alone knows all answers."""
    stolen: list[bytes] = []
    requests: list[bytes] = []
    _held = bus.forge(key("lab", on(what), "supervisor"), forged, stolen)
    serve = answering(serving(bus.supervisor), requests, b"refused: so says the supervisor")
    for _ in range(5):
        stolen.clear()
        requests.clear()
        assert ask(bus.operator, serve, what) == b"refused: so says the supervisor"
        assert set(requests) == {what}


@pytest.mark.parametrize("what", [b"hold", b"status", b"resume", b"estop"])
def test_a_flood_of_those_who_may_only_look_takes_no_place_of_an_operators_request(bus: Bus, what: bytes) -> None:
    """Nor of anybody's emergency stop."""
    arrived: list[int] = []
    topic = SAFE_REQUEST if what == ESTOP else on(what)
    takes = {
        request_topic: bus.supervisor.serve(request_topic, "supervisor", arrived.append)
        for request_topic in (SAFE_REQUEST, REQUEST)
    }
    until(lambda: arrived, lambda: bus.operator.ask(topic, "supervisor", what))
    before, flood = len(arrived), key("lab", SAFE_REQUEST, "supervisor")
    until(lambda: len(arrived) > before + 40, lambda: bus.probe.get(flood, lambda _: None, payload=b"hold"))
    request = takes[topic]()
    assert request is not None and request.payload == what
    waiting = [request for _ in range(100) if (request := takes[SAFE_REQUEST]()) is not None]
    assert {request.payload for request in waiting} <= {b"hold", ESTOP}
    assert len(waiting) <= 32, "no flood fills the memory"


@pytest.mark.slow
def test_where_the_supervisor_is_silent_a_strangers_answer_is_named_and_not_believed(bus: Bus) -> None:
    stolen: list[bytes] = []
    _held = bus.forge(key("lab", on(b"hold"), "supervisor"), b"ok", stolen)
    with pytest.raises(TimeoutError, match=r"does not answer.*another client answered in place of the supervisor"):
        ask(bus.operator, lambda: None)
    assert stolen


@pytest.mark.slow
def test_of_two_who_call_themselves_supervisor_none_is_believed_but_the_request_arrives(bus: Bus) -> None:
    requests: list[bytes] = []
    queryable = bus.forge(key("lab", on(b"hold"), "supervisor"), b"ok", [])
    token = bus.stranger.liveliness().declare_token(alive_key("lab", "supervisor", bus.stranger))
    until(lambda: len(there(bus)) == 2 or None)
    serve = answering(serving(bus.supervisor), requests, b"ok")
    with pytest.raises(TimeoutError, match="several processes claim to be the supervisor, so none is believed"):
        ask(bus.operator, serve)
    assert set(requests) == {b"hold"}
    token.undeclare()
    queryable.undeclare()
    until(lambda: len(there(bus)) == 1 or None)
    assert ask(bus.operator, serve) == b"ok"


def there(bus: Bus) -> list[str]:
    replies = bus.probe.liveliness().get("rf/lab/alive/supervisor/**")
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def test_a_lease_is_asked_of_the_driver_whoever_else_listens(bus: Bus) -> None:
    requests: list[bytes] = []
    _held = bus.forge(key("lab", LEASE, "r1"), b"granted", [])
    serve = answering(bus.supervisor.serve(LEASE, "r1"), requests, b"mine")
    answers: list[Any] = []

    def again() -> None:  # the first ones may find no route yet
        answers.append(bus.operator.ask(LEASE, "r1", b"please"))
        serve()

    assert until(lambda: next((reply for answer in answers if (reply := answer.take())), None), again) == b"mine"
    assert set(requests) == {b"please"}


@pytest.mark.slow
def test_a_process_that_is_there_twice_is_refused_and_the_first_is_left_alone(bus: Bus) -> None:
    with pytest.raises(RoleTakenError, match=rf"the arena lab has a supervisor already \(process {os.getpid()}\)"):
        ZenohBus("lab", bus.endpoint, "supervisor", CLOCK, roles=("supervisor",))
    with pytest.raises(RoleTakenError, match="has a driver-r1 already"):
        ZenohBus("lab", bus.endpoint, "driver-r0", CLOCK, roles=("driver-r0", "driver-r1"))
    ZenohBus("hall", bus.endpoint, "supervisor", CLOCK, roles=("supervisor",)).close()  # another arena
    serve = answering(serving(bus.supervisor), [], b"ok")
    assert ask(bus.operator, serve) == b"ok"
    bus.supervisor.close()
    ZenohBus("lab", bus.endpoint, "supervisor", CLOCK, roles=("supervisor",)).close()  # the place is free again


def about(topic: Topic) -> str:
    return {REQUEST: "supervisor", PICTURE: "overhead"}.get(topic, "r1")


def full_key(topic: Topic) -> str:
    return sender_key("lab", topic, about(topic), SENDER) if topic.by_sender else key("lab", topic, about(topic))


BOUNDED = [topic for topic in TOPICS if topic.largest and topic not in QUERIES]


@pytest.mark.slow_after_first
@pytest.mark.parametrize("topic", BOUNDED, ids=lambda t: t.key)
def test_a_message_that_is_larger_than_its_topic_allows_comes_to_nobody(bounding: Bus, topic: Topic) -> None:
    bus, name, full, listened, streamed = bounding, about(topic), full_key(topic), list[bytes](), set[bytes]()
    stream = bus.operator.stream(key("lab", topic, name), capacity=10_000)
    newest: Any = bus.operator.newest_by_sender(topic, name) if topic.by_sender else bus.operator.newest(topic, name)
    slot: Any = newest
    if topic.by_sender:
        bus.operator.listen_by_sender(topic, name, lambda _sender, _at_ns, payload: listened.append(payload))
    else:
        slot = bus.operator.newest(topic, name, lambda _: None)
        bus.operator.listen(topic, name, lambda _, payload: listened.append(payload))
    allowed, too_large = bytes(topic.largest), bytes(topic.largest + 1)
    until(newest.take, lambda: bus.stranger.put(full, allowed))
    for payload in (too_large, bytes(20_000_000), too_large, b"end"):
        bus.stranger.put(full, payload, congestion_control=zenoh.CongestionControl.BLOCK)
    until(lambda: b"end" in listened)
    until(lambda: b"end" in streamed or streamed.update(payload for _, _, payload in stream.drain()))
    assert set(listened) == streamed == {allowed, b"end"}
    assert slot.take() in (None, b"end", [], [(SENDER, allowed)], [(SENDER, b"end")])


def test_the_router_itself_passes_on_nothing_that_is_larger_than_its_topic_allows(bus: Bus) -> None:
    """Whoever listens: these do not look at lengths."""
    received: list[tuple[str, int]] = []
    subscriber = bus.probe.declare_subscriber(
        "rf/**", zenoh.handlers.Callback(lambda s: received.append((str(s.key_expr), len(s.payload))), indirect=False)
    )
    asked_for: list[bytes] = []
    _held = bus.forge(key("lab", REQUEST, "supervisor"), b"ok", asked_for)
    mark = key("lab", STATE)
    until(lambda: received, lambda: bus.stranger.put(mark, b"x"))
    expected = set()
    for topic in BOUNDED:
        full = full_key(topic)
        for size in (topic.largest + 1, topic.largest):
            bus.stranger.put(full, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
        expected.add((full, topic.largest))
    request = key("lab", REQUEST, "supervisor")
    bus.supervisor._session.get(request, lambda _: None, payload=bytes(REQUEST.largest + 1))
    until(lambda: (mark, 3) in received or None, lambda: bus.stranger.put(mark, b"end"))
    until(
        lambda: asked_for, lambda: bus.supervisor._session.get(request, lambda _: None, payload=bytes(REQUEST.largest))
    )
    assert set(received) - {(mark, 1), (mark, 3)} == expected
    assert {len(payload) for payload in asked_for} == {REQUEST.largest}
    subscriber.undeclare()


@pytest.mark.slow_after_first
@pytest.mark.parametrize("size", [REQUEST.largest + 1, 40_000_000])
def test_a_request_that_is_too_large_keeps_nobody_from_the_supervisor(bounding: Bus, size: int) -> None:
    bus = bounding
    requests: list[bytes] = []
    serve = answering(serving(bus.supervisor), requests, b"ok")
    assert ask(bus.operator, serve) == b"ok"
    for _ in range(3):
        bus.stranger.get(key("lab", REQUEST, "supervisor"), lambda _: None, payload=bytes(size))
    before_ns = CLOCK.now_ns()
    assert ask(bus.operator, serve, b"resume") == b"ok"
    assert CLOCK.now_ns() - before_ns < 2 * S
    assert set(requests) == {b"hold", b"resume"}


def test_keys_that_nobody_knows_come_to_nobody(bus: Bus) -> None:
    known = [key("lab", STATE), key("lab", STATUS, "r1")]
    stream = bus.operator.stream(*known, capacity=100_000)
    marks = bus.operator.newest(STATE)
    until(marks.take, lambda: bus.stranger.put(known[0], b"x"))
    for k in range(2000):
        bus.stranger.put(f"rf/lab/unit/x{k}/status", b"x", congestion_control=zenoh.CongestionControl.BLOCK)
    until(lambda: marks.take() == b"end" or None, lambda: bus.stranger.put(known[0], b"end"))
    assert {full for _, full, _ in stream.drain()} == {known[0]}


@pytest.mark.parametrize("garbage", [False, True], ids=["idle", "garbage"])
@pytest.mark.parametrize("tcp", [False, True], ids=["socket", "tcp"])
def test_hold_and_stop_are_answered_while_strangers_hold_the_door(tcp: bool, garbage: bool) -> None:
    """Connections that say nothing, or nonsense, more than Zenoh itself waits for."""
    count = 200 if garbage else 300
    with ExitStack() as stack:
        bus = Bus(f"tcp/127.0.0.1:{free_port()}" if tcp else own_endpoint(), stack)
        serve = answering(serving(bus.supervisor), [], b"ok")
        for _ in range(count):
            stack.enter_context(connected(bus.endpoint, os.urandom(2000) if garbage else b""))
        for what in (b"hold", b"stop"):
            late: list[ZenohBus] = []  # as `robofleet hold` comes, when they are there already
            threading.Thread(target=join, args=(bus.endpoint, late), daemon=True).start()
            (operator,) = until(late.copy)
            stack.callback(operator.close)
            assert ask(operator, serve, what) == b"ok"


def join(endpoint: str, joined: list[ZenohBus]) -> None:
    """Join; it may never come back."""
    joined.append(ZenohBus("lab", endpoint, "operator", CLOCK))


def connected(endpoint: str, greeting: bytes) -> socket.socket:
    protocol, _, address = endpoint.partition("/")
    connection = socket.socket(socket.AF_INET if protocol == "tcp" else socket.AF_UNIX)
    if protocol == "tcp":
        host, _, port = address.rpartition(":")
        connection.connect((host, int(port)))
    else:
        connection.connect(address)
    if greeting:
        connection.sendall(greeting)
    return connection


def test_the_socket_is_its_owners_alone_whatever_the_umask() -> None:
    endpoint = own_endpoint()
    before = os.umask(0)
    try:
        router = open_router(endpoint)
    finally:
        assert os.umask(before) == 0, "the umask is left as it was"
    try:
        assert stat.S_IMODE(Path(endpoint.partition("/")[2]).stat().st_mode) == 0o700
    finally:
        router.close()


def test_a_socket_that_a_killed_router_left_is_taken_over_and_one_that_is_served_is_not() -> None:
    path = short_folder() / "bus.sock"
    endpoint = f"unixsock-stream/{path}"
    opened = f"from robofleet.bus.zenoh_bus import open_router; session = open_router({endpoint!r})"
    code = f"import os; {opened}; os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code], check=False)
    assert path.exists()
    router = open_router(endpoint)
    try:
        with pytest.raises(zenoh.ZError):
            open_router(endpoint)
        ZenohBus("lab", endpoint, "a", CLOCK).close()
    finally:
        router.close()
    CLOCK.sleep_until(CLOCK.now_ns() + MS)


@pytest.mark.slow
def test_a_flood_of_requests_reaches_nobody_and_another_clients_request_is_heard(bus: Bus) -> None:
    requests: list[bytes] = []
    request = key("lab", REQUEST, "supervisor")
    _held = bus.forge(request, b"ok", requests)
    until(lambda: requests, lambda: bus.supervisor._session.get(request, lambda _: None, payload=b"first"))
    requests.clear()
    began_ns, sent = CLOCK.now_ns(), 3000
    for _ in range(sent):
        bus.probe.get(request, lambda _: None, payload=b"flood")
    until(
        lambda: b"hold" in requests or None,
        lambda: bus.supervisor._session.get(request, lambda _: None, payload=b"hold"),
    )
    lasted_s = (CLOCK.now_ns() - began_ns) / S
    assert requests.count(b"flood") <= 500.0 * lasted_s + 2, "of one client, 500 a second"
    assert requests.count(b"flood") < sent
