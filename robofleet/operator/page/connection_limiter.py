"""Limits the connections of the page's server: one that asks for nothing is closed after seconds, or before.

The server accepts every connection, so the emergency stop always gets in. Over the limit, the oldest idle connection of
the address that has most is closed. A connection without a whole request is closed after a few seconds.
"""

import asyncio
import fcntl
import sys
import termios
from collections import Counter
from typing import Any, Protocol

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from robofleet.core.clock import Clock, S

MOST = 256  # connections at once, beside the pages' WebSockets
ASKED_WITHIN_S = 3.0  # a whole request, from the connection's beginning or the answer before
_ANSWERED_WITHIN_S = 10.0  # an answer, taken by who asked


class Complaints:
    """Counts what is refused and writes a line, at most one a second: who tries again and again fills no disk."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.count = 0
        self._logged_ns = -S

    def add(self, what: str) -> None:
        self.count += 1
        now_ns = self._clock.now_ns()
        if now_ns - self._logged_ns >= S:
            self._logged_ns = now_ns
            line = f"refused ({self.count} so far): {what}"
            print(line.encode("ascii", "backslashreplace").decode(), file=sys.stderr)


class Limited(Protocol):
    """A connection that counts."""

    @property
    def host(self) -> str:
        """Whose it is."""

    @property
    def acts(self) -> bool:
        """Whether it asks for something to be done, and is not answered yet."""

    def is_idle(self) -> bool:
        """Return whether it asks for nothing, and has said nothing that is not read yet."""

    def drop(self, why: str) -> None:
        """Close it at once."""


def unread(transport: asyncio.Transport) -> bool:
    """Return whether something has come that is not read yet."""
    if (handle := transport.get_extra_info("socket")) is None:  # it is closed
        return False
    try:
        return any(fcntl.ioctl(handle.fileno(), termios.FIONREAD, bytes(4)))
    except OSError:
        return False


class ConnectionLimiter:
    """The connections that are no WebSockets, oldest first."""

    def __init__(self, complaints: Complaints) -> None:
        self.complaints = complaints
        self._taken: dict[Limited, None] = {}
        self._crowds: Counter[str] = Counter()

    def take(self, connection: Limited) -> None:
        """Let a connection in; another one goes where there are too many."""
        self._taken[connection] = None
        self._crowds[connection.host] += 1
        if len(self._taken) <= MOST:
            return
        ((crowd, _),) = self._crowds.most_common(1)
        held = [candidate for candidate in self._taken if candidate.host == crowd and not candidate.acts]
        if (goes := next((candidate for candidate in held if candidate.is_idle()), next(iter(held), None))) is not None:
            goes.drop("more connections than the limit")

    def leave(self, connection: Limited) -> None:
        """Take note that a connection is closed, or a WebSocket now."""
        if connection in self._taken:
            del self._taken[connection]
            self._crowds -= Counter([connection.host])


class Connection(H11Protocol):
    """A connection that counts, with a deadline for what it does next."""

    def __init__(self, limiter: ConnectionLimiter, **of_uvicorn: Any) -> None:
        super().__init__(**of_uvicorn)
        self._limiter = limiter
        self._deadline: asyncio.TimerHandle | None = None

    @property
    def host(self) -> str:
        return self.client[0] if self.client else "?"

    @property
    def acts(self) -> bool:
        return self._asks and self.scope["method"] == "POST"

    def is_idle(self) -> bool:
        return not self._asks and not unread(self.transport)

    def drop(self, why: str) -> None:
        self._limiter.complaints.add(f"a connection of {self.host}: {why}")
        self._leave()
        self.transport.abort()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._wait(ASKED_WITHIN_S)
        self._limiter.take(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._leave()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Remove it: pages have a limit of their own."""
        self._leave()
        super().handle_websocket_upgrade(event)
        self.loop.call_later(ASKED_WITHIN_S, self._end_without_page)

    def on_response_complete(self) -> None:
        self._wait(ASKED_WITHIN_S)
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        self._limiter.complaints.add(f"what {self.host} says is not HTTP")
        super().send_400_response(msg)

    @property
    def _asks(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _wait(self, for_s: float, *, for_answer: bool = False) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self.loop.call_later(for_s, self._late, for_answer)

    def _late(self, for_answer: bool) -> None:
        if self._asks and not for_answer:
            self._wait(_ANSWERED_WITHIN_S, for_answer=True)
        else:
            self.drop("it does not take its answer" if for_answer else "no whole request for seconds")

    def _end_without_page(self) -> None:
        if self.transport.is_closing():  # one of TLS knows no protocol then
            return
        page = self.transport.get_protocol()
        if not (isinstance(page, WebSocketsSansIOProtocol) and page.handshake_complete and not page.close_sent):
            self.transport.abort()

    def _leave(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._limiter.leave(self)
