"""A viewer: Foxglove's WebSocket protocol, written from its specification. It counts what comes."""

import asyncio
import json
import struct
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from websockets.asyncio.client import ClientConnection, connect

PROTOCOL = "foxglove.sdk.v1"
_MESSAGE, _CALL, _ANSWER = 1, 2, 3  # opcodes of binary messages
_HEAD = struct.Struct("<BIQ")  # opcode, subscription, log time [ns]
_CALLED = struct.Struct("<BIII")  # opcode, service, call, length of the encoding


class Message(NamedTuple):
    """One message of a channel."""

    topic: str
    log_ns: int
    data: bytes


class Viewer:
    """A connection that has subscribed to every channel."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.channels: dict[int, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.messages: list[Message] = []
        self.answers: list[dict[str, Any]] = []
        self.failures: list[str] = []

    @property
    def counts(self) -> Counter[str]:
        """How many messages came of each topic."""
        return Counter(message.topic for message in self.messages)

    async def call(self, service: str, request: object) -> dict[str, Any]:
        """Call a service, and return its answer."""
        before, encoding = len(self.answers), b"json"
        head = _CALLED.pack(_CALL, self.services[service]["id"], 1, len(encoding))
        await self._socket.send(head + encoding + json.dumps(request).encode())
        await self.until(lambda: len(self.answers) > before)
        return self.answers[-1]

    async def until(self, condition: Callable[[], Any], within_s: float = 60.0) -> None:
        """Take what comes until a condition holds."""
        async with asyncio.timeout(within_s):
            while not condition():
                self._take(await self._socket.recv())
                await self._subscribe()

    def _take(self, frame: str | bytes) -> None:
        if isinstance(frame, bytes):
            if frame[0] == _MESSAGE:
                _, subscription, log_ns = _HEAD.unpack_from(frame)
                self.messages.append(Message(self.channels[subscription]["topic"], log_ns, frame[_HEAD.size :]))
            elif frame[0] == _ANSWER:
                *_, length = _CALLED.unpack_from(frame)
                self.answers.append(json.loads(frame[_CALLED.size + length :]))
            return
        content = json.loads(frame)
        if content["op"] == "advertise":
            self._new = [channel for channel in content["channels"] if channel["id"] not in self.channels]
            self.channels.update((channel["id"], channel) for channel in content["channels"])
        elif content["op"] == "advertiseServices":
            self.services.update((service["name"], service) for service in content["services"])
        elif content["op"] == "serviceCallFailure":
            self.failures.append(content["message"])

    _new: list[dict[str, Any]] = []  # noqa: RUF012 - replaced, never changed

    async def _subscribe(self) -> None:
        if self._new:
            wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in self._new]
            self._new = []
            await self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


def viewer(url: str) -> Any:
    """Connect; use it with ``async with``, and make a ``Viewer`` of what it gives."""
    return connect(url, subprotocols=[PROTOCOL], max_size=None, max_queue=None)  # type: ignore[list-item]
