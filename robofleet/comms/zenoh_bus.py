"""The bus over Zenoh: every process a client of one router, fixed endpoints, no scouting, no listening."""

import json
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import zenoh

from robofleet.clock import Clock, S
from robofleet.comms.bus import Answer, Arrival, Publish, Request, Stream, Subscription, Wake
from robofleet.comms.keys import ALIVE, Topic, key

_ANSWER_WITHIN_NS = S
_REQUESTS = 16  # that wait to be served
_TRANSPORT = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/lease": 500,  # [ms]; the default of 10 s would hide a stopped process for as long
    "transport/link/tx/keep_alive": 4,
}


def open_router(endpoint: str) -> zenoh.Session:
    """Start Zenoh's router in this process, listening on ``endpoint``; close it in a ``finally``."""
    return _open({"mode": "router", "listen/endpoints": [endpoint]})


class ZenohBus:
    """A client of the router; close it in a ``finally``: an open session keeps the interpreter from exiting."""

    def __init__(self, arena: str, endpoint: str, process: str, clock: Clock) -> None:
        self._arena, self._clock = arena, clock
        self._closed = False
        self._queryables: list[Any] = []
        self._listeners: list[Any] = []
        self._session = _open(
            {
                "mode": "client",
                "connect/endpoints": [endpoint],
                "listen/endpoints": [],
                "connect/timeout_ms": -1,
                "connect/exit_on_failure": False,
                "connect/retry": {
                    "period_init_ms": 100,
                    "period_max_ms": 500,
                    "period_increase_factor": 1.5,
                },
            }
        )
        name = f"{process}/{self._session.info.zid()}"
        self._token = self._session.liveliness().declare_token(key(arena, ALIVE, name))

    def publisher(self, topic: Topic, name: str = "") -> Publish:
        """Return the function that publishes on a topic; it never blocks."""
        publisher = self._session.declare_publisher(
            key(self._arena, topic, name),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=getattr(zenoh.Priority, topic.priority),
            reliability=zenoh.Reliability.RELIABLE if topic.reliable else zenoh.Reliability.BEST_EFFORT,
        )

        def publish(payload: bytes) -> None:
            publisher.put(payload)

        return publish

    def newest(self, topic: Topic, name: str = "", wake: Wake | None = None) -> Subscription:
        """Subscribe to a topic."""
        full = key(self._arena, topic, name)
        if wake is not None:
            return _Slot(self._session, full, wake, self._clock)
        return _Ring(self._session.declare_subscriber(full, zenoh.handlers.RingChannel(1)))

    def listen(self, topic: Topic, name: str, put: Callable[[int, bytes], None]) -> None:
        """Call ``put`` of every message, from Zenoh's own thread."""

        def arrived(sample: zenoh.Sample) -> None:
            put(self._clock.now_ns(), bytes(sample.payload))

        full = key(self._arena, topic, name)
        callback = zenoh.handlers.Callback(arrived, indirect=False)
        self._listeners.append(self._session.declare_subscriber(full, callback))

    def stream(self, expression: str, capacity: int) -> Stream:
        """Subscribe to everything that matches a key expression."""
        return _Stream(self._session, expression, capacity, self._clock)

    def serve(self, topic: Topic, name: str, wake: Wake | None = None) -> Callable[[], Request | None]:
        """Return the function that takes the next request on a topic."""
        waiting: deque[zenoh.Query] = deque(maxlen=_REQUESTS)

        def put(query: zenoh.Query) -> None:
            waiting.append(query)
            if wake is not None:
                wake(self._clock.now_ns())

        full = key(self._arena, topic, name)
        self._queryables.append(self._session.declare_queryable(full, zenoh.handlers.Callback(put, indirect=False)))

        def take() -> Request | None:
            return _ZenohRequest(waiting.popleft()) if waiting else None

        return take

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        """Send a request, once."""
        answer = _ZenohAnswer()
        self._session.get(
            key(self._arena, topic, name),
            zenoh.handlers.Callback(answer.put, indirect=False),  # a RingChannel's answer is gone with its query
            payload=payload,
            timeout=_ANSWER_WITHIN_NS / S,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=getattr(zenoh.Priority, topic.priority),
        )
        return answer

    def close(self) -> None:
        """Leave the bus. Idempotent."""
        if not self._closed:
            self._closed = True
            self._session.close()  # type: ignore[no-untyped-call]


class _Ring:
    arrival_ns = 0

    def __init__(self, subscriber: Any) -> None:
        self._try_recv = subscriber.try_recv
        self._subscriber = subscriber

    def take(self) -> bytes | None:
        newest = None
        while (sample := self._try_recv()) is not None:
            newest = sample
        return None if newest is None else bytes(newest.payload)


class _Slot:
    """Newest message, written by Zenoh's own thread, which then wakes the process."""

    def __init__(self, session: zenoh.Session, full: str, wake: Wake, clock: Clock) -> None:
        self._newest: deque[tuple[int, bytes]] = deque(maxlen=1)
        self.arrival_ns = 0

        def put(sample: zenoh.Sample) -> None:
            arrival_ns = clock.now_ns()
            self._newest.append((arrival_ns, bytes(sample.payload)))
            wake(arrival_ns)

        self._subscriber = session.declare_subscriber(full, zenoh.handlers.Callback(put, indirect=False))

    def take(self) -> bytes | None:
        if not self._newest:
            return None
        self.arrival_ns, payload = self._newest.pop()
        return payload


class _Stream:
    """Everything that came, put there by Zenoh's own thread: a RingChannel would drop without a word."""

    def __init__(self, session: zenoh.Session, expression: str, capacity: int, clock: Clock) -> None:
        self._clock, self._capacity = clock, capacity
        self._lock = threading.Lock()  # held for some hundred nanoseconds
        self._samples: deque[tuple[int, zenoh.Sample]] = deque(maxlen=capacity)
        self.dropped = 0
        callback = zenoh.handlers.Callback(self._put, indirect=False)
        self._subscriber = session.declare_subscriber(expression, callback)

    def _put(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.dropped += len(self._samples) == self._capacity
            self._samples.append((self._clock.now_ns(), sample))

    def drain(self) -> list[Arrival]:
        with self._lock:
            samples, self._samples = self._samples, deque(maxlen=self._capacity)
        return [Arrival(at_ns, str(sample.key_expr), bytes(sample.payload)) for at_ns, sample in samples]


class _ZenohAnswer:
    def __init__(self) -> None:
        self._answers: deque[bytes] = deque(maxlen=1)

    def put(self, reply: zenoh.Reply) -> None:
        """Keep it; called by Zenoh's own thread."""
        if reply.ok is not None:
            self._answers.append(bytes(reply.ok.payload))

    def take(self) -> bytes | None:
        return self._answers.pop() if self._answers else None


class _ZenohRequest:
    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.payload = b"" if query.payload is None else bytes(query.payload)

    def reply(self, payload: bytes) -> None:
        """Answer it."""
        self._query.reply(self._query.key_expr, payload)
        self._query.drop()  # type: ignore[no-untyped-call] # the answer is delivered when the query ends


def _open(settings: dict[str, Any]) -> zenoh.Session:
    config = zenoh.Config()
    for name, value in (settings | _TRANSPORT).items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)
