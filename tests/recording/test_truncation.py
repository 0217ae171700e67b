"""A recording that is cut or damaged anywhere gives a valid beginning of its messages, and never an exception."""

from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC as MAGIC
from mcap.writer import Writer

from robofleet.bus.layouts import VERSION
from robofleet.recording.chunks import RECORD
from robofleet.recording.log import FILE, LIBRARY, RunLog
from robofleet.recording.reading import RecordingError, read
from robofleet.recording.repair import repair
from tests.recording import recorded
from tests.recording.recorded import in_order

SAID = 300  # messages: the first half second
CUTS, FLIPS = 30, 15


@pytest.fixture(scope="module")
def whole(run_messages: recorded.Messages, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a run's first seconds."""
    file = tmp_path_factory.mktemp("whole") / FILE
    with RunLog(file, recorded.config()) as log:
        recorded.write(log, run_messages[:SAID])
    return file.read_bytes()


def mended(file: Path) -> list[tuple[str, bytes]] | None:
    """Return the messages of a file after its repair; None where there was nothing to be saved."""
    try:
        repair(file)
    except RecordingError:
        return None
    recording = read(file)
    assert recording.whole
    file.with_name(f"{FILE}.damaged").unlink(missing_ok=True)
    return in_order(recording)


def survives(run_messages: recorded.Messages, data: bytes, file: Path) -> tuple[int, bool]:
    """Check that a file gives a valid beginning, before and after its repair.

    Returns how many messages, and whether the file was said to be whole.
    """
    file.write_bytes(data)
    try:
        recording = read(file)
    except RecordingError as error:
        assert "\n" not in str(error)
        assert str(error).startswith(str(file))
        assert mended(file) is None
        return 0, False
    found = in_order(recording)
    assert found == [(full, payload) for full, payload, _ in run_messages[: len(found)]]
    assert recording.whole or mended(file) == found
    return len(found), recording.whole


@pytest.mark.slow
def test_a_file_cut_anywhere_gives_a_valid_beginning(
    run_messages: recorded.Messages, whole: bytes, tmp_path: Path
) -> None:
    cuts = sorted(np.random.default_rng(1).choice(len(whole), CUTS, replace=False))
    results = [survives(run_messages, whole[:cut], tmp_path / FILE) for cut in cuts]
    assert not any(is_whole for _, is_whole in results)
    counts = [count for count, _ in results]
    assert counts == sorted(counts)  # a longer beginning never tells less
    assert counts[-1] == SAID
    assert max(np.diff(counts)) < 0.9 * SAID  # it is not all or nothing


def flipped(data: bytes, at: int, bit: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]


def test_a_bit_that_flips_anywhere_ends_the_recording_there(
    run_messages: recorded.Messages, whole: bytes, tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    for at, bit in zip(rng.choice(len(whole), FLIPS, replace=False), rng.integers(8, size=FLIPS), strict=True):
        assert not survives(run_messages, flipped(whole, at, bit), tmp_path / FILE)[1]


def test_no_block_that_became_something_else_is_passed_over(
    run_messages: recorded.Messages, whole: bytes, tmp_path: Path
) -> None:
    torn = whole[: round(0.8 * len(whole))]  # no checksum of all the data comes
    at, opcodes = len(MAGIC), []
    while at < len(torn):
        opcodes.append(at)
        at += RECORD.size + RECORD.unpack_from(torn, at)[1]
    blocks = [at for at in opcodes if torn[at] == Opcode.CHUNK][:3]
    for at in (opcodes[0], *blocks):
        for bit in range(8):
            assert not survives(run_messages, flipped(torn, at, bit), tmp_path / FILE)[1]


@pytest.mark.parametrize("tail", [bytes(1000), b"\xff" * 1000, b"\x06" + bytes(500)])
def test_garbage_behind_the_last_block_is_left_out(
    tail: bytes, run_messages: recorded.Messages, whole: bytes, tmp_path: Path
) -> None:
    file = tmp_path / FILE
    file.write_bytes(whole[: len(whole) // 2])
    repair(file)
    cut = in_order(read(file))
    end = (tmp_path / FILE).read_bytes()
    file.write_bytes(end + tail)
    recording = read(file)
    assert in_order(recording) == cut
    assert not recording.whole


def foreign(file: Path, profile: str, library: str) -> None:
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile, library)
        channel = writer.register_channel("speed", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()


@pytest.mark.parametrize(
    ("profile", "library", "says"),
    [
        ("ros2", "libmcap 1.4.0", "is not a recording of robofleet: it was made by libmcap 1.4.0"),
        ("robofleet", "robofleet", "is not a recording of robofleet"),
        ("robofleet", LIBRARY.format("0.1.0", 2), f"wire version 2 of robofleet 0.1.0; this one reads {VERSION}:"),
        ("robofleet", LIBRARY.format("9.1.0", VERSION + 1), f"wire version {VERSION + 1} of robofleet 9.1.0"),
    ],
)
def test_a_file_of_somebody_else_is_refused_in_a_line(profile: str, library: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / FILE
    foreign(file, profile, library)
    for refusing in (read, repair):
        with pytest.raises(RecordingError) as error:
            refusing(file)
        assert says in str(error.value)
        assert "\n" not in str(error.value)


def test_an_empty_run_is_refused_in_a_line(tmp_path: Path) -> None:
    RunLog(tmp_path / FILE, recorded.config()).close()
    for refusing in (read, repair):
        with pytest.raises(RecordingError, match="no message"):
            refusing(tmp_path)


def test_a_configuration_of_another_version_is_refused_in_a_line(tmp_path: Path) -> None:
    config = recorded.config()
    strange = config.model_copy(update={"arena": config.arena.model_copy(update={"size_m": (-1.0, 2.0)})})
    with RunLog(tmp_path / FILE, strange) as log:
        log.add("rf/platoon/tick", b"something", 0)
    with pytest.raises(RecordingError, match=r"arena\.size_m") as error:
        read(tmp_path)
    assert "\n" not in str(error.value)
