"""Mending a recording: what a killed run left gets its index, and nothing is lost by trying."""

import errno
import os
from pathlib import Path

import pytest

from robofleet.core.clock import S
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import RecordingError, read
from robofleet.recording.repair import repair
from tests.command import robofleet
from tests.recording import recorded
from tests.recording.recorded import in_order, room_for

CONFIG = recorded.config()
DAMAGE = 8192  # [bytes]: more than a chunk's own index, which nobody misses


@pytest.fixture
def killed(run_messages: recorded.Messages, tmp_path: Path) -> Path:
    """Return the folder of a run whose recorder was killed."""
    file = tmp_path / "run" / FILE
    file.parent.mkdir()
    log = RunLog(file, CONFIG)
    recorded.write(log, run_messages)
    on_disk = file.read_bytes()  # what waits in memory dies with the recorder
    log.close()
    file.write_bytes(on_disk)
    return file.parent


def everything_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_killed_runs_file_is_whole_after_repair_and_holds_what_was_written(
    run_messages: recorded.Messages, killed: Path
) -> None:
    before = read(killed)
    assert not before.whole
    done = repair(killed)
    after = read(killed)
    assert after.whole
    assert in_order(after) == in_order(before)
    last_ns = run_messages[-1][2]
    assert in_order(after) == [(full, payload) for full, payload, _ in run_messages][: done.messages]
    assert done.messages >= sum(at_ns < last_ns - 0.25 * S for _, _, at_ns in run_messages)
    assert (done.kept, done.lost) == (None, 0)
    assert [path.name for path in killed.iterdir()] == [FILE]


def test_a_mended_file_is_the_one_that_would_have_been_written(run_file: Path, tmp_path: Path) -> None:
    whole = run_file.read_bytes()
    torn = tmp_path / FILE
    torn.write_bytes(whole[:-20])  # all is there but the very end
    repair(torn)
    assert torn.read_bytes() == whole


def test_a_whole_file_is_left_as_it_is(run_file: Path, tmp_path: Path) -> None:
    file = tmp_path / FILE
    file.write_bytes(run_file.read_bytes())
    before = file.stat()
    done = repair(file)
    assert done.trouble is None
    assert done.messages == len(in_order(read(file)))
    after = file.stat()
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)


def test_what_is_still_being_recorded_is_refused(run_messages: recorded.Messages, tmp_path: Path) -> None:
    with RunLog(tmp_path / FILE, CONFIG) as log:
        recorded.write(log, run_messages[:500])
        with pytest.raises(RecordingError, match="still being recorded"):
            repair(tmp_path)
        recorded.write(log, run_messages[500:600])
    assert in_order(read(tmp_path)) == [(full, payload) for full, payload, _ in run_messages[:600]]


@pytest.mark.slow_after_first
@pytest.mark.parametrize("room", [0, 5000, 100_000])
def test_a_disk_without_room_for_the_new_file_costs_nothing(room: int, killed: Path) -> None:
    before = everything_in(killed)
    with room_for(room), pytest.raises(OSError, match="too large"):
        repair(killed)
    assert everything_in(killed) == before
    assert repair(killed).messages == len(in_order(read(killed)))


def damaged(folder: Path, at: float) -> bytes:
    """Write over some kilobytes of the file, from a part of its length on; returns the file."""
    data = bytearray((folder / FILE).read_bytes())
    first = round(at * len(data))
    data[first : first + DAMAGE] = b"\xaa" * DAMAGE
    (folder / FILE).write_bytes(data)
    return bytes(data)


def test_a_damaged_file_is_kept_beside_what_could_be_saved(run_messages: recorded.Messages, killed: Path) -> None:
    before = damaged(killed, 0.6)
    done = repair(killed)
    assert done.kept is not None
    assert done.kept.read_bytes() == before
    assert 0 < done.lost < 0.5 * len(before)
    saved = in_order(read(killed))
    assert saved == [(full, payload) for full, payload, _ in run_messages[: done.messages]]
    assert 0.3 * len(run_messages) < len(saved) < 0.7 * len(run_messages)


def test_an_older_damaged_file_is_not_thrown_away(killed: Path) -> None:
    damaged(killed, 0.6)
    repair(killed)
    damaged(killed, 0.3)
    before = everything_in(killed)
    with pytest.raises(FileExistsError):
        repair(killed)
    assert everything_in(killed) == before


def mended(folder: Path) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of the command."""
    result = robofleet("repair", folder)
    return result.exit_code, result.stdout, result.stderr


def test_the_command_says_what_it_did(killed: Path) -> None:
    code, out, _ = mended(killed)
    count = len(in_order(read(killed)))
    assert code == 0
    assert "mended" in out
    assert f"{count} messages over" in out
    code, out, _ = mended(killed)
    assert code == 0
    assert "needs no repair" in out
    damaged(killed, 0.6)
    assert str(killed / f"{FILE}.damaged") in mended(killed)[1]


def test_the_command_ends_with_1_where_there_is_no_room(killed: Path) -> None:
    with room_for(5000):
        code, out, err = mended(killed)
    assert (code, out) == (1, "")
    assert err.count("\n") == 1
    assert os.strerror(errno.EFBIG) in err


@pytest.mark.parametrize(
    ("content", "says"),
    [(None, "no such recording"), (b"", "not a recording"), (b"not at all an mcap", "not a recording")],
)
def test_what_is_no_recording_is_refused_in_a_line(content: bytes | None, says: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / FILE).write_bytes(content)
    code, out, err = mended(tmp_path)
    assert (code, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1
    with pytest.raises(RecordingError, match=says):
        read(tmp_path)
