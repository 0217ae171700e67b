"""What a driver must remember: leases are given once, latches outlive a restart, a full disk gives nothing away."""

import io
import json
import os
import sys
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from robofleet.bus.keys import LEASE, STATUS
from robofleet.bus.layouts import VERSION
from robofleet.bus.messages import LEASE_REQUEST, LeaseRequest
from robofleet.core.clock import MS, S
from robofleet.core.log_lines import Unfailing
from robofleet.nodes.unit.gated_robot import Complaints
from robofleet.nodes.unit.state_store import FileStateStore, MemoryStateStore, StoredRobot
from robofleet.safety.gate import LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, WheelSpeeds

Make = Callable[..., Any]
FORWARD = WheelSpeeds(3.0, 4.0)
OTHER = 55
THIS = bytes([VERSION])  # of the wire


class Disk(MemoryStateStore):
    """A memory that may be full, and that knows when it was written to; to lose what is there takes no room."""

    def __init__(self) -> None:
        super().__init__()
        self.full = False
        self.tries: list[tuple[str, StoredRobot]] = []

    def save(self, robot: str, kept: StoredRobot) -> None:
        self.tries.append((robot, kept))
        if self.full:
            raise OSError(28, "No space left on device")
        super().save(robot, kept)


@pytest.fixture
def disk() -> Disk:
    return Disk()


@pytest.fixture
def stand(stand: Any, driver_of: Make, disk: Disk) -> Any:
    stand.restart = lambda seed: setattr(stand, "node", driver_of(stand.bench, "r1", "r2", state_store=disk, seed=seed))
    stand.restart(1)
    return stand


def test_the_epoch_is_on_disk_before_the_answer_is_out(stand: Any, disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = []
    save = disk.save
    monkeypatch.setattr(disk, "save", lambda *what: (answers.append(answer.take()), save(*what)))
    answer = stand.bench.bus.ask(LEASE, "r1", LEASE_REQUEST.encode(LeaseRequest(99, LeaseAction.ACQUIRE)))
    stand.node.step(stand.bench.now_ns)
    assert answers == [None, None]
    assert disk.load("r1").epoch == 1
    assert answer.take() is not None


def test_no_epoch_is_given_twice_whatever_restarts(stand: Any) -> None:
    epochs = []
    for seed in range(2, 6):
        epochs.append(stand.ask("r1").epoch)
        stand.restart(seed)
    assert epochs == [1, 2, 3, 4]


def test_a_second_controller_is_refused_until_the_first_is_silent_or_is_taken_over(stand: Any) -> None:
    stand.run(S // 5)
    answer = stand.ask("r1", session=OTHER)
    assert (answer.granted, answer.session) == (0, stand.SESSION)
    assert stand.ask("r1", LeaseAction.TAKE_OVER, OTHER).granted == 0  # in motion
    stand.run(S // 2, enables=False)
    assert stand.made["r1"].target == STOP
    assert stand.ask("r1", session=OTHER).granted == 0  # at rest, but not silent
    assert stand.ask("r1", LeaseAction.TAKE_OVER, OTHER).granted == 1
    stand.run(S // 5)
    assert stand.made["r1"].target == STOP
    assert stand.newest("r1").session == OTHER
    assert stand.ask("r1").granted == 0
    stand.bench.run(stand.node, S)
    assert stand.ask("r1").granted == 1


def test_a_released_robot_comes_to_rest_and_is_free(stand: Any) -> None:
    stand.run(S // 5)
    assert stand.ask("r1", LeaseAction.RELEASE, OTHER).granted == 0
    released_ns = stand.bench.now_ns
    assert stand.ask("r1", LeaseAction.RELEASE).granted == 1
    stand.bench.run(stand.node, 110 * MS)
    stopped_ns = next(at for at, wheels in stand.made["r1"].writes if at > released_ns and wheels == STOP)
    assert 5 * MS < stopped_ns - released_ns <= 60 * MS  # 4 rad/s at 300 rad/s^2, with limited acceleration
    assert stand.newest("r1").gate == GateStatus.NO_LEASE
    assert stand.ask("r1", session=OTHER).granted == 1


@pytest.mark.parametrize("payload", [b"", THIS + b"rubbish", THIS + bytes(8) + b"\7", THIS + bytes(8) + b"\1"])
def test_a_request_that_says_nothing_gets_nothing(stand: Any, payload: bytes) -> None:
    stand.bench.bus.ask(LEASE, "r1", payload)
    stand.bench.run(stand.node, 25 * MS)
    status = stand.newest("r1")
    assert (status.session, status.epoch, status.gate) == (0, 0, GateStatus.NO_LEASE)
    assert stand.ask("r1").granted == 1


def test_a_full_disk_refuses_the_lease_and_says_so_once(
    stand: Any, disk: Disk, capsys: pytest.CaptureFixture[str]
) -> None:
    stand.ask("r1", session=OTHER)
    stand.ask("r1", LeaseAction.RELEASE, OTHER)
    disk.full = True
    for _ in range(3):
        answer = stand.ask("r1")
        assert (answer.granted, answer.epoch, answer.session) == (0, 1, 0)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").gate == GateStatus.NO_LEASE
    assert capsys.readouterr().err.splitlines() == [
        f"{robot}: its lease and its latch cannot be written to disk: [Errno 28] No space left on device"
        for robot in ("r1", "r2")
    ]
    disk.full = False
    answer = stand.ask("r1")
    assert (answer.granted, answer.epoch) == (1, 2)


def test_a_latch_that_cannot_be_kept_holds_all_the_same_and_is_kept_when_it_can_be(stand: Any, disk: Disk) -> None:
    stand.run(S // 5)
    disk.full = True
    stand.enable("r1", latch=Latch.EMERGENCY_STOP)
    stand.run(S // 2)
    assert (stand.newest("r1").gate, stand.made["r1"].target) == (GateStatus.LATCHED, STOP)
    disk.full = False
    stand.run(S // 5)
    assert disk.load("r1").latch is Latch.EMERGENCY_STOP


def test_a_latch_outlives_a_restart_and_a_drill_does_not(stand: Any, disk: Disk) -> None:
    for robot, latch in (("r1", Latch.EMERGENCY_STOP), ("r2", Latch.DRILL)):
        stand.acquire(robot)
        stand.enable(robot, latch=latch)
        stand.bench.run(stand.node, 25 * MS)
        assert stand.newest(robot).latch == latch
    stand.restart(2)
    stand.bench.run(stand.node, 25 * MS)
    assert [stand.newest(robot).latch for robot in ("r1", "r2")] == [Latch.EMERGENCY_STOP, Latch.NONE]
    stand.enable("r1", clear=stand.newest("r1").latch_id)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.NONE
    stand.restart(3)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.NONE


def test_the_disk_is_slow_and_no_other_robot_waits_for_it(
    stand: Any, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are stopped at once: when r1's latch goes to the disk, r2's wheels have been told."""
    stand.acquire("r1")
    stand.run(S // 5, robot="r2")
    assert stand.made["r2"].target == FORWARD
    reports: list[Any] = []
    monkeypatch.setattr(disk, "save", lambda robot, _: reports.append((robot, stand.made["r2"].target)))
    stand.enable("r1", "r2", latch=Latch.EMERGENCY_STOP)
    stand.bench.wait(5 * MS)
    stand.node.step(stand.bench.now_ns)
    assert [robot for robot, _ in reports] == ["r1", "r2"]
    assert all(wheels.left < FORWARD.left for _, wheels in reports)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "robofleet" / "lab"


def test_what_is_kept_is_found_again(folder: Path) -> None:
    state_store = FileStateStore("lab")
    assert state_store.load("r1") == StoredRobot()
    for kept in (StoredRobot(3, Latch.WIRED_STOP, 2), StoredRobot(4, Latch.NONE, 2)):
        state_store.save("r1", kept)
        assert FileStateStore("lab").load("r1") == kept
    assert FileStateStore("lab").load("r2") == StoredRobot()
    assert FileStateStore("elsewhere").load("r1") == StoredRobot()
    assert [file.name for file in folder.iterdir()] == ["r1.json"]


def whole(number: int = 1, epoch: Any = 1, latch: Any = 0, latch_id: Any = 0) -> str:
    """Return a file that says this, whoever wrote it: its checksums are right."""
    record = {"number": number, "epoch": epoch, "latch": latch, "latch_id": latch_id}
    half = json.dumps(record | {"check": zlib.crc32(json.dumps(record).encode())})
    return (half[:-1] + ",").ljust(4096) + ('"spare": ' + half + "}").ljust(4096)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "rubbish",
        "[]",
        "3",
        "null",
        "{}",
        "[" * 4000,
        '{"epoch": 1, "latch": 0, "latch_id": 0}',  # as version 3 wrote it
        whole().replace('"epoch": 1', '"epoch": 2'),
        whole().replace('"latch": 0', '"latch": 1'),
        whole(latch=19, latch_id=1),
        whole(epoch=-1),
        whole(latch_id=-1),
        whole(number=-1),
        whole(epoch=1 << 63),
        whole(latch_id=1 << 63),
        whole(epoch=1.5),
        whole(latch_id="1"),
        whole(latch=2),
        b"\xff\xfe\0",
        bytes(8192),
    ],
)
def test_a_damaged_memory_latches_and_says_which_file(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str | bytes
) -> None:
    folder.mkdir(parents=True)
    (folder / "r1.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    assert FileStateStore("lab").load("r1").latch is Latch.MEMORY_LOST
    assert f"r1: {folder / 'r1.json'}: cannot be read" in capsys.readouterr().err


def test_a_memory_that_is_no_file_latches(folder: Path) -> None:
    (folder / "r1.json").mkdir(parents=True)
    assert FileStateStore("lab").load("r1").latch is Latch.MEMORY_LOST


def test_a_damaged_memory_is_cleared_by_a_reset_and_is_whole_again(folder: Path, stand: Any, driver_of: Make) -> None:
    folder.mkdir(parents=True)
    (folder / "r1.json").write_text("rubbish")
    stand.node = driver_of(stand.bench, "r1", "r2", state_store=FileStateStore("lab"), seed=7)
    stand.run(S // 5)
    assert stand.newest("r1").latch == Latch.MEMORY_LOST
    assert stand.made["r1"].target == STOP
    stand.enable("r1", clear=stand.newest("r1").latch_id)
    stand.run(S // 5)
    assert stand.newest("r1").gate == GateStatus.OPEN
    assert json.loads((folder / "r1.json").read_text())["latch"] == 0


def test_a_write_that_was_torn_loses_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At every byte, of the first write over each slot and of later ones."""
    state_store, before = FileStateStore("lab"), StoredRobot(3, Latch.NONE, 2)
    state_store.save("r1", before)
    write = os.pwrite
    for number in range(3):
        after = StoredRobot(4 + number, Latch.EMERGENCY_STOP, 3 + number)
        for size in (*range(0, 140, 7), 4095):

            def torn(descriptor: int, data: bytes, at: int, size: int = size) -> int:
                return write(descriptor, data[:size], at)

            monkeypatch.setattr(os, "pwrite", torn)
            with pytest.raises(OSError, match="No space left"):
                state_store.save("r1", after)
            assert FileStateStore("lab").load("r1") in (before, after)
            assert size or FileStateStore("lab").load("r1") == before
        monkeypatch.setattr(os, "pwrite", write)
        state_store.save("r1", after)
        assert FileStateStore("lab").load("r1") == after
        before = after


def test_either_half_alone_tells_what_is_kept(folder: Path) -> None:
    state_store, kept = FileStateStore("lab"), StoredRobot(3, Latch.EMERGENCY_STOP, 2)
    state_store.save("r1", StoredRobot())
    state_store.save("r1", kept)
    file = folder / "r1.json"
    content = file.read_bytes()
    assert json.loads(content)["latch"] == json.loads(content)["spare"]["latch"] == Latch.EMERGENCY_STOP
    for damaged in (b"\0" * 4096 + content[4096:], content[:4096] + b"\0" * 4096):
        file.write_bytes(damaged)
        assert FileStateStore("lab").load("r1") == kept


def test_the_newest_half_counts_however_often_it_is_written(folder: Path) -> None:
    state_store = FileStateStore("lab")
    for epoch in range(20):
        state_store.save("r1", StoredRobot(epoch, Latch.NONE, 2 * epoch))
        assert FileStateStore("lab").load("r1") == StoredRobot(epoch, Latch.NONE, 2 * epoch)
    assert (folder / "r1.json").stat().st_size == 8192


@pytest.mark.parametrize("most", [(1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 32, (1 << 63) - 1])
def test_large_numbers_are_kept(folder: Path, most: int) -> None:
    FileStateStore("lab").save("r1", StoredRobot(most, Latch.RUNAWAY, most))
    assert FileStateStore("lab").load("r1") == StoredRobot(most, Latch.RUNAWAY, most)


def test_what_is_lost_latches_until_it_is_saved_again(folder: Path) -> None:
    state_store = FileStateStore("lab")
    state_store.save("r1", StoredRobot(3, Latch.NONE, 2))
    state_store.lose("r1")
    assert FileStateStore("lab").load("r1").latch is Latch.MEMORY_LOST
    state_store.save("r1", StoredRobot(4, Latch.EMERGENCY_STOP, 3))
    assert FileStateStore("lab").load("r1") == StoredRobot(4, Latch.EMERGENCY_STOP, 3)


def test_a_place_that_cannot_be_written_is_named(folder: Path) -> None:
    folder.parent.mkdir()
    folder.write_text("no folder")
    with pytest.raises(OSError, match="Not a directory") as refused:
        FileStateStore("lab").prove(("r1",))
    assert refused.value.filename == str(folder / "r1.json")


def test_proving_makes_room_and_changes_nothing(folder: Path) -> None:
    FileStateStore("lab").save("r1", StoredRobot(7, Latch.WIRED_STOP, 3))
    FileStateStore("lab").prove(("r1", "r2"))
    assert [FileStateStore("lab").load(robot) for robot in ("r1", "r2")] == [
        StoredRobot(7, Latch.WIRED_STOP, 3),
        StoredRobot(),
    ]
    assert {file.name: file.stat().st_size for file in folder.glob("*.json")} == {"r1.json": 8192, "r2.json": 8192}


def fill(disk: Path) -> None:
    with suppress(OSError), (disk / "filler").open("wb", buffering=0) as stream:
        while stream.write(bytes(4096)):
            pass


def test_a_disk_that_is_really_full_takes_a_latch(
    disk_of: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    small_disk = disk_of("256k")
    monkeypatch.setenv("XDG_STATE_HOME", str(small_disk))
    state_store = FileStateStore("lab")
    state_store.prove(("r1",))
    fill(small_disk)
    with pytest.raises(OSError, match="No space left"):
        (small_disk / "more").write_text("x")
    for number in range(1, 6):
        state_store.save("r1", StoredRobot(3, Latch.EMERGENCY_STOP, number))
        assert FileStateStore("lab").load("r1") == StoredRobot(3, Latch.EMERGENCY_STOP, number)
    with pytest.raises(OSError, match="No space left") as refused:
        state_store.prove(("r1", "r2"))
    assert "r2.json" in str(refused.value.filename)
    state_store.lose("r1")
    assert FileStateStore("lab").load("r1").latch is Latch.MEMORY_LOST


def test_a_latch_that_cannot_be_kept_is_not_forgotten_by_a_restart(stand: Any, disk: Disk) -> None:
    """Neither is a reset that cannot be kept taken for one; a lease that was refused has cost nothing."""
    stand.run(S // 5)
    disk.full = True
    stand.ask("r2")
    stand.enable("r1", latch=Latch.EMERGENCY_STOP)
    stand.run(S // 5)
    stand.restart(2)
    stand.bench.run(stand.node, 25 * MS)
    assert (stand.newest("r1").latch, stand.newest("r1").gate) == (Latch.MEMORY_LOST, GateStatus.LATCHED)
    assert stand.newest("r2").latch == Latch.NONE
    stand.enable("r1", clear=stand.newest("r1").latch_id)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.NONE
    stand.restart(3)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.MEMORY_LOST, "the disk is as it was"


def test_a_drill_is_nothing_to_lose_a_memory_for(stand: Any, disk: Disk) -> None:
    stand.run(S // 5)
    disk.full = True
    stand.enable("r1", latch=Latch.DRILL)
    stand.run(S // 5)
    stand.restart(2)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.NONE


class Unheard(io.StringIO):
    """A log on a full disk."""

    def write(self, text: str) -> int:
        raise OSError(28, "No space left on device")


def test_a_latch_is_said_before_it_is_kept_and_before_the_log(
    stand: Any, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever these two do, it is out."""
    for broken in ("disk", "log"):
        stand.restart(7)
        stand.acquire("r1")
        stand.bench.run(stand.node, 25 * MS)
        before = len(stand.bench.heard(STATUS, "r1"))
        order: list[Any] = []

        def stalls(*_: Any, order: list[Any] = order) -> None:
            order.append(stand.newest("r1").latch)

        if broken == "disk":
            monkeypatch.setattr(disk, "save", stalls)
        else:
            monkeypatch.setattr(disk, "save", lambda *_: None)
            monkeypatch.setattr(Complaints, "say", stalls)
        stand.enable("r1", latch=Latch.EMERGENCY_STOP)
        stand.bench.run(stand.node, 25 * MS)
        assert order[0] == Latch.EMERGENCY_STOP
        assert len(stand.bench.heard(STATUS, "r1")) >= before + 1


def test_a_log_that_cannot_be_written_stops_nobody(stand: Any, disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    stand.run(S // 5)
    disk.full = True
    monkeypatch.setattr(sys, "stderr", Unfailing(Unheard()))
    stand.enable("r1", latch=Latch.EMERGENCY_STOP)
    stand.run(S // 5)
    assert (stand.newest("r1").gate, stand.made["r1"].target) == (GateStatus.LATCHED, STOP)
