"""The bus over Zenoh: every process a client of one router, fixed endpoints, no scouting, no listening."""

import json
import os
import resource
import threading
from collections import deque
from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, NamedTuple

import zenoh

from robofleet.bus.bus import Answer, Arrival, BySender, Publish, Request, Stream, Subscription, Wake
from robofleet.bus.credentials import Credentials
from robofleet.bus.keys import (
    ALIVE,
    ESTOP,
    LARGEST_MESSAGE,
    REQUEST,
    SAFE_REQUEST,
    TOPICS,
    Topic,
    every_key,
    key,
    largest,
    of_every_sender,
    sender_key,
    served_by,
    split,
)
from robofleet.bus.living import Living, RoleTakenError, alive_key, others, roles
from robofleet.core.clock import MS, Clock, S
from robofleet.core.patterns import QUIC

_ANSWER_WITHIN_NS = S
_MOST_WAITING_REQUESTS = 16
_MOST_ANSWERS = 16  # to one question
_GONE_WITHIN_NS = S  # the token of a process that was killed, also where its host has to notice that
_AGAIN_NS = 50 * MS
_NOBODY_SERVES_NS = 2 * S  # without a token of who is asked: its word was lost, or it is not there
_QUESTIONS_HZ = 500.0  # of a client on a key; a flood of them reaches nobody, and costs the router the least
_MOST_OPEN_FILES = 16384  # of the router, where the system allows it
_TRANSPORT = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,  # [ms]; a router waits half a second for peers, which nobody here looks for
    "transport/link/tx/lease": 500,  # [ms]; the default of 10 s would hide a stopped process for as long
    "transport/link/tx/keep_alive": 4,
    "transport/link/rx/max_message_size": LARGEST_MESSAGE,
}
# Beyond this computer: a link that is away for less goes on, and signs of life take less of the air.
_FAR = {"transport/link/tx/lease": 1000, "transport/link/tx/keep_alive": 3}
# Who connects and says nothing, or nonsense, takes nobody's place: of Zenoh's own 100, each is held for 10 s.
_DOOR = {
    "transport/unicast/accept_pending": 8192,
    "transport/unicast/accept_timeout": 1000,  # [ms]
    "transport/unicast/max_sessions": 1000,
}


# The name of a sender who is this computer's user. A certificate's name has no capital letters.
_THIS_USER = "USER"


class Network(NamedTuple):
    """How a router is reached from other hosts."""

    endpoints: Sequence[str]  # tls/HOST:PORT, quic/HOST:PORT
    credentials: Credentials  # the router's
    permitted: dict[str, Any]  # Zenoh's access_control, see permissions.py


def router_settings(endpoint: str, network: Network | None = None) -> dict[str, Any]:
    """Return Zenoh's settings of a router: whatever the table of topics does not allow goes no further."""
    settings = {
        "mode": "router", "listen/endpoints": [endpoint], "low_pass_filter": _filters(),
        "downsampling": [_questions()], **_DOOR,
    }  # fmt: skip
    if network is not None:
        settings["listen/endpoints"] = [endpoint, *map(_linked, network.endpoints)]
        settings |= {"access_control": network.permitted, **_certified(network.credentials), **_FAR}
    return _TRANSPORT | settings


def open_router(endpoint: str, network: Network | None = None) -> zenoh.Session:
    """Start Zenoh's router in this process, listening on ``endpoint``; close it in a ``finally``.

    With a ``network`` other hosts reach it too, each as far as its certificate permits.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(_MOST_OPEN_FILES, most) if most >= 0 else _MOST_OPEN_FILES, most))
    umask = os.umask(0o077)  # the socket's mode
    try:
        return _open(router_settings(endpoint, network))
    finally:
        os.umask(umask)


def _linked(endpoint: str) -> str:
    """Return the endpoint with what Zenoh must know of the link: QUIC also carries datagrams, which nobody resends."""
    return f"{endpoint}?mixed_rel=1" if endpoint.startswith(QUIC) else endpoint


def _certified(own: Credentials) -> dict[str, Any]:
    """Return the settings of mutual TLS: both ends show a certificate of the arena's authority, or there is no link."""
    certificate, private = str(own.certificate), str(own.key)
    return {
        "transport/link/tls": {
            "root_ca_certificate": str(own.authority),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
            **{f"{end}_certificate": certificate for end in ("listen", "connect")},
            **{f"{end}_private_key": private for end in ("listen", "connect")},
        }
    }


def _filters() -> list[dict[str, Any]]:
    return [
        {
            "id": topic.key,
            "flows": ["ingress"],
            "messages": ["put", "delete", "query", "reply"],
            "key_exprs": [every_key("*", topic, "*")],
            "size_limit": topic.largest,
        }
        for topic in TOPICS
        if topic is not ALIVE
    ]


def _questions() -> dict[str, Any]:
    rules = [{"key_expr": key("*", topic, "*"), "freq": _QUESTIONS_HZ} for topic in (REQUEST, SAFE_REQUEST)]
    return {"id": "requests", "messages": ["query"], "flows": ["ingress"], "rules": rules}


class ZenohBus:
    """A client of the router; close it in a ``finally``: an open session keeps the interpreter from exiting.

    ``roles`` are names that one process at a time has, by which others know whose answer they may believe;
    RoleTakenError where another has one. A process without a role is known as ``process``.
    """

    def __init__(
        self, arena: str, endpoint: str | Sequence[str], process: str, clock: Clock, *, roles: Sequence[str] = (),
        credentials: Credentials | None = None, session: str | None = None,
    ) -> None:  # fmt: skip
        """Join; waits for the router for ever. Another host has ``credentials``, and a ``session``: its Zenoh ID."""
        self._arena, self._clock = arena, clock
        self._closed = False
        self._declared: list[Any] = []  # of this part of the session, beside its tokens
        self._whole = True
        self._living: dict[str, tuple[Living, int]] = {}  # those that this process asks, and since when [ns]
        endpoints = [endpoint] if isinstance(endpoint, str) else endpoint
        self._session = _open(
            {
                **_TRANSPORT,
                **({} if credentials is None else _certified(credentials) | _FAR),
                **({} if session is None else {"id": session}),
                "mode": "client",
                "connect/endpoints": [*map(_linked, endpoints)],
                "listen/endpoints": [],
                "connect/timeout_ms": -1,
                "connect/exit_on_failure": False,
                "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
            }
        )
        name = _THIS_USER if credentials is None else credentials.name
        self._sender = f"{process}/{name}/{self._session.info.zid()}"
        self._tokens: list[Any] = []
        try:
            for role in roles:
                self._wait_for(role)
            self._tokens = [self._token(name) for name in roles or (process,)]
            for role in roles:  # two that began in the same moment have seen each other only now
                self._wait_for(role)
        except BaseException:
            self.close()
            raise

    def _token(self, name: str) -> Any:
        return self._session.liveliness().declare_token(alive_key(self._arena, name, self._session))

    def _wait_for(self, role: str) -> None:
        """Return when no other process has a role; RoleTakenError if one keeps it."""
        deadline_ns = self._clock.now_ns() + _GONE_WITHIN_NS
        while living := others(self._session, self._arena, role):
            if self._clock.now_ns() > deadline_ns:
                raise RoleTakenError(self._arena, role, living)
            self._clock.sleep_until(self._clock.now_ns() + _AGAIN_NS)

    def publisher(self, topic: Topic, name: str = "") -> Publish:
        """Return the function that publishes on a topic; it never blocks."""
        publisher = self._declare(self._session.declare_publisher)(
            sender_key(self._arena, topic, name, self._sender) if topic.by_sender else key(self._arena, topic, name),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=getattr(zenoh.Priority, topic.priority),
            reliability=zenoh.Reliability.RELIABLE if topic.reliable else zenoh.Reliability.BEST_EFFORT,
        )

        def publish(payload: bytes) -> None:
            publisher.put(payload)

        return publish

    def newest(self, topic: Topic, name: str = "", wake: Wake | None = None) -> Subscription:
        full = every_key(self._arena, topic, name)
        if wake is not None:
            return _Slot(self._declare(self._session.declare_subscriber), full, wake, self._clock)
        ring = self._declare(self._session.declare_subscriber)(full, zenoh.handlers.RingChannel(1))
        return _Ring(ring, topic.largest)

    def newest_by_sender(self, topic: Topic, name: str) -> BySender:
        senders = BySender(_Newest)
        self.listen_by_sender(topic, name, senders.put)
        return senders

    def listen_by_sender(self, topic: Topic, name: str, put: Callable[[str, int, bytes], None]) -> None:
        """Call ``put`` of every message, from Zenoh's own thread; the router vouches for who sent it.

        What is published on an expression of many keys names no sender, and is dropped.
        """

        def arrived(full: str, at_ns: int, payload: bytes) -> None:
            if sender := split(full)[1]:
                put(sender, at_ns, payload)

        self._listen(topic, name, arrived)

    def listen(self, topic: Topic, name: str, put: Callable[[int, bytes], None]) -> None:
        """Call ``put`` of every message, from Zenoh's own thread."""
        self._listen(topic, name, lambda _, at_ns, payload: put(at_ns, payload))

    def _listen(self, topic: Topic, name: str, put: Callable[[str, int, bytes], None]) -> None:
        def arrived(sample: zenoh.Sample) -> None:
            if len(sample.payload) <= topic.largest:
                put(str(sample.key_expr), self._clock.now_ns(), bytes(sample.payload))

        full = every_key(self._arena, topic, name)
        callback = zenoh.handlers.Callback(arrived, indirect=False)
        self._declare(self._session.declare_subscriber)(full, callback)

    def stream(self, *expressions: str, capacity: int) -> Stream:
        """Subscribe to keys, or to expressions of one topic each: a key that nobody named comes to nobody."""
        return _Stream(self._declare(self._session.declare_subscriber), expressions, capacity, self._clock)

    def serve(self, topic: Topic, name: str, wake: Wake | None = None) -> Callable[[], Request | None]:
        """Return the function that takes the next request on a topic; nothing takes the place of an emergency stop."""
        stops, others = (deque[_ZenohRequest](maxlen=_MOST_WAITING_REQUESTS) for _ in range(2))

        def put(query: zenoh.Query) -> None:
            if query.payload is not None and len(query.payload) > topic.largest:
                return
            request = _ZenohRequest(query)
            (stops if request.payload == ESTOP else others).append(request)
            if wake is not None:
                wake(self._clock.now_ns())

        full = key(self._arena, topic, name)
        self._declare(self._session.declare_queryable)(full, zenoh.handlers.Callback(put, indirect=False))

        def take() -> Request | None:
            return stops.popleft() if stops else others.popleft() if others else None

        return take

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        """Send a request, once: to all who say that they serve it, so that none keeps it from the others."""
        answer = _ZenohAnswer(self._who_serves(served_by(topic, name)), topic.largest)
        self._session.get(
            key(self._arena, topic, name),
            zenoh.handlers.Callback(answer.put, indirect=False),  # a RingChannel's answer is gone with its query
            payload=payload,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_ANSWER_WITHIN_NS / S,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=getattr(zenoh.Priority, topic.priority),
        )
        return answer

    def _who_serves(self, server: str) -> Living:
        """Return who has a role; who was not found for long is looked for anew: a busy machine loses the first word."""
        now_ns = self._clock.now_ns()
        living, since_ns = self._living.get(server, (None, 0))
        if living is None or (not living.ids and now_ns - since_ns > _NOBODY_SERVES_NS):
            living = Living(self._session, self._arena, server)
            self._living[server] = living, now_ns
        return living

    def roles(self) -> set[str]:
        return roles(self._session, self._arena)

    def part(self) -> "ZenohBus":
        """Return this bus once more; when that one is closed, what it declared is gone, and this one goes on."""
        part = copy(self)
        part._declared, part._whole = [], False
        return part

    def close(self) -> None:
        """Leave the bus. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._whole:
            self._session.close()  # type: ignore[no-untyped-call]
            return
        for declared in self._declared:
            declared.undeclare()

    def _declare(self, declare: Callable[..., Any]) -> Callable[..., Any]:
        """Return what declares something, and keeps it until this is closed."""

        def declared(*what: Any, **how: Any) -> Any:
            self._declared.append(declare(*what, **how))
            return self._declared[-1]

        return declared


class _Ring:
    arrival_ns = 0

    def __init__(self, subscriber: Any, most: int) -> None:
        self._try_recv = subscriber.try_recv
        self._subscriber, self._most = subscriber, most

    def take(self) -> bytes | None:
        newest = None
        while (sample := self._try_recv()) is not None:
            newest = sample
        return None if newest is None or len(newest.payload) > self._most else bytes(newest.payload)


class _Newest:
    """Newest message, put here by Zenoh's own thread."""

    def __init__(self) -> None:
        self._newest: deque[tuple[int, bytes]] = deque(maxlen=1)
        self.arrival_ns = 0

    def put(self, arrival_ns: int, payload: bytes) -> None:
        self._newest.append((arrival_ns, payload))

    def take(self) -> bytes | None:
        if not self._newest:
            return None
        self.arrival_ns, payload = self._newest.pop()
        return payload


class _Slot(_Newest):
    """Newest message, written by Zenoh's own thread, which then wakes the process."""

    def __init__(self, declare: Callable[..., Any], full: str, wake: Wake, clock: Clock) -> None:
        super().__init__()
        most = largest(full)

        def put(sample: zenoh.Sample) -> None:
            if len(sample.payload) > most:
                return
            arrival_ns = clock.now_ns()
            self.put(arrival_ns, bytes(sample.payload))
            wake(arrival_ns)

        self._subscriber = declare(full, zenoh.handlers.Callback(put, indirect=False))


class _Stream:
    """Everything that came, put there by Zenoh's own thread: a RingChannel would drop without a word."""

    def __init__(self, declare: Callable[..., Any], expressions: Sequence[str], capacity: int, clock: Clock) -> None:
        self._clock, self._capacity = clock, capacity
        self._lock = threading.Lock()  # held for some hundred nanoseconds
        self._samples: deque[tuple[int, zenoh.Sample]] = deque(maxlen=capacity)
        self.dropped = 0
        self._subscribers = [
            declare(full, zenoh.handlers.Callback(self._put_of(largest(full)), indirect=False))
            for full in map(of_every_sender, expressions)
        ]

    def _put_of(self, most: int) -> Callable[[zenoh.Sample], None]:
        def put(sample: zenoh.Sample) -> None:
            if len(sample.payload) <= most:
                with self._lock:
                    self.dropped += len(self._samples) == self._capacity
                    self._samples.append((self._clock.now_ns(), sample))

        return put

    def drain(self) -> list[Arrival]:
        with self._lock:
            samples, self._samples = self._samples, deque(maxlen=self._capacity)
        return [
            Arrival(at_ns, full, bytes(sample.payload))
            for at_ns, sample in samples
            if "*" not in (full := str(sample.key_expr))  # Zenoh also lets publish on an expression of many keys
        ]


class _ZenohAnswer:
    """What was answered by the one process that has the role; what others answer is not believed."""

    def __init__(self, living: Living, most: int) -> None:
        self._living, self._most = living, most
        self._answers: dict[str, bytes] = {}  # by who gave it
        self._taken = False

    def put(self, reply: zenoh.Reply) -> None:
        """Keep it; called by Zenoh's own thread."""
        if reply.ok is None or reply.replier_id is None or len(reply.ok.payload) > self._most:
            return
        if len(self._answers) < _MOST_ANSWERS:
            self._answers.setdefault(str(reply.replier_id.zid), bytes(reply.ok.payload))

    def take(self) -> bytes | None:
        """Return the answer, once; None while there is none that can be believed."""
        living = self._living.ids
        if self._taken or len(living) != 1:
            return None
        answer = self._answers.get(next(iter(living)))
        self._taken = answer is not None
        return answer

    @property
    def doubt(self) -> str:
        """Why what was answered is not believed; empty while nothing was."""
        return self._living.doubt if self._answers and not self._taken else ""


class _ZenohRequest:
    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.payload = b"" if query.payload is None else bytes(query.payload)

    def reply(self, payload: bytes) -> None:
        self._query.reply(self._query.key_expr, payload)
        self._query.drop()  # type: ignore[no-untyped-call] # the answer is delivered when the query ends


def _open(settings: dict[str, Any]) -> zenoh.Session:
    config = zenoh.Config()
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)
