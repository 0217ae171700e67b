"""The beginning of a connection from beyond this computer: TLS, or nothing.

A handshake counts as every connection does, and has a time limit. So who opens connections and says nothing, or not
what TLS says, is closed soon and delays nobody: nothing here waits but that connection.
"""

import asyncio
import ssl
from typing import Any
from weakref import WeakSet

from uvicorn.protocols.utils import get_remote_addr

from robofleet.operator.page.connection_limiter import ASKED_WITHIN_S, Connection, ConnectionLimiter, unread

_LEFT_WITHIN_S = 1.0  # of our last word: who does not say good-bye is left


class TlsHandshake(asyncio.Protocol):
    """A connection until both ends have agreed on its keys; then it is a ``Connection``."""

    acts = False

    def __init__(
        self,
        context: ssl.SSLContext,
        limiter: ConnectionLimiter,
        opened: WeakSet[asyncio.Transport],
        **of_uvicorn: Any,
    ) -> None:
        """``opened``: where its transport is kept, for who closes those that are left."""
        self._context, self._limiter, self._open, self._of_uvicorn = context, limiter, opened, of_uvicorn
        self._early = b""  # a request that came with the last word of the handshake
        self.host = "?"

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.pause_reading()  # until TLS reads
        self._transport = transport
        self._open.add(transport)
        self.host = (get_remote_addr(transport) or ("?",))[0]
        self._handshake = asyncio.get_running_loop().create_task(self._shake_hands())
        self._limiter.take(self)

    def data_received(self, data: bytes) -> None:
        self._early += data

    def is_idle(self) -> bool:
        return not unread(self._transport)

    def drop(self, why: str) -> None:
        self._limiter.complaints.add(f"a connection of {self.host}: {why}")
        self._limiter.leave(self)
        self._transport.abort()
        self._handshake.cancel()

    async def _shake_hands(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            secured = await loop.start_tls(
                self._transport, self, self._context, server_side=True,
                ssl_handshake_timeout=ASKED_WITHIN_S, ssl_shutdown_timeout=_LEFT_WITHIN_S,
            )  # fmt: skip
        except ConnectionResetError:  # it has left, as a look at an open port does
            return
        except OSError as error:  # of TLS, or too slow
            self._limiter.complaints.add(f"a connection of {self.host}: no TLS: {getattr(error, 'reason', error)}")
            return
        finally:
            self._limiter.leave(self)
        if secured is None or secured.is_closing():
            return
        connection = Connection(self._limiter, **self._of_uvicorn)
        secured.set_protocol(connection)
        connection.connection_made(secured)
        if self._early:
            connection.data_received(self._early)
