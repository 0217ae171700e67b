"""The file of a run: one MCAP with every message as it was said, and what other viewers can draw."""

from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import CompressionType, Writer

from robofleet.clock import MS
from robofleet.comms.layouts import VERSION
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.recording.scene import Scene

FILE = "run.mcap"
ENCODING = f"robofleet-{VERSION}"  # of this project's own messages
CONFIG = "config.yaml"  # the attachment
_CHUNK = 64 * 1024  # [bytes]
_FLUSH_NS = 250 * MS


class RunLog:
    """Writes a run's messages, in the order in which they came; close it in a ``finally``.

    Times are instants of the writing process's clock plus ``epoch_ns``: what makes them dates [ns since 1970]. A
    process that is killed loses what came after the last flush: a quarter of a second, at most.
    """

    def __init__(self, file: Path, config: Config, *, epoch_ns: int = 0) -> None:
        self._epoch_ns = epoch_ns
        self._file = file.open("xb", buffering=0)
        self._writer = Writer(self._file, chunk_size=_CHUNK, compression=CompressionType.ZSTD)
        self._writer.start("robofleet", "robofleet")
        self._writer.add_attachment(0, 0, CONFIG, "application/yaml", resolved_yaml(config).encode())
        self._channels: dict[str, int] = {}
        self._scene = Scene(config, epoch_ns=epoch_ns)
        self._register_scene()
        self._flushed_ns = 0
        self.messages = 0

    def add(self, full: str, payload: bytes, at_ns: int) -> None:
        """Keep a message that came at an instant of this process's clock."""
        channel = self._channels.get(full) or self._register(full)
        self.messages += 1
        log_ns = at_ns + self._epoch_ns
        self._writer.add_message(channel, log_ns, payload, log_ns, self.messages & 0xFFFFFFFF)
        for topic, drawn in self._scene.update(full, payload, at_ns):
            self._writer.add_message(self._channels[topic], log_ns, drawn, log_ns, self.messages & 0xFFFFFFFF)

    def flush(self, now_ns: int) -> None:
        """Write what is not in the file yet, if it is time to."""
        if now_ns - self._flushed_ns >= _FLUSH_NS:
            self._flushed_ns = now_ns
            self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """End the file with its index. Idempotent."""
        if not self._file.closed:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._file.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """End the file."""
        self.close()

    def _register_scene(self) -> None:
        schemas: dict[str, int] = {}
        for topic, name, descriptor in self._scene.channels:
            schema = schemas.get(name) or self._writer.register_schema(name, "protobuf", descriptor)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schemas.setdefault(name, schema))

    def _register(self, full: str) -> int:
        channel = self._channels[full] = self._writer.register_channel(full, ENCODING, 0)
        return channel
