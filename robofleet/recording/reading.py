"""A run read back from its file."""

import tempfile
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message
from mcap.stream_reader import StreamReader

from robofleet.config.load import load_config
from robofleet.recording.log import CONFIG, ENCODING, ENDING, FILE
from robofleet.recording.run import Recording


class RecordingError(Exception):
    """A file that holds no run, or not one of this version; the message is a line."""


def read(run: Path) -> Recording:
    """Return the messages of a run: its folder, or its file. RecordingError where there is none that can be read."""
    file = run / FILE if run.is_dir() else run
    recording: Recording | None = None
    channels: dict[int, str] = {}
    try:
        with file.open("rb") as stream:
            for record in StreamReader(stream).records:
                if isinstance(record, Attachment) and record.name == CONFIG:
                    recording = Recording(_config(record.data))
                elif isinstance(record, Attachment) and record.name == ENDING and recording is not None:
                    recording.end(record.data)
                elif isinstance(record, Channel) and record.message_encoding == ENCODING:
                    channels[record.id] = record.topic
                elif isinstance(record, Message) and record.channel_id in channels and recording is not None:
                    recording.add(channels[record.channel_id], record.data)
    except (OSError, McapError) as error:
        raise RecordingError(f"{file}: {error}") from error
    if recording is None:
        raise RecordingError(f"{file}: no recording of a run")
    return recording


def _config(text: bytes):  # type: ignore[no-untyped-def]
    with tempfile.NamedTemporaryFile(suffix=".yaml") as file:
        file.write(text)
        file.flush()
        return load_config(Path(file.name))
