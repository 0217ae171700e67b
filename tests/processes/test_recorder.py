"""The recorder: everything that is said is in the file, and what is not is counted."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from robofleet.clock import MS, S, WallClock
from robofleet.comms.bus import Arrival
from robofleet.comms.keys import COMMAND, RECORDER, STATUS, TICK, key
from robofleet.comms.messages import RecorderStatus
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.processes.lockstep import Lockstep
from robofleet.processes.recorder import Recorder
from robofleet.processes.run import in_lockstep
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.metrics import summary
from robofleet.recording.reading import read
from tests.processes.conftest import Bench

ConfigOf = Callable[..., Config]
CLOCK = WallClock()


class Everything:
    """A stream of all keys, in the test's hands."""

    def __init__(self) -> None:
        self.waiting: list[Arrival] = []
        self.dropped = 0

    def drain(self) -> list[Arrival]:
        came, self.waiting = self.waiting, []
        return came


class Stand:
    """A recorder on a bench that hears what a test says."""

    def __init__(self, config: Config, folder: Path) -> None:
        self.bench, self.heard, self.folder = Bench(config), Everything(), folder
        self.log = RunLog(folder / FILE, config)
        self.bench.bus.stream = lambda *_: self.heard  # type: ignore[method-assign]
        self.node = Recorder(config, self.bench.bus, np.random.default_rng(1), self.log, lambda: b"")

    def say(self, full: str, payload: bytes) -> None:
        self.heard.waiting.append(Arrival(self.bench.now_ns, full, payload))

    def newest(self) -> RecorderStatus:
        return self.bench.heard(RECORDER)[-1]


@pytest.fixture
def stand(platoon_of: ConfigOf, tmp_path: Path) -> Iterator[Stand]:
    made = Stand(platoon_of(), tmp_path)
    yield made
    made.log.close()


def test_what_is_said_is_in_the_file_with_its_instant_also_what_came_last(stand: Stand) -> None:
    said = []
    for k in range(100):
        full = key("platoon", (STATUS, COMMAND)[k % 2], f"r{k % 4}")
        stand.say(full, b"\x03%d" % k)
        said.append((full, b"\x03%d" % k))
        if k < 90:
            stand.bench.wait(3 * MS)
            stand.node.step(stand.bench.now_ns)
    stand.node.close()
    kept = read(stand.folder)
    assert kept.count == stand.log.messages == 100
    assert kept.messages == {full: [p for f, p in said if f == full] for full, _ in said}
    in_order = sorted((place, payload) for full in kept.messages for place, payload in kept.placed(full))
    assert [payload for _, payload in in_order] == [payload for _, payload in said]


def test_it_says_how_it_goes_four_times_a_second_and_at_once_when_the_disk_fails(stand: Stand) -> None:
    stand.say(key("platoon", TICK), b"\x03")
    stand.bench.run(stand.node, 2 * S)
    assert 8 <= len(stand.bench.heard(RECORDER)) <= 10
    assert stand.newest()[2:] == (1, 0, 0)
    stand.log.failed = True
    before = len(stand.bench.heard(RECORDER))
    stand.bench.run(stand.node, 20 * MS)
    assert len(stand.bench.heard(RECORDER)) == before + 1
    assert stand.newest().failed == 1
    assert [status.seq for status in stand.bench.heard(RECORDER)] == list(range(1, before + 2))


def test_what_its_queue_dropped_is_counted_once(stand: Stand) -> None:
    for dropped in (0, 7, 7, 9):
        stand.heard.dropped = dropped
        stand.bench.run(stand.node, S // 2)
        assert stand.newest().dropped == stand.log.dropped == dropped


def test_a_lockstep_runs_summary_is_the_same_from_its_file(platoon_of: ConfigOf, tmp_path: Path) -> None:
    config = platoon_of("tracker.source=truth", "run.duration_s=8")
    told = in_lockstep(config, "platoon", tmp_path, quiet=True)
    recording = read(tmp_path)
    outcome = {"outcome": str(recording.outcome), "cause": recording.cause}
    assert recording.trace_hash == told["trace_hash"] is not None
    assert summary(recording, name="platoon", mode="lockstep", **outcome) == told
    assert told["recording"]["messages"] > 5000
    assert (told["outcome"], told["stops"]) == ("completed", [])

    plain = Lockstep(config)
    plain.run()
    assert plain.recording.trace_hash == told["trace_hash"], "to keep it changes nothing"
    assert plain.recording.messages == recording.messages


def test_a_run_that_is_shown_keeps_the_newest_messages_and_where_they_stood(platoon_of: ConfigOf) -> None:
    from robofleet.recording.run import Recording

    recording = Recording(platoon_of())
    for k in range(1000):
        recording.add("rf/platoon/often", b"%d" % k)
        if k % 100 == 0:
            recording.add("rf/platoon/rare", b"%d" % k)
        recording.keep_newest(20)
        assert len(recording.messages["rf/platoon/often"]) <= 40
    assert recording.messages["rf/platoon/rare"] == [b"%d" % k for k in range(0, 1000, 100)]
    newest = list(recording.placed("rf/platoon/often"))[-20:]
    assert newest == [(k + 11, b"%d" % k) for k in range(980, 1000)]


def recorder(folder: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "robofleet", "recorder", str(folder / "config.yaml")]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_a_recording_is_not_written_over(platoon_of: ConfigOf, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(resolved_yaml(platoon_of("bus.endpoint=tcp/127.0.0.1:7447")))
    (tmp_path / FILE).write_bytes(b"a run")
    refused = recorder(tmp_path)
    assert refused.returncode == 2
    assert refused.stderr == f"{tmp_path / FILE}: File exists: a run is recorded in a folder of its own\n"
    assert (tmp_path / FILE).read_bytes() == b"a run"
