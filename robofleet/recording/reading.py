"""A run read back from its file, as far as it goes.

A file may come from a stranger, so it decides nothing about which code runs here: a behaviour that it names as
``module:Class`` is imported only where the reader asks for it. Entry points of installed packages need no asking.
"""

import os
import re
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Attachment, Channel, Header, Metadata
from pydantic import ValidationError

from robofleet.bus.keys import Topic, named
from robofleet.bus.layouts import VERSION
from robofleet.config import groups
from robofleet.config.faults import cross_checks
from robofleet.config.files.yamlfile import Source, parse_bytes
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.core.errors import RobofleetError
from robofleet.core.files import open_plain
from robofleet.core.plugins import PluginError, reach
from robofleet.recording.channels import ENCODING
from robofleet.recording.chunks import Content, Message
from robofleet.recording.log import CONFIG, COUNT, DROPPED, ENDING, FILE, GROUPS, LIBRARY, PROFILE, PROVENANCE
from robofleet.recording.notes import believed_groups
from robofleet.recording.provenance import Provenance
from robofleet.recording.run import Own, Recording
from robofleet.recording.scanning import NO_MCAP, Scan

TOGETHER = 10 << 20  # [bytes] of messages that are looked at together: two minutes of four robots
_AROUND_NS = 10 * S  # what belongs together is no further apart
_STEP_NS = S

_MADE_BY = re.compile(LIBRARY.format(r"(\S{1,40})", r"(\d{1,9})"))
_SHOWN_CHARACTERS = 80  # of what a file says of itself
_MOST_DROPPED = 1 << 63  # more messages than this were never sent


Imports = Callable[[str], bool]


class _Instant(NamedTuple):
    """A message of a file: its place among all, when it came [ns], how many bytes were before it."""

    place: int
    ns: int
    size: int


class RecordingError(RobofleetError):
    """Raised where a file holds no run, or none of this version. The message is a line."""


def nothing_imported(_: str) -> bool:
    """Import no behaviour because a file names it."""
    return False


def imported(folder: Path | None, name: str) -> bool:
    """Import a behaviour whose module stands in the user's folder; False: it does not.

    PluginError where a module in that folder cannot be used.
    """
    if folder is None or not reach(folder, name):
        return False
    groups.load_kind(name)
    return True


def read(run: Path, imports: Imports = nothing_imported) -> Recording:
    """Return the messages of a run: its folder, or its file; ``imports``: whether to import a ``module:Class``.

    Raises:
        RecordingError: if there is none that can be read.
    """
    recording = None
    for recording, _ in parts(run, imports, together=1 << 62):  # noqa: B007
        pass
    assert recording is not None
    return recording


def parts(
    run: Path,
    imports: Imports = nothing_imported,
    *,
    together: int = TOGETHER,
    topics: Collection[Topic] | None = None,
) -> Iterator[tuple[Recording, Own]]:
    """Yield a run part by part, each with what came shortly before and after it: it may be larger than memory.

    ``imports``: as of ``read``; ``together``: so many bytes of messages are one part. A short run is one. What a file
    says at its end only the last part knows. ``topics``: only messages of these; None: of all.

    Raises:
        RecordingError: if there is none that can be read.
    """
    file = file_of(run)
    with opened(file) as stream:
        content, first, size = _Content(scanned(stream), file), 0, 0
        cut: _Instant | None = None  # where the next part begins
        instants: deque[_Instant] = deque()  # of what comes before it
        for full, message in content.messages():
            if topics is not None and _topic(full) not in topics:
                continue
            recording = content.recording
            assert recording is not None
            at = _Instant(recording.count + 1, message.log_ns, size)
            size += len(message.data)
            if not instants or at.ns >= instants[-1].ns + _STEP_NS:
                instants.append(at)
            if cut is None and size >= together:
                cut = at
                while instants[0].ns < at.ns - _AROUND_NS:
                    instants.popleft()
            elif cut is not None and (at.ns >= cut.ns + _AROUND_NS or size >= 2 * together):
                _know_groups(recording, file, imports)
                yield recording, Own(first, cut.place, last=False)
                content.recording = recording = recording.since(instants[0].place)
                size, first, cut = size - cut.size, cut.place, None
            recording.add(full, message.data)
        recording = content.recording
        if recording is None or not (recording.count or topics is not None):
            raise nothing(content.scan, file)
        _know_groups(recording, file, imports)
        recording.trouble = content.scan.trouble
        yield recording, Own(first)


def about(run: Path, imports: Imports = nothing_imported) -> Recording:
    """Return what the file of a run says before its first message, be the run still going on, and no message.

    ``imports``: as of ``read``.

    Raises:
        RecordingError: if nothing can be read.
    """
    file = file_of(run)
    with opened(file) as stream:
        content = _Content(scanned(stream), file)
        next(content.messages(), None)
    if content.recording is None:
        raise nothing(content.scan, file)
    _know_groups(content.recording, file, imports)
    return content.recording


def messages(run: Path) -> Iterator[tuple[str, Message]]:
    """Yield every message of a run with its key, in the order in which they came.

    Raises:
        RecordingError: if nothing can be read.
    """
    file = file_of(run)
    with opened(file) as stream:
        content = _Content(scanned(stream), file)
        yield from content.messages()
        if content.recording is None:
            raise nothing(content.scan, file)


def trouble_of(run: Path) -> str | None:
    """Return what is wrong with the file of a run; None: it is whole.

    Raises:
        RecordingError: if it cannot be read at all.
    """
    with opened(file_of(run)) as stream:
        scan = scanned(stream)
        deque(scan.items(), maxlen=0)
    return scan.trouble


def file_of(run: Path) -> Path:
    return run / FILE if os.path.isdir(run) else run  # noqa: PTH112 - it raises nothing


@contextmanager
def opened(file: Path) -> Iterator[BinaryIO]:
    """Open a recording; RecordingError where it cannot be read."""
    try:
        stream = open_plain(file)
    except FileNotFoundError as error:
        raise RecordingError(f"{file}: there is no such recording: name a run's folder") from error
    except OSError as error:
        raise RecordingError(f"{file}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RecordingError(f"{file}: is not a file name") from error
    with stream:
        yield stream


def scanned(stream: BinaryIO) -> Scan:
    """Return a walk through a file that is at its start."""
    return Scan(stream, os.fstat(stream.fileno()).st_size)


def nothing(scan: Scan, file: Path) -> RecordingError:
    if scan.trouble is None:
        return RecordingError(f"{file}: holds no message: the run ended before its first message: name another run")
    if scan.trouble == NO_MCAP:
        return RecordingError(f"{file}: is not a recording: name a run's folder, or the run.mcap in it")
    return RecordingError(f"{file}: is not a recording: the file {scan.trouble}")


def check_maker(header: Header, file: Path) -> str:
    """Return the version that wrote a file; RecordingError where this one does not read it."""
    made_by = _MADE_BY.fullmatch(header.library) if header.profile == PROFILE else None
    if made_by is None:
        maker = header.library[:_SHOWN_CHARACTERS] or "somebody else"
        raise RecordingError(f"{file}: is not a recording of robofleet: it was made by {maker}")
    robofleet, wire = made_by.groups()
    if int(wire) != VERSION:
        raise RecordingError(
            f"{file}: was made by wire version {wire} of robofleet {robofleet}; this one reads {VERSION}: "
            "install that version"
        )
    return f"robofleet {robofleet}"


def own(contents: list[Content], channels: dict[int, str]) -> Iterator[tuple[str, Message]]:
    """Yield this project's own messages of a chunk with their keys; ``channels`` are those of the chunks so far."""
    for content in contents:
        if isinstance(content, Message):
            if content.channel in channels:
                yield channels[content.channel], content
        elif isinstance(content, Channel) and content.message_encoding == ENCODING:
            channels[content.id] = content.topic


@lru_cache(4096)
def _topic(full: str) -> Topic | None:
    found = named(full)
    return None if found is None else found[0]


class _Content:
    """What is in a file."""

    def __init__(self, scan: Scan, file: Path) -> None:
        self.scan, self._file = scan, file
        self.recording: Recording | None = None  # from its configuration on

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield the messages with their keys; what else the file says is noted in the recording."""
        channels: dict[int, str] = {}
        made_by = ""
        for item in self.scan.items():
            if isinstance(item, Header):
                made_by = check_maker(item, self._file)
            elif isinstance(item, Attachment) and item.name == CONFIG:
                self.recording = Recording(_config(item.data, made_by, self._file))
            elif self.recording is None:
                continue
            elif isinstance(item, Attachment | Metadata):
                with suppress(KeyError, TypeError, ValueError):  # metadata have no CRC; another version may say less
                    _note(self.recording, item)
            elif isinstance(item, list):
                yield from own(item, channels)


def _note(recording: Recording, part: Attachment | Metadata) -> None:
    if isinstance(part, Attachment):
        if part.name == ENDING:
            recording.end(part.data)
        elif part.name == GROUPS:
            recording.file_groups = believed_groups(part.data, recording.config)
    elif part.name == PROVENANCE:
        recording.provenance = Provenance.of(part.metadata)
    elif part.name == DROPPED:
        if not 0 <= (dropped := int(part.metadata[COUNT])) < _MOST_DROPPED:
            raise ValueError("no count")
        recording.dropped += dropped


def _know_groups(recording: Recording, file: Path, imports: Imports) -> None:
    """Find out which figures the groups have; RecordingError where neither the file says it nor a behaviour."""
    named = {group.behaviour for group in recording.config.groups if ":" in group.behaviour}
    recording.foreign = frozenset(name for name in sorted(named) if not imports(name))
    try:
        _ = recording.groups
    except (PluginError, ValueError) as error:
        raise RecordingError(f"{file}: it does not say which figures its groups have: {error}") from error


def _config(text: bytes, made_by: str, file: Path) -> Config:
    tree, faults = parse_bytes(text, Source(CONFIG))
    if faults or tree is None:
        raise RecordingError(f"{file}: its configuration cannot be read: {next(map(str, faults), 'it is empty')}")
    try:
        config = Config.model_validate(tree.plain())
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(map(str, fault["loc"]))
        raise RecordingError(
            f"{file}: its configuration is of another version ({where}: {fault['msg']}): install {made_by}"
        ) from error
    for where, message in cross_checks(config):
        raise RecordingError(f"{file}: its configuration is not valid: {where}: {message}")
    return config
