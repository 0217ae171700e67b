"""The beginning of a connection from beyond this computer: TLS, or nothing.

A greeting has a place as every connection has, and a time limit. So who opens connections and says nothing, or not what
TLS says, keeps no place for long and delays nobody: nothing here waits but the one connection.
"""

import asyncio
import ssl
from typing import Any
from weakref import WeakSet

from uvicorn.protocols.utils import get_remote_addr

from robofleet.operator.page.places import ASKED_WITHIN_S, Connection, ConnectionLimiter, unread

_LEFT_WITHIN_S = 1.0  # of our last word: who does not say good-bye is left


class TlsHandshakes:
    """Makes the server's end of each connection, and closes what is left of them."""

    def __init__(self, context: ssl.SSLContext, places: ConnectionLimiter) -> None:
        self._context, self._places = context, places
        self._open: WeakSet[asyncio.Transport] = WeakSet()

    def __call__(self, **of_uvicorn: Any) -> "TlsHandshake":
        """Return the beginning of a connection."""
        return TlsHandshake(self._context, self._places, self._open, of_uvicorn)

    def close(self) -> None:
        """Wait for no other end's good-bye any more."""
        for transport in list(self._open):
            transport.abort()


class TlsHandshake(asyncio.Protocol):
    """A connection until both ends have agreed on its keys; then it is a ``Connection``."""

    acts = False

    def __init__(
        self,
        context: ssl.SSLContext,
        places: ConnectionLimiter,
        opened: WeakSet[asyncio.Transport],
        of_uvicorn: dict[str, Any],
    ) -> None:
        self._context, self._places, self._open, self._of_uvicorn = context, places, opened, of_uvicorn
        self._early = b""  # a request that came with the last word of the greeting
        self.host = "?"

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place, and begin."""
        assert isinstance(transport, asyncio.Transport)
        transport.pause_reading()  # until TLS reads
        self._transport = transport
        self._open.add(transport)
        self.host = (get_remote_addr(transport) or ("?",))[0]
        self._handshake = asyncio.get_running_loop().create_task(self._shake_hands())
        self._places.take(self)

    def data_received(self, data: bytes) -> None:
        """Keep what TLS has brought already."""
        self._early += data

    def is_idle(self) -> bool:
        """Return whether it has said nothing that is not read yet."""
        return not unread(self._transport)

    def drop(self, why: str) -> None:
        """Close it at once."""
        self._places.complaints.add(f"a connection of {self.host}: {why}")
        self._places.leave(self)
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
            self._places.complaints.add(f"a connection of {self.host}: no TLS: {getattr(error, 'reason', error)}")
            return
        finally:
            self._places.leave(self)
        if secured is None or secured.is_closing():
            return
        connection = Connection(self._places, **self._of_uvicorn)
        secured.set_protocol(connection)
        connection.connection_made(secured)
        if self._early:
            connection.data_received(self._early)
