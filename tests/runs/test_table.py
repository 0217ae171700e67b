"""The table of processes: which a configuration has, who starts them, and what the commands and lockstep make of it."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.runs import table
from robofleet.runs.lockstep import Lockstep
from tests.command import robofleet
from tests.shipped import PLATOON

MIXED = PLATOON.with_name("mixed.yaml")
TRUTH = "tracker.source=truth"


def names(processes: list[table.Process]) -> list[str]:
    return [process.name for process in processes]


def test_a_run_starts_what_its_configuration_needs_and_nothing_else(platoon_of: Callable[..., Config]) -> None:
    drivers = ["driver-r1", "driver-r2", "driver-r3", "driver-r4"]
    plain = ["router", "recorder", "supervisor", "tracker", "controller", *drivers]
    assert names(table.started_by("run", platoon_of())) == plain
    assert names(table.processes(load_config(MIXED, ["drivers.robots_per_process=1"]))) == [
        *plain[:2],
        "twins",
        *plain[2:],
    ]
    shared = table.processes(platoon_of("drivers.robots_per_process=3"))
    assert [process.command for process in shared[-2:]] == [
        ("node", "driver", "--robots", "r1,r2,r3"),
        ("node", "driver", "--robots", "r4"),
    ]


def test_systemd_starts_the_drivers_and_the_run_everything_else(platoon_of: Callable[..., Config]) -> None:
    config = platoon_of("drivers.started_by=systemd", "bus.endpoint=unixsock-stream//run/robofleet/lab.sock")
    assert names(table.started_by("systemd", config)) == list(config.driven)
    assert not set(names(table.started_by("run", config))) & set(config.driven)


def test_lockstep_steps_the_rows_that_have_a_turn(platoon_of: Callable[..., Config]) -> None:
    config = platoon_of(TRUTH, "drivers.robots_per_process=4")
    run = Lockstep(config)
    run.close()
    assert list(run.nodes) == names(table.in_lockstep(config)) == ["driver-r1", "tracker", "supervisor", "controller"]


@pytest.mark.parametrize("row", table.TABLE, ids=lambda row: row.name)
def test_every_row_is_a_command(row: table.Row) -> None:
    done = robofleet(*row.command, "--help", prog_name="robofleet")
    assert done.exit_code == 0
    assert f"Usage: robofleet {' '.join(row.command)}" in done.output


def test_a_process_that_a_configuration_does_not_have_is_refused_before_anything_else() -> None:
    done = robofleet("node", "twins", PLATOON)
    assert (done.exit_code, done.stderr) == (2, "no robot has a twin: name one in robots[].twin\n")


def test_who_is_waited_for_goes_first() -> None:
    """The controller's tick before a twin's own processor, and both before what only looks."""
    realtime = {row.name: row.priority for row in table.TABLE if row.priority}
    order = sorted(realtime, key=lambda name: -realtime[name])
    assert order == ["controller", "twins", "driver", "supervisor", "tracker"]


def test_faults_may_name_what_they_can_strike(platoon_of: Callable[..., Config]) -> None:
    assert set(table.injectable(platoon_of())) == {"router", "supervisor", "tracker", "controller"} | set(
        platoon_of().driven
    )


def test_a_folder_that_is_renamed_or_removed_keeps_its_room(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    held = os.open(folder, os.O_RDONLY)
    try:
        assert table.free_bytes(held) > 0
        folder.rename(tmp_path / "elsewhere")
        assert table.free_bytes(held) > 0
        shutil.rmtree(tmp_path / "elsewhere")
        assert table.free_bytes(held) > 0
    finally:
        os.close(held)
    assert table.free_bytes(held) == 0, "unknown room is none: the fleet holds"
