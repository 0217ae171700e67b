"""A run's file: what is in it, when it is in it, and what it says of what is not."""

import errno
import hashlib
import os
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader

from robofleet.bus.keys import CAMERA, NEWS, STATE, STATUS, TICK, TRUTH, key
from robofleet.bus.messages import RUN_STATE, TICK_RECORD, TRACKER_NEWS, RunState, TrackerNews
from robofleet.config.load import resolved_yaml
from robofleet.core.clock import MS, S
from robofleet.recording.channels import ENCODING, keys
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.provenance import Provenance
from robofleet.recording.reading import read
from robofleet.recording.run import Recording
from robofleet.safety.supervisor import NOBODY, Phase
from tests.bus.alone import ROBOT_STATUS, RobotStatus
from tests.recording import recorded
from tests.recording.recorded import in_order, index, room_for

README = Path(__file__).parent.parent.parent / "robofleet" / "recording" / "README.md"
CONFIG = recorded.config()
ARENA = CONFIG.arena.name
TRUTH_KEY = key(ARENA, TRUTH, "r1")


def as_if_killed(file: Path, copy: Path) -> Recording:
    """Read what would be there if the recorder were killed now."""
    copy.write_bytes(file.read_bytes())
    return read(copy)


@pytest.fixture
def log(tmp_path: Path) -> Iterator[RunLog]:
    with RunLog(tmp_path / FILE, CONFIG) as log:
        yield log


@pytest.fixture
def written(tmp_path: Path) -> Callable[[], list[tuple[str, bytes]]]:
    """Return what tells the messages that are in the file of a log that is still open."""

    def messages() -> list[tuple[str, bytes]]:
        return in_order(as_if_killed(tmp_path / FILE, tmp_path / "killed.mcap"))

    return messages


def test_every_message_of_a_run_comes_back_in_its_order(run_messages: recorded.Messages, run_file: Path) -> None:
    recording = read(run_file)
    assert in_order(recording) == [(full, payload) for full, payload, _ in run_messages]
    assert recording.whole
    assert recording.dropped == 0
    assert read(run_file.parent).messages == recording.messages


CALIBRATED = "robots.1.calibration={robot: r2, delay_s: 0.00001}"


@pytest.mark.parametrize("overrides", [(), ("arena.name='on'", CALIBRATED)])
def test_a_file_holds_the_configuration_and_where_it_comes_from(overrides: tuple[str, ...], tmp_path: Path) -> None:
    config = recorded.config(*overrides)
    with RunLog(tmp_path / FILE, config, epoch_ns=5) as log:
        log.add(key(config.arena.name, STATE), b"something", 0)
    recording = read(tmp_path)
    assert recording.config == config
    assert recording.provenance == Provenance.here(config, "realtime", 5)


def test_each_hash_changes_with_what_it_is_of() -> None:
    plain = Provenance.here(CONFIG, "lockstep").hashes
    calibrated = Provenance.here(recorded.config(CALIBRATED), "lockstep").hashes
    moved = Provenance.here(recorded.config("camera.model.focal_px=[831, 830]", CALIBRATED), "lockstep").hashes
    assert set(calibrated) - set(plain) == {"robots.1.calibration"}
    assert {name for name in calibrated if calibrated[name] != moved[name]} == {"camera.model", "config.yaml"}
    assert plain["config.yaml"] == hashlib.sha256(resolved_yaml(CONFIG).encode()).hexdigest()


def test_two_runs_are_of_the_same_machine_when_versions_and_processors_are_equal(run_file: Path) -> None:
    recorded_there, here = read(run_file).provenance, Provenance.here(CONFIG, "realtime", 7)
    assert recorded_there is not None
    assert recorded_there.same_machine(here)
    assert not recorded_there.same_machine(replace(here, processor="another"))
    assert not recorded_there.same_machine(replace(here, versions=here.versions | {"numba": "0.1"}))
    older = {name: version for name, version in here.versions.items() if name != "onnxruntime"}
    assert recorded_there.same_machine(replace(here, versions=older))  # it could not run what came later


@pytest.mark.slow
def test_the_same_run_in_lockstep_leaves_the_same_bytes(run_file: Path, tmp_path: Path) -> None:
    with RunLog(tmp_path / FILE, CONFIG) as log:
        recorded.write(log, recorded.said_in(CONFIG))
    assert (tmp_path / FILE).read_bytes() == run_file.read_bytes()


def test_the_counts_of_the_file_are_those_of_its_messages(run_messages: recorded.Messages, run_file: Path) -> None:
    summary, counts = index(run_file)
    with run_file.open("rb") as stream:
        stored = [
            (channel, message.data) for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]
    assert {topic: count for topic, count in counts.items() if count} == Counter(channel.topic for channel, _ in stored)
    assert summary.statistics is not None and summary.statistics.message_count == len(stored)
    own = [(channel.topic, data) for channel, data in stored if channel.message_encoding == ENCODING]
    assert sorted(own) == sorted((full, payload) for full, payload, _ in run_messages)


def test_all_channels_that_the_configuration_knows_are_there_from_the_first_message_on(
    log: RunLog, tmp_path: Path
) -> None:
    log.add(TRUTH_KEY, b"first", 0)
    log.close()
    summary, _ = index(tmp_path / FILE)
    own = {channel.topic for channel in summary.channels.values() if channel.message_encoding == ENCODING}
    assert own == set(keys(CONFIG))


def test_nothing_but_requests_is_new_to_the_file_in_a_run(run_messages: recorded.Messages) -> None:
    assert {full for full, _, _ in run_messages} - set(keys(CONFIG)) == {f"rf/{ARENA}/request/supervisor"}


def test_a_stranger_decodes_the_file_with_the_lines_of_the_readme(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(run_file.parent)
    code = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert code is not None
    assert "robofleet." not in code[1]  # a stranger has nothing of ours
    exec(code[1], {})
    printed = [[float(word) for word in line.split()] for line in capsys.readouterr().out.splitlines()]
    ticks = [TICK_RECORD.decode(payload) for payload in read(run_file).messages[key(ARENA, TICK)]]
    assert printed == [[tick.run_tick, tick.robots[0].x_m, tick.robots[0].y_m] for tick in ticks if tick is not None]
    assert len(printed) > 100


def test_what_came_a_quarter_of_a_second_ago_is_in_the_file(
    log: RunLog, written: Callable[[], list[tuple[str, bytes]]]
) -> None:
    log.flush(10 * S)
    log.add(TRUTH_KEY, b"one", 10 * S)
    log.flush(10 * S + 250 * MS)
    log.add(TRUTH_KEY, b"two", 10 * S + 300 * MS)
    log.flush(10 * S + 400 * MS)  # a block is not written for each message
    assert written() == [(TRUTH_KEY, b"one")]
    log.flush(10 * S + 500 * MS)
    assert written() == [(TRUTH_KEY, b"one"), (TRUTH_KEY, b"two")]


def state(**changes: int) -> bytes:
    """Return a word of the supervisor's."""
    return RUN_STATE.encode(RunState(1, 1, Phase.RUNNING, 0, NOBODY, 0.0, 0, ())._replace(**changes))


def status(**changes: int) -> bytes:
    """Return a word of a driver's."""
    return ROBOT_STATUS.encode(RobotStatus._make([0] * len(RobotStatus._fields))._replace(**changes))


def news(seq: int) -> bytes:
    return TRACKER_NEWS.encode(TrackerNews(1, seq, 0, 1, 1, 0.0))


@pytest.mark.parametrize(
    ("full", "before", "same", "changed"),
    [
        (key(ARENA, STATE), state(), state(seq=2, stage=3), state(phase=Phase.HOLD)),
        (key(ARENA, STATE), state(), state(seq=2, robot=1), state(cause=7)),
        (key(ARENA, STATUS, "r3"), status(), status(seq=2, nonce=7, gate=1), status(latch=2)),
        (key(ARENA, STATUS, "r3"), status(latch_id=1), status(latch_id=1, seq=2), status(latch_id=2)),
        (key(ARENA, NEWS, CAMERA), news(1), None, news(2)),
    ],
    ids=["phase", "cause", "latch", "latch again", "news"],
)
def test_a_change_that_matters_to_safety_is_in_the_file_at_once(
    full: str, before: bytes, same: bytes | None, changed: bytes, log: RunLog,
    written: Callable[[], list[tuple[str, bytes]]],
) -> None:  # fmt: skip
    log.add(full, before, 0)
    counts = [(full, before)]
    assert written() == counts
    for payload, at_once in ((same, False), (changed, True)):
        if payload is not None:
            log.add(full, payload, 0)
            counts.append((full, payload))
            assert (written() == counts) == at_once


def test_another_robots_latch_is_another_matter(log: RunLog, written: Callable[[], list[tuple[str, bytes]]]) -> None:
    log.add(key(ARENA, STATUS, "r1"), status(latch=1), 0)
    log.add(key(ARENA, STATUS, "r2"), status(latch=1), 0)
    assert len(written()) == 2


def test_messages_that_never_came_are_counted_in_the_file_even_of_a_killed_run(log: RunLog, tmp_path: Path) -> None:
    log.drop(3)
    log.add(TRUTH_KEY, b"one", 0)
    log.flush(S)
    log.drop(4)
    log.add(TRUTH_KEY, b"two", 0)
    log.flush(2 * S)
    log.drop(5)
    assert as_if_killed(tmp_path / FILE, tmp_path / "killed.mcap").dropped == 7
    log.close()
    assert read(tmp_path).dropped == log.dropped == 12


def test_a_recording_is_never_written_over(log: RunLog, tmp_path: Path) -> None:
    with pytest.raises(FileExistsError):
        RunLog(tmp_path / FILE, CONFIG)


def noise(k: int) -> bytes:
    """Return a message that does not compress."""
    return hashlib.shake_256(str(k).encode()).digest(1000)


@pytest.mark.parametrize("room", [1, 2500])
def test_a_full_disk_leaves_a_valid_beginning_and_writing_goes_on_when_there_is_room(
    room: int, log: RunLog, tmp_path: Path
) -> None:
    file, dropped, size, limit = tmp_path / FILE, list[int](), 0, 0
    for k in range(1, 31):
        limit = size + room if k == 11 else limit
        with room_for(limit) if 11 <= k < 21 else nullcontext():
            log.add(TRUTH_KEY, noise(k), k * S)
            log.flush(k * S)
        if log.failed:
            dropped.append(k)
            assert file.stat().st_size == size  # no half of a block
        size = file.stat().st_size
        in_file = as_if_killed(file, tmp_path / "killed.mcap").messages[TRUTH_KEY]
        assert in_file == [noise(j) for j in range(1, k + 1) if j not in dropped]
    assert dropped[-1] == 20
    assert len(dropped) == 10 - room // 1100
    log.close()
    recording = read(file)
    assert recording.whole
    assert recording.dropped == log.dropped == len(dropped)
    assert index(file)[1][TRUTH_KEY] == 30 - len(dropped)


def test_a_disk_that_is_full_from_the_start_costs_the_messages_but_not_the_configuration(tmp_path: Path) -> None:
    with room_for(0):
        log = RunLog(tmp_path / FILE, CONFIG)
        log.add(TRUTH_KEY, b"lost", 0)
        log.flush(S)
        assert log.failed
    log.add(TRUTH_KEY, b"kept", S)
    log.close()
    recording = read(tmp_path)
    assert recording.messages[TRUTH_KEY] == [b"kept"]
    assert recording.config == CONFIG
    assert recording.dropped == 1


def test_a_file_that_finds_no_room_for_its_end_is_read_all_the_same(log: RunLog, tmp_path: Path) -> None:
    log.add(TRUTH_KEY, b"kept", 0)
    log.flush(S)
    with room_for((tmp_path / FILE).stat().st_size + 20):
        log.close()
    assert log.failed
    recording = read(tmp_path)
    assert recording.messages[TRUTH_KEY] == [b"kept"]
    assert not recording.whole


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Return a folder on a disk of its own of 256 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"NOT TESTED: a really full disk: mounting one needs root ({mounted.stderr.decode().strip()})")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_disk_that_is_really_full_leaves_what_was_written(small_disk: Path, tmp_path: Path) -> None:
    with RunLog(small_disk / FILE, CONFIG) as log:
        for k in range(1, 401):
            log.add(TRUTH_KEY, noise(k), k * 250 * MS)
            log.flush(k * 250 * MS)
        assert log.failed == os.strerror(errno.ENOSPC)
        kept = as_if_killed(small_disk / FILE, tmp_path / "killed.mcap").messages[TRUTH_KEY]
        assert 150 < len(kept) < 400
        assert kept == [noise(k) for k in range(1, len(kept) + 1)]
    assert log.dropped == 400 - len(kept)
    assert read(small_disk).messages[TRUTH_KEY] == kept
