"""One bus, two ways to carry it: Zenoh between processes, memory inside a lockstep run.

Subscribers on the control path keep the newest message only; a stream keeps a bounded number and drops the oldest.
Publishing never blocks.
"""

from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar

from robofleet.bus.keys import Topic, key
from robofleet.core.clock import Clock

M = TypeVar("M")

_WAITING_REQUESTS = 16  # of them wait to be served, at most
_SESSIONS = 8  # of one sender, by its role and name, whose messages are kept

Publish = Callable[[bytes], None]
Wake = Callable[[int], None]  # called with the instant [ns] when a message arrives


class Subscription(Protocol):
    """Messages of one key that arrived and were not taken yet."""

    arrival_ns: int  # of the message taken last; known to those who are woken

    def take(self) -> bytes | None:
        """Return the newest message, or None if nothing new came."""


class Queue(Subscription, Protocol):
    """A subscription that is fed from outside."""

    def put(self, arrival_ns: int, payload: bytes) -> None:
        """Take a message that arrives."""


class BySender:
    """The newest message of each sender: none overwrites another's, and none takes another's place."""

    def __init__(self, queue: Callable[[], Queue]) -> None:
        """``queue`` makes the subscription of one sender's messages."""
        self._queue = queue
        self._queues: dict[str, Queue] = {}

    def put(self, sender: str, arrival_ns: int, payload: bytes) -> None:
        """Take a message that arrives, from any thread but always the same."""
        queue = self._queues.get(sender)
        if queue is None:
            owner = sender.rpartition("/")[0]
            sessions = [session for session in self._queues if session.rpartition("/")[0] == owner]
            superseded = sessions[0] if len(sessions) >= _SESSIONS else None
            queue = self._queue()
            kept = {session: self._queues[session] for session in self._queues if session != superseded}
            self._queues = kept | {sender: queue}  # another one: ``take`` may be reading it
        queue.put(arrival_ns, payload)

    def take(self) -> list[tuple[str, bytes]]:
        """Return sender and message of everybody who sent something new."""
        return [(sender, payload) for sender, queue in self._queues.items() if (payload := queue.take()) is not None]


class Arrival(NamedTuple):
    """A message of a stream."""

    at_ns: int  # when it came
    key: str  # with the sender, where the topic has a key for each: ``keys.split``
    payload: bytes


class Stream(Protocol):
    """All messages of a key expression, oldest first."""

    dropped: int  # so far, because the stream was full

    def drain(self) -> list[Arrival]:
        """Return everything that came since the last call."""


class Request(Protocol):
    """Something that is asked of a process."""

    payload: bytes

    def reply(self, payload: bytes) -> None:
        """Answer it."""


class Answer(Protocol):
    """An answer that is awaited, from the process that was asked and from nobody else."""

    @property
    def doubt(self) -> str:
        """Why what was answered is not believed; empty while nothing was."""

    def take(self) -> bytes | None:
        """Return the answer, once; None while there is none."""


class Bus(Protocol):
    """What a process sees of the others."""

    def publisher(self, topic: Topic, name: str = "") -> Publish:
        """Return the function that publishes on a topic."""

    def newest(self, topic: Topic, name: str = "", wake: Wake | None = None) -> Subscription:
        """Subscribe to a topic; ``wake`` is called, from any thread, when a message comes."""

    def newest_by_sender(self, topic: Topic, name: str) -> BySender:
        """Subscribe to a topic that tells senders apart."""

    def listen(self, topic: Topic, name: str, put: Callable[[int, bytes], None]) -> None:
        """Call ``put`` with (instant of arrival [ns], payload) of every message, from any thread."""

    def listen_by_sender(self, topic: Topic, name: str, put: Callable[[str, int, bytes], None]) -> None:
        """Call ``put`` with (sender, instant of arrival [ns], payload) of every message, from one other thread."""

    def stream(self, *expressions: str, capacity: int) -> Stream:
        """Subscribe to keys, or to expressions of one topic each, of all senders; nobody hears what nobody named."""

    def serve(self, topic: Topic, name: str, wake: Wake | None = None) -> Callable[[], Request | None]:
        """Return the function that takes the next request on a topic, or None."""

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        """Send a request, once; whoever serves it may not be there (yet): then no answer comes."""

    def close(self) -> None:
        """Leave the bus. Idempotent."""


class Inbox(Generic[M]):
    """Decoded messages of one key; one that fails decoding is counted and dropped."""

    def __init__(self, subscription: Subscription, decode: Callable[[bytes], M | None]) -> None:
        self._take, self._decode = subscription.take, decode
        self.rejected = 0

    def take(self) -> M | None:
        """Return the newest valid message, or None if nothing new came."""
        payload = self._take()
        if payload is None:
            return None
        message = self._decode(payload)
        if message is None:
            self.rejected += 1
        return message


class MemoryBus:
    """Every message arrives ``delay_ns`` after it was published, on a simulated clock. Single-threaded."""

    def __init__(self, arena: str, clock: Clock, delay_ns: int) -> None:
        self._arena, self._clock, self._delay_ns = arena, clock, delay_ns
        self._subscribers: dict[str, list[Callable[[int, bytes], None]]] = {}
        self._by_sender: dict[str, list[Callable[[str, int, bytes], None]]] = {}
        self._servers: dict[str, _MemoryServer] = {}
        self._taps: list[Callable[[tuple[str, bytes]], None]] = []

    def tap(self, observe: Callable[[tuple[str, bytes]], None]) -> None:
        """Call ``observe`` with (key, payload) of every message at the moment when it is published."""
        self._taps.append(observe)

    def publisher(self, topic: Topic, name: str = "", sender: str = "") -> Publish:
        """Return the function that publishes on a topic, as one of several senders."""
        full = key(self._arena, topic, name)
        puts = self._subscribers.setdefault(full, [])
        clock, delay_ns, taps = self._clock, self._delay_ns, self._taps

        def publish(payload: bytes) -> None:
            arrival_ns = clock.now_ns() + delay_ns
            for put in puts:
                put(arrival_ns, payload)
            for observe in taps:
                observe((full, payload))

        if not topic.by_sender:
            return publish
        puts_by_sender = self._by_sender.setdefault(full, [])

        def publish_as_sender(payload: bytes) -> None:
            for put in puts_by_sender:
                put(sender, clock.now_ns() + delay_ns, payload)
            publish(payload)

        return publish_as_sender

    def newest(self, topic: Topic, name: str = "", wake: Wake | None = None) -> Subscription:
        """Subscribe to a topic."""
        queue = _MemoryQueue(self._clock, 64, wake)
        self._subscribers.setdefault(key(self._arena, topic, name), []).append(queue.put)
        return queue

    def newest_by_sender(self, topic: Topic, name: str) -> BySender:
        """Subscribe to a topic that tells senders apart."""
        senders = BySender(lambda: _MemoryQueue(self._clock, 64, None))
        self.listen_by_sender(topic, name, senders.put)
        return senders

    def listen_by_sender(self, topic: Topic, name: str, put: Callable[[str, int, bytes], None]) -> None:
        """Call ``put`` of every message when it is published, with its sender."""
        self._by_sender.setdefault(key(self._arena, topic, name), []).append(put)

    def listen(self, topic: Topic, name: str, put: Callable[[int, bytes], None]) -> None:
        """Call ``put`` of every message when it is published: its arrival is yet to come."""
        self._subscribers.setdefault(key(self._arena, topic, name), []).append(put)

    def stream(self, *expressions: str, capacity: int) -> Stream:
        """Subscribe to one key (several are the tap's)."""
        (full,) = expressions
        stream = _MemoryStream(full, self._clock, capacity)
        self._subscribers.setdefault(full, []).append(stream.put)
        return stream

    def serve(self, topic: Topic, name: str, wake: Wake | None = None) -> Callable[[], Request | None]:
        """Return the function that takes the next request; who serves later takes over."""
        server = self._servers[key(self._arena, topic, name)] = _MemoryServer(self._clock, wake)
        return server.take

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        """Send a request."""
        full = key(self._arena, topic, name)
        answer = _MemoryAnswer(self._clock, self._delay_ns)
        server = self._servers.get(full)
        if server is not None:
            server.put(self._clock.now_ns() + self._delay_ns, _MemoryRequest(payload, answer))
        for observe in self._taps:
            observe((full, payload))
        return answer

    def close(self) -> None:
        """Nothing to leave."""


class _MemoryQueue:
    """Messages under way to one subscriber."""

    __slots__ = ("_clock", "_messages", "_wake", "arrival_ns")

    def __init__(self, clock: Clock, capacity: int, wake: Wake | None) -> None:
        self._clock, self._wake = clock, wake
        self._messages: deque[tuple[int, bytes]] = deque(maxlen=capacity)
        self.arrival_ns = 0

    def put(self, arrival_ns: int, payload: bytes) -> None:
        self._messages.append((arrival_ns, payload))
        if self._wake is not None:
            self._wake(arrival_ns)

    def take(self) -> bytes | None:
        messages = self._messages
        if not messages:
            return None
        newest, now_ns = None, self._clock.now_ns()
        while messages and messages[0][0] <= now_ns:
            self.arrival_ns, newest = messages.popleft()
        return newest


class _MemoryStream:
    """All messages under way to one subscriber."""

    def __init__(self, full: str, clock: Clock, capacity: int) -> None:
        self._key, self._clock, self._capacity = full, clock, capacity
        self._messages: deque[tuple[int, bytes]] = deque(maxlen=capacity)
        self.dropped = 0

    def put(self, arrival_ns: int, payload: bytes) -> None:
        self.dropped += len(self._messages) == self._capacity
        self._messages.append((arrival_ns, payload))

    def drain(self) -> list[Arrival]:
        now_ns = self._clock.now_ns()
        arrived = []
        while self._messages and self._messages[0][0] <= now_ns:
            at_ns, payload = self._messages.popleft()
            arrived.append(Arrival(at_ns, self._key, payload))
        return arrived


class _MemoryServer:
    """Requests under way to one process."""

    def __init__(self, clock: Clock, wake: Wake | None) -> None:
        self._clock, self._wake = clock, wake
        self._requests: deque[tuple[int, _MemoryRequest]] = deque(maxlen=_WAITING_REQUESTS)

    def put(self, arrival_ns: int, request: "_MemoryRequest") -> None:
        self._requests.append((arrival_ns, request))
        if self._wake is not None:
            self._wake(arrival_ns)

    def take(self) -> "_MemoryRequest | None":
        if not self._requests or self._requests[0][0] > self._clock.now_ns():
            return None
        return self._requests.popleft()[1]


class _MemoryRequest:
    def __init__(self, payload: bytes, answer: "_MemoryAnswer") -> None:
        self.payload, self._answer = payload, answer

    def reply(self, payload: bytes) -> None:
        self._answer.put(payload)


class _MemoryAnswer:
    doubt = ""

    def __init__(self, clock: Clock, delay_ns: int) -> None:
        self._clock, self._delay_ns = clock, delay_ns
        self._arrives: tuple[int, bytes] | None = None

    def put(self, payload: bytes) -> None:
        self._arrives = self._clock.now_ns() + self._delay_ns, payload

    def take(self) -> bytes | None:
        if self._arrives is None or self._arrives[0] > self._clock.now_ns():
            return None
        (_, payload), self._arrives = self._arrives, None
        return payload
