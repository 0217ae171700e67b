"""The server: every channel of a recording, to any number of viewers. None of them is waited for.

The library writes to each viewer in threads of its own. A viewer that is too slow misses the oldest messages.
"""

import json
import logging
import os
import re
import secrets
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from queue import SimpleQueue

from foxglove import Channel, Context, MessageSchema, Schema, Service, ServiceRequest, ServiceSchema, start_server
from foxglove.websocket import Capability, ChannelView, Client, ServerListener

from robofleet.bus.credentials import credentials
from robofleet.bus.permissions import OPERATOR, PAGE
from robofleet.config.tree import Config
from robofleet.core.files import read_plain, replaced
from robofleet.core.refusal import RefusedError
from robofleet.core.valid_json import dumps
from robofleet.gateways.asking import SERVICES, Ask
from robofleet.gateways.viewers.retained import RetainedMessages
from robofleet.gateways.viewers.server import Run
from robofleet.operator.viewer_address import Address
from robofleet.recording.channels import Channel as Described
from robofleet.recording.run import Recording
from robofleet.reports.layouts import foxglove as layouts

LAYOUT = "foxglove.json"
_LARGEST_LAYOUT = 1 << 26  # [bytes]
_KEY = re.compile(rb'\\"key\\": ?\\"([0-9a-f]{32})\\"')  # in a button's request
_BACKLOG = 16384  # messages for a viewer: half a second of a hundred robots comes at once


class Server(ServerListener):
    """Serves until ``close``; OSError where its address cannot be used."""

    def __init__(
        self, name: str, at: Address, channels: Sequence[Described], services: list[Service], layout: Path = Path()
    ) -> None:
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        context = self._context = Context()  # it lives as long as somebody holds it
        self._channels = {
            channel.topic: Channel(
                channel.topic, message_encoding=channel.encoding, context=context,
                schema=Schema(name=channel.schema, encoding=channel.schema_encoding, data=channel.description),
            )
            for channel in channels
        }  # fmt: skip
        self._kept, self._new = RetainedMessages(), SimpleQueue[str]()
        self.subscriptions = 0  # of all viewers, so far
        own = credentials(name, PAGE) if at.secured else None
        try:
            self._server = start_server(
                name=name, host=at.host, port=at.port, context=context, server_listener=self,
                capabilities=[Capability.Services] if services else [], services=services,
                supported_encodings=["json"], message_backlog_size=_BACKLOG,
                tls_cert=None if own is None else own.certificate.read_bytes(),
                tls_key=None if own is None else own.key.read_bytes(),
            )  # fmt: skip
        except RuntimeError as error:
            raise OSError(str(error)) from error
        self.port = self._server.port
        self.address = f"Foxglove, Lichtblick: open {at.url(self.port)}, with the layout {layout}"

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Hear, in a thread of the library's, that somebody wants to see a topic."""
        self._new.put(channel.topic)
        self.subscriptions += 1

    def tell(self, topic: str, log_ns: int, message: bytes) -> None:
        self._kept.take(topic, message)
        self._channels[topic].log(message, log_time=log_ns)

    def step(self, log_ns: int) -> None:
        """Repeat rare messages for viewers that came late."""
        late = set[str]()
        while not self._new.empty():
            late.add(self._new.get())
        for topic in sorted(late):
            if (message := self._kept.of(topic)) is not None:
                self._channels[topic].log(message, log_time=log_ns)

    def close(self) -> None:
        self._server.stop()


def opened(run: Run, at: Address, channels: Sequence[Described]) -> Server:
    """Open the server of a run, and write its layout; OSError where its address cannot be used, RefusedError."""
    layout, key = written(run.config, run.folder, asks=run.access.role == OPERATOR)
    offered = services(run.ask, key) if key else []
    return Server(run.config.arena.name, at, channels, offered, layout)


def written(config: Config, folder: Path, *, asks: bool) -> tuple[Path, str]:
    """Write the layout of a run, for this user alone: whoever has it may drive. Returns it and its key, if one asks.

    One that is there stays, so all servers of a run have one key; RefusedError where something else is there.
    """
    file, recording = folder / LAYOUT, Recording(config)

    def layout(key: str) -> bytes:
        return layouts.layout(recording, SERVICES if asks else (), {"key": key})

    try:
        found, status = read_plain(file, _LARGEST_LAYOUT), file.lstat()
    except FileNotFoundError:
        key = secrets.token_hex(16) if asks else ""
        with replaced(file) as stream:
            os.fchmod(stream.fileno(), 0o600)
            stream.write(layout(key))
        return file, key
    except OSError as error:
        raise RefusedError(f"{file}: {error.strerror}: move it away, or start this in another folder") from error
    kept = _KEY.search(found)
    own = kept[1].decode() if kept is not None else ""
    private = status.st_uid in (os.geteuid(), folder.stat().st_uid) and not status.st_mode & 0o077
    if not private or bool(own) != asks or found != layout(own):
        raise RefusedError(f"{file} is not the layout of this run: move it away, or start this in another folder")
    return file, own


_ANSWER_WITHIN_S = 10.0
_LARGEST_REQUEST = 1024  # [bytes]
_REQUEST = {"type": "object", "properties": {"key": {"type": "string"}}, "required": ["key"]}
_RESPONSE = {"type": "object", "properties": {"success": {"type": "boolean"}, "message": {"type": "string"}}}
_STRANGER = "refused: this needs the operator's key: the layout in the run's folder has it"


def services(ask: Ask, key: str) -> list[Service]:
    """Return the services by which an operator asks something of a run; each request must bring the key.

    Every web site that a browser of this computer has open reaches a server on this computer.
    """
    schema = ServiceSchema(
        "robofleet.Ask",
        request=_schema("robofleet.Request", _REQUEST),
        response=_schema("robofleet.Answer", _RESPONSE),
    )
    return [Service(what, schema=schema, handler=partial(_answer, ask, key, what)) for what in SERVICES]


def _schema(name: str, described: object) -> MessageSchema:
    return MessageSchema(
        encoding="json", schema=Schema(name=name, encoding="jsonschema", data=dumps(described).encode())
    )


def _answer(ask: Ask, key: str, what: str, request: ServiceRequest) -> bytes:
    try:
        done, text = ask(what).result(_ANSWER_WITHIN_S) if _permitted(request.payload, key) else (False, _STRANGER)
    except TimeoutError:
        done, text = False, f"no answer within {_ANSWER_WITHIN_S:g} s: the requests before it wait, too"
    return dumps({"success": done, "message": text}).encode()


def _permitted(payload: bytes, key: str) -> bool:
    try:
        fields = json.loads(payload) if len(payload) <= _LARGEST_REQUEST else None
    except (ValueError, RecursionError):
        return False
    shown = fields.get("key") if isinstance(fields, dict) else None
    return isinstance(shown, str) and secrets.compare_digest(shown.encode(), key.encode())
