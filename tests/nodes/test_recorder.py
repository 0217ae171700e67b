"""The recorder: everything that is said is in the file, and what is not is counted."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
import zenoh

from robofleet.bus.bus import Arrival
from robofleet.bus.keys import COMMAND, RECORDER, STATE, STATUS, TICK, key
from robofleet.bus.messages import RUN_STATE, RecorderStatus
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.nodes.recorder import Recorder
from robofleet.operator.run import in_lockstep
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import read
from robofleet.recording.run import Recording
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase
from tests.endpoints import own_endpoint
from tests.process_fixtures import Bench
from tests.runs.realrun import RealRun, of_robots, wait

ConfigOf = Callable[..., Config]


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
        self.bench, self.stream, self.folder = Bench(config), Everything(), folder
        self.log = RunLog(folder / FILE, config)
        self.bench.bus.stream = lambda *_, **__: self.stream  # type: ignore[method-assign]
        self.node = Recorder(config, self.bench.bus, np.random.default_rng(1), lambda: self.log, lambda: b"")

    def say(self, full: str, payload: bytes) -> None:
        self.stream.waiting.append(Arrival(self.bench.now_ns, full, payload))

    def newest(self) -> RecorderStatus:
        return self.bench.heard(RECORDER)[-1]


@pytest.fixture
def stand(platoon_of: ConfigOf, tmp_path: Path) -> Iterator[Stand]:
    made = Stand(platoon_of(), tmp_path)
    yield made
    made.log.close()


def test_what_is_said_is_in_the_file_with_its_instant_also_what_came_last(stand: Stand) -> None:
    messages = []
    for k in range(100):
        full = key("platoon", (STATUS, COMMAND)[k % 2], f"r{k % 4}")
        stand.say(full, b"\x03%d" % k)
        messages.append((full, b"\x03%d" % k))
        if k < 90:
            stand.bench.wait(3 * MS)
            stand.node.step(stand.bench.now_ns)
    stand.node.close()
    kept = read(stand.folder)
    assert kept.count == stand.log.messages == 100
    assert kept.messages == {full: [p for f, p in messages if f == full] for full, _ in messages}
    in_order = sorted((index, payload) for full in kept.messages for index, payload in kept.placed(full))
    assert [payload for _, payload in in_order] == [payload for _, payload in messages]


def test_it_says_how_it_goes_four_times_a_second_and_at_once_when_the_disk_fails(stand: Stand) -> None:
    stand.say(key("platoon", TICK), b"\x03")
    stand.bench.run(stand.node, 2 * S)
    assert 8 <= len(stand.bench.heard(RECORDER)) <= 10
    assert stand.newest()[2:] == (1, 0, 0)
    stand.log.failed = "No space left on device"
    before = len(stand.bench.heard(RECORDER))
    stand.bench.run(stand.node, 20 * MS)
    assert len(stand.bench.heard(RECORDER)) == before + 1
    assert stand.newest().failed == 1
    assert [status.seq for status in stand.bench.heard(RECORDER)] == list(range(1, before + 2))


def test_what_its_queue_dropped_is_counted_once(stand: Stand) -> None:
    for dropped in (0, 7, 7, 9):
        stand.stream.dropped = dropped
        stand.bench.run(stand.node, S // 2)
        assert stand.newest().dropped == stand.log.dropped == dropped


@pytest.mark.slow
def test_a_lockstep_runs_summary_is_the_same_from_its_file(platoon_of: ConfigOf, tmp_path: Path) -> None:
    config = platoon_of("tracker.source=truth", "run.duration_s=8")
    lockstep_summary = in_lockstep(config, "platoon", tmp_path, quiet=True).summary
    recording = read(tmp_path)
    outcome = {"outcome": str(recording.outcome), "cause": recording.cause}
    assert recording.trace_hash == lockstep_summary["trace_hash"] is not None
    assert (
        summary(recording, name="platoon", mode="lockstep", **outcome) | {"began": lockstep_summary["began"]}
        == lockstep_summary
    )
    assert lockstep_summary["recording"]["messages"] > 5000
    assert (lockstep_summary["outcome"], lockstep_summary["stops"]) == ("completed", [])

    plain = Lockstep(config)
    plain.run()
    assert plain.recording.trace_hash == lockstep_summary["trace_hash"], "to keep it changes nothing"
    assert plain.recording.messages == recording.messages


def test_a_run_that_is_shown_keeps_the_newest_messages_and_where_they_stood(platoon_of: ConfigOf) -> None:
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
    command = [sys.executable, "-m", "robofleet", "node", "recorder", str(folder / "config.yaml")]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.slow
def test_a_recording_is_not_written_over(platoon_of: ConfigOf, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(resolved_yaml(platoon_of(f"bus.endpoint={own_endpoint()}")))
    (tmp_path / FILE).write_bytes(b"a run")
    refused = recorder(tmp_path)
    assert refused.returncode == 2
    assert refused.stderr == f"{tmp_path / FILE}: File exists: a run is recorded in a folder of its own\n"
    assert (tmp_path / FILE).read_bytes() == b"a run"


TWO_TOGETHER = *of_robots("r1", "r2"), "--set", "drivers.robots_per_process=2"
HELD = "\nheld: the disk is full"


@pytest.mark.long
def test_a_disk_that_is_really_full_holds_the_run_until_there_is_room(
    real_run: Callable[..., RealRun], disk_of: Callable[[str], Path]
) -> None:
    small_disk = disk_of("210m")
    run = real_run(*TWO_TOGETHER, "--duration", "4", "--out", str(small_disk / "run"))
    run.folder = small_disk / "run"
    run.wait_until_running()
    assert len(run.children("driver")) == 1
    ballast = small_disk / "ballast"
    with ballast.open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 12):
            with suppress(OSError):
                while file.write(bytes(size)):
                    pass
    run.wait_for(lambda: HELD in run.said)
    for _ in range(2):  # the second one comes after the recorder has tried to write
        assert run.robofleet("resume").stderr == "refused: the disk is full: mend it, then resume, or stop\n"
    ballast.unlink()
    run.wait_for(lambda: run.robofleet("resume").stdout == "ok\n")
    assert run.ended() == 1, run.said  # it is completed, but its recording has a gap
    assert "results are lost" in run.said
    assert run.summary["outcome"] == "completed"
    recording = read(run.folder)
    assert recording.outcome == "completed"
    heads = [RUN_STATE.decode_head(payload) or () for payload in recording.messages[key("platoon", STATE)]]
    phases = [head[2] for head in heads]
    assert Phase.HOLD in phases
    assert phases[-1] == Phase.IDLE
    assert run.summary["recording"] == {"messages": recording.count, "dropped": recording.dropped}
    assert recording.whole
    assert recording.dropped > 100, "what was said while the disk was full"


@pytest.mark.long
def test_a_disk_that_is_said_to_be_full_holds_a_run_too(real_run: Callable[..., RealRun]) -> None:
    fault = "faults=[{kind: disk_full, at_s: 0.5, duration_s: 1.5}]"
    run = real_run(*TWO_TOGETHER, "--duration", "3", "--set", fault)
    run.wait_until_running()
    run.wait_for(lambda: HELD in run.said)
    run.wait_for(lambda: run.robofleet("resume").stdout == "ok\n")
    assert run.ended() == 0, run.said
    assert run.summary["recording"]["dropped"] == 0, "it was not"


@pytest.mark.slow
def test_a_flood_of_keys_that_nobody_knows_is_not_recorded_and_kills_nobody(
    platoon_of: ConfigOf, tmp_path: Path
) -> None:
    """A file has 65,536 channels at most."""
    config, clock, endpoint = platoon_of(), WallClock(), own_endpoint()
    with ExitStack() as stack:
        router = open_router(endpoint)
        stack.callback(router.close)
        recorder_bus, saying = (ZenohBus("platoon", endpoint, name, clock) for name in ("recorder", "stranger"))
        stack.callback(recorder_bus.close)
        stack.callback(saying.close)
        log = RunLog(tmp_path / FILE, config)
        recorder = Recorder(config, recorder_bus, np.random.default_rng(1), lambda: log, lambda: b"")
        stack.callback(log.close)
        tick = saying.publisher(TICK)

        def recorded(count: int) -> bool:
            recorder.step(clock.now_ns())
            return log.messages > count

        assert wait(lambda: tick(b"\x03") or recorded(3), 5)
        for k in range(66_000):
            saying._session.put(f"rf/platoon/x{k}", b"x", congestion_control=zenoh.CongestionControl.BLOCK)
        before = log.messages
        assert wait(lambda: tick(b"\x03") or recorded(before + 3), 5)
        recorder.close()
    assert read(tmp_path).messages.keys() <= {key("platoon", topic) for topic in (TICK, RECORDER)}
