"""Driver processes of several robots: what is said to another number is refused, and all begin anew at once."""

from pathlib import Path
from typing import Any

import pytest

from robofleet.bus.keys import COMMAND, ENABLE, STATUS
from robofleet.bus.messages import (
    UNIT_COMMAND,
    UNIT_ENABLE,
    UNIT_STATUS,
    Enable,
    UnitCommand,
    UnitEnable,
    WheelCommand,
)
from robofleet.core.clock import MS, S
from robofleet.vehicles.interface import STOP
from tests.command import robofleet
from tests.process_fixtures import FORWARD, PLATOON, Bench, Stand


@pytest.fixture(params=["recorded", "simulated"])
def pair(request: pytest.FixtureRequest, platoon_of: Any, driver_of: Any) -> Any:
    """Return two robots of one unit: behind drivers of their own, and simulated in arrays."""
    if request.param == "recorded":
        return request.getfixturevalue("stand")
    bench = Bench(platoon_of("drivers.robots_per_process=2"))
    return Stand(bench, driver_of(bench, "r1", "r2"), {})


@pytest.mark.parametrize("count", [0, 1, 3])
def test_what_is_said_to_another_number_of_robots_is_refused_and_counted(pair: Stand, count: int) -> None:
    pair.run(S // 5)
    pair.enable("r1", "r2")
    pair.command("r1", "r2")
    pair.bench.run(pair.node, 25 * MS)
    before, bus = [pair.newest(robot) for robot in ("r1", "r2")], pair.bench.bus
    echo = before[0].boot_id, before[0].nonce
    command = UnitCommand(10**6, pair.SESSION, *echo, 1, (WheelCommand(before[0].epoch, 9.0, 9.0),) * count)
    bus.publisher(COMMAND, "r1")(UNIT_COMMAND.encode(command))
    bus.publisher(ENABLE, "r1")(UNIT_ENABLE.encode(UnitEnable(10**6, *echo, 2, (Enable(1, 2, 0, 0.0),) * count)))
    pair.bench.run(pair.node, 25 * MS)
    for robot, then in zip(("r1", "r2"), before, strict=True):
        now = pair.newest(robot)
        assert (now.rejected, now.latch, now.gate) == (then.rejected + 2, 0, 0)
        assert (now.left_output_rad_s, now.right_output_rad_s) == FORWARD


def test_a_robot_to_which_nothing_is_said_refuses_nothing_and_stands(pair: Stand) -> None:
    pair.run(S // 2, robot="r2")
    silent, commanded = (pair.newest(robot) for robot in ("r1", "r2"))
    assert (silent.rejected, commanded.rejected) == (0, 0)
    assert (silent.left_output_rad_s, silent.right_output_rad_s) == STOP
    assert (commanded.left_output_rad_s, commanded.right_output_rad_s) == FORWARD


def test_a_clock_that_was_set_back_is_counted_once_for_all_robots(pair: Stand) -> None:
    """Each time: what is said to the unit echoes one boot id."""
    pair.run(S // 5)
    for _ in range(3):
        before = pair.newest("r1").boot_id
        pair.bench.clock._now_ns -= 100 * MS
        pair.bench.run(pair.node, 50 * MS)
        assert {pair.newest(robot).boot_id for robot in ("r1", "r2")} == {before + 1}
        pair.run(S // 5)
        assert (pair.newest("r1").left_output_rad_s, pair.newest("r1").right_output_rad_s) == FORWARD


def test_a_status_tells_of_every_robot_in_the_units_order(bench_of: Any, platoon_of: Any, driver_of: Any) -> None:
    bench = bench_of(
        platoon_of("robots.3.unit=b", "robots.1.unit=b", "robots.1.start.x_m=0.7", "robots.3.start.x_m=-0.7")
    )
    payloads: list[bytes] = []
    bench.bus.listen(STATUS, "b", lambda _, payload: payloads.append(payload))
    node = driver_of(bench, "r2", "r4")
    bench.run(node, S // 10)
    status = UNIT_STATUS.decode(payloads[-1])
    assert status is not None
    assert len(status.robots) == 2


@pytest.mark.parametrize("robots", ["r1", "r2", "r1,r3", "r2,r1,r3,r4", "r1,r2,r3"])
def test_robots_that_are_no_unit_are_refused_in_a_line(tmp_path: Path, robots: str) -> None:
    config = tmp_path / "one.yaml"
    config.write_text(PLATOON.read_text())
    result = robofleet("node", "driver", config, "--robots", robots)
    assert result.exit_code == 2
    assert result.stderr == (
        "--robots: a process drives all robots of one unit: name r1,r2,r3,r4, or give robots[].unit or "
        f"drivers.robots_per_process in {config}\n"
    )


def test_a_robot_that_is_not_there_is_refused_too(tmp_path: Path) -> None:
    config = tmp_path / "one.yaml"
    config.write_text(PLATOON.read_text())
    result = robofleet("node", "driver", config, "--robots", "r1,r9")
    assert result.exit_code == 2
    assert result.stderr.startswith("--robots: there is no robot 'r9' in ")
