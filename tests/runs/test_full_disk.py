"""A disk that is really full, under a fleet of real processes: an emergency stop is latched, said and remembered."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from robofleet.safety.latches import Latch
from tests.runs.realrun import ALONE, RealRun, own_folders, wait

pytestmark = pytest.mark.long  # a driver on a full disk: test_driver_keeping.py


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """Return a disk of its own, of 260 MB."""
    mounted = tmp_path / "disk"
    mounted.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=260m", "tmpfs", mounted]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("only root may mount a disk that fills up")
    yield mounted
    subprocess.run(["umount", "-l", mounted], check=True)


def fill(disk: Path) -> None:
    with suppress(OSError), (disk / "filler").open("wb", buffering=0) as stream:
        while stream.write(bytes(1 << 16)):
            pass
    with suppress(OSError), (disk / "rest").open("wb", buffering=0) as stream:
        while stream.write(b"x"):
            pass


@pytest.fixture
def run_on(alone: None, disk: Path) -> Iterator[Callable[..., RealRun]]:
    """Return what starts a run all of whose files are on that disk."""
    runs: list[RealRun] = []

    def start(*arguments: str, name: str) -> RealRun:
        runs.append(RealRun(disk, *ALONE, "--set", "run.duration_s=60", *arguments, name=name))
        return runs[-1]

    yield start
    for run in runs:
        run.clean_up()


def test_an_emergency_stop_on_a_full_disk_holds_through_the_next_start(
    run_on: Callable[..., RealRun], disk: Path
) -> None:
    run = run_on(name="first")
    run.wait_until_running()
    assert run.robofleet("hold").returncode == 0
    fill(disk)
    stopped = run.robofleet("stop")
    assert stopped.returncode == 0, stopped
    assert "every robot has latched its gate" in stopped.stdout
    assert wait(lambda: run.latched() == {"r1": Latch.EMERGENCY_STOP}, 5.0)
    run.ended(10.0)
    assert run.nothing_is_left()
    for file in ("filler", "rest"):
        (disk / file).unlink()
    again = run_on("--set", "run.duration_s=1", name="again")
    assert again.ended() == 1
    assert "latched" in again.said
    assert "\nrunning" not in again.said
    assert again.latched() == {"r1": Latch.EMERGENCY_STOP}


@pytest.mark.parametrize("spoilt", ["a file", "full"])
def test_a_state_folder_that_cannot_be_written_is_named_at_the_start(
    run_on: Callable[..., RealRun], disk: Path, spoilt: str
) -> None:
    own_folders(disk)
    folder = disk / "state" / "robofleet"
    if spoilt == "a file":
        folder.write_text("no folder")
    else:
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", disk / "state"], check=True)
    try:
        run = run_on(name="run")
        assert run.ended() == 2
    finally:
        if spoilt == "full":
            subprocess.run(["umount", "-l", disk / "state"], check=True)
    assert str(folder / "platoon" / "r1.json") in run.said
    assert "name another folder in XDG_STATE_HOME" in run.said
    assert "other controller" not in run.said
    assert not run.folder.exists(), "nothing was begun"
