"""The file of a run: one MCAP with every message as it was said, and what other viewers can draw."""

import fcntl
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Self

from mcap.records import Attachment, Metadata

from robofleet.bus.keys import NEWS, STATE, STATUS, key
from robofleet.bus.layouts import VERSION
from robofleet.bus.messages import RUN_STATE, UNIT_STATUS
from robofleet.config import groups
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.core.valid_json import dumps
from robofleet.recording.channels import Channel, keys, of_key
from robofleet.recording.container import Container
from robofleet.recording.provenance import Provenance

if TYPE_CHECKING:
    from robofleet.recording.scenes.drawn import DrawnMessages

FILE = "run.mcap"
PROFILE, LIBRARY = "robofleet", "robofleet {} wire {}"  # who wrote the file: robofleet's version, the messages'
CONFIG, GROUPS, ENDING = "config.yaml", "groups.json", "ending.json"  # the attachments
PROVENANCE, DROPPED = "provenance", "dropped"  # the metadata
COUNT = "messages"  # how many were dropped since the record before
_CHUNK_BYTES, _LOCKSTEP_CHUNK_BYTES = 64 * 1024, 512 * 1024  # in lockstep a chunk costs more than a kill
_FLUSH_NS, _SELDOM_NS = 200 * MS, 60 * S  # a kill loses a quarter of a second at most, also on a busy machine


class RunLog:
    """Writes a run's messages, in the order in which they came; close it in a ``finally``.

    Times are instants of the writing process's clock plus ``epoch_ns``: what makes them dates [ns since 1970]. Without
    it they are of a simulated clock, and a run in lockstep leaves the same bytes every time. A process that is killed
    loses what came after the last flush: a quarter of a second at most, and nothing that came before the run's phase,
    a latch or the tracker's news changed. No trouble with the disk is raised: ``failed`` says what it is, and what
    could not be written is counted.
    """

    def __init__(
        self, file: Path, config: Config, *, epoch_ns: int = 0, drawn: bool = True, batched: bool = False
    ) -> None:
        """Begin a file; FileExistsError if it is there already, OSError if it cannot be.

        ``drawn``: with what viewers draw, which is derived from the messages and takes a quarter of the file.
        ``batched``: written seldom, in large pieces: of a run whose seconds last milliseconds.
        """
        self._epoch_ns = epoch_ns
        self._chunk, self._flush_ns = (_CHUNK_BYTES, _FLUSH_NS) if not batched else (_LOCKSTEP_CHUNK_BYTES, _SELDOM_NS)
        self._file = file.open("xb", buffering=0)
        with suppress(OSError):  # a network's disk may know no locks
            fcntl.flock(self._file, fcntl.LOCK_EX)  # nobody repairs what is still being written
        self._container = Container(self._file, PROFILE, LIBRARY.format(version("robofleet"), VERSION))
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        for full in keys(config):
            self._register(of_key(full))
        self._news = _news(config)
        self._newest: dict[str, object] = {}  # of what is in self._news
        self._kept: list[Attachment | Metadata] = []  # until they are in the file
        self._waiting = 0  # messages that are not in the file yet
        self._undeclared = 0  # messages that were dropped, and the file does not say so yet
        # They load OpenCV and protobuf, and who reads a file needs neither.
        from robofleet.recording.scenes.drawn import Drawn  # noqa: PLC0415
        from robofleet.recording.scenes.robot_ticks import BATCH, LARGE_BATCH  # noqa: PLC0415

        descriptions = groups.descriptions(config)
        batch = LARGE_BATCH if batched else BATCH
        self._drawn = Drawn(config, descriptions, epoch_ns=epoch_ns, batch=batch) if drawn else None
        for channel in self._drawn.channels if self._drawn else ():
            self._register(channel)
        self._flushed_ns = 0
        self.messages = 0  # that came
        self.dropped = 0  # that are not in the file
        self.failed: str | None = None  # why the newest write did not succeed
        self._attach(CONFIG, "application/yaml", resolved_yaml(config).encode())
        self._attach(GROUPS, "application/json", dumps([group.plain() for group in descriptions]).encode())
        provenance = Provenance.here(config, "realtime" if epoch_ns else "lockstep", epoch_ns)
        self._kept.append(Metadata(PROVENANCE, provenance.metadata()))
        self._write()

    def add(self, full: str, payload: bytes, at_ns: int) -> None:
        channel = self._channels.get(full) or self._register(of_key(full))
        self.messages += 1
        self._waiting += 1
        self._container.add_message(channel, self.messages & 0xFFFFFFFF, at_ns + self._epoch_ns, payload)
        if self._drawn and (drawn := self._drawn.update(full, payload, at_ns)):
            self._add_drawn(drawn)
        if self._container.waiting_bytes >= self._chunk or (full in self._news and self._is_news(full, payload)):
            self._write()

    def add_all(self, messages: Iterable[tuple[str, bytes]], at_ns: int) -> None:
        """Keep messages that came at one instant, and write what waits if it is time to."""
        for full, payload in messages:
            self.add(full, payload, at_ns)
        if at_ns - self._flushed_ns >= self._flush_ns:
            self.flush(at_ns)

    def drop(self, count: int) -> None:
        """Count messages that were lost before they came here."""
        self.dropped += count
        self._undeclared += count

    def flush(self, now_ns: int) -> None:
        """Write what is not in the file yet, if it is time to."""
        if now_ns - self._flushed_ns >= self._flush_ns:
            self._flushed_ns = now_ns
            self._write()

    def end(self, ending: bytes) -> None:
        if ending:
            self._attach(ENDING, "application/json", ending)
        self.close()

    def let_go(self) -> None:
        """Close the file in this process: a fork of it goes on writing."""
        self._file.close()

    def close(self) -> None:
        """End the file with its index. Idempotent."""
        if self._file.closed:
            return
        if self._drawn:
            self._add_drawn(self._drawn.rest())
        self._write()
        try:
            if self.failed is None:
                self._container.finish()
        except OSError as error:
            self.failed = error.strerror
        finally:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add_drawn(self, messages: "DrawnMessages") -> None:
        for topic, log_ns, message in messages:
            self._container.add_message(self._channels[topic], self.messages & 0xFFFFFFFF, log_ns, message)

    def _register(self, new: Channel) -> int:
        """Return the id of a new channel; channels whose messages are of one kind share its schema."""
        if new.schema not in self._schemas:
            self._schemas[new.schema] = self._container.register_schema(
                new.schema, new.schema_encoding, new.description
            )
        channel = self._channels[new.topic] = self._container.register_channel(
            new.topic, new.encoding, self._schemas[new.schema]
        )
        return channel

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        self._kept.append(Attachment(0, 0, name, media_type, data))

    def _is_news(self, full: str, payload: bytes) -> bool:
        news = self._news[full](payload)
        if news == self._newest.get(full):
            return False
        self._newest[full] = news
        return True

    def _write(self) -> None:
        """Write what waits; what does not go in is dropped, but for what the file cannot be read without."""
        dropped = [Metadata(DROPPED, {COUNT: str(self._undeclared)})] if self._undeclared else []
        try:
            self._container.write([*self._kept, *dropped])
        except OSError as error:
            self.failed = error.strerror
            self._container.discard()
            self.drop(self._waiting)
        else:
            self.failed = None
            self._kept.clear()
            self._undeclared = 0
        self._waiting = 0


def _news(config: Config) -> dict[str, Callable[[bytes], object]]:
    """Return the part of a message that must be in the file at once when it changes, for each key that has one."""
    arena = config.arena.name

    def latches(payload: bytes) -> object:
        latch, number = (UNIT_STATUS.column(payload, field) for field in ("latch", "latch_id"))
        return None if latch is None or number is None else latch.tobytes() + number.tobytes()

    return {
        key(arena, STATE): lambda payload: [RUN_STATE.head_of(payload, field) for field in ("phase", "cause")],
        **{key(arena, NEWS, camera): lambda payload: payload for camera in config.camera_names},
        **{key(arena, STATUS, unit): latches for unit in config.units},
    }
