"""The file of a run in lockstep, written by a process of its own."""

import multiprocessing
from contextlib import closing
from pathlib import Path

import pytest

from robofleet.core.clock import MS
from robofleet.recording.beside import LogBeside
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import RecordingError, read
from tests.recording import recorded
from tests.recording.recorded import in_order

CONFIG = recorded.config()


def instants(messages: recorded.Messages) -> list[tuple[int, list[tuple[str, bytes]]]]:
    """Return the messages of a run, five at an instant."""
    return [(k * MS, [message[:2] for message in messages[k : k + 5]]) for k in range(0, len(messages), 5)]


def test_the_file_has_the_bytes_that_the_log_writes_here(run_messages: recorded.Messages, tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    with (
        RunLog(tmp_path / "here" / FILE, CONFIG, batched=True) as here,
        closing(LogBeside(tmp_path / FILE, CONFIG)) as beside,
    ):
        for at_ns, messages in instants(run_messages):
            here.add_all(messages, at_ns)
            beside.add_all(messages, at_ns)
        here.end(b"{}")
        beside.end(b"{}")
    assert (tmp_path / FILE).read_bytes() == (tmp_path / "here" / FILE).read_bytes()
    assert (beside.messages, beside.dropped, beside.failed) == (here.messages, 0, None)


def test_a_log_that_was_killed_is_told_and_ends_no_run(run_messages: recorded.Messages, tmp_path: Path) -> None:
    with closing(LogBeside(tmp_path / FILE, CONFIG)) as beside:
        (process,) = multiprocessing.active_children()
        process.kill()
        process.join()
        for at_ns, messages in instants(run_messages):
            beside.add_all(messages, at_ns)
    assert beside.messages == beside.dropped > 100
    assert beside.failed == "the process that writes it was killed"
    with pytest.raises(RecordingError, match="the file ends before its index"):
        read(tmp_path / FILE)


def test_a_run_that_ends_without_a_word_leaves_a_whole_file(run_messages: recorded.Messages, tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), closing(LogBeside(tmp_path / FILE, CONFIG)) as beside:
        for at_ns, messages in instants(run_messages):
            beside.add_all(messages, at_ns)
        raise ZeroDivisionError
    recording = read(tmp_path / FILE)
    assert recording.whole
    assert len(in_order(recording)) == beside.messages


def test_an_old_file_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"a run")
    with pytest.raises(FileExistsError):
        LogBeside(tmp_path / FILE, CONFIG)
    assert (tmp_path / FILE).read_bytes() == b"a run"
