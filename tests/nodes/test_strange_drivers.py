"""Simulated robots of somebody else's: what they would ignore is refused, and what they raise ends in a line."""

from multiprocessing import parent_process
from pathlib import Path
from typing import Any, ClassVar

import pytest

from robofleet.drivers.simulated import SimulatedRobot
from robofleet.vehicles.interface import DriverContext, DriverError, WheelSpeeds
from tests.command import robofleet
from tests.runs.realrun import PLATOON

TRUTH = "--set", "tracker.source=truth"


class Deaf(SimulatedRobot):
    """Its body is its own: faults do nothing to it."""

    body_faults: ClassVar[bool] = False


class Absent(SimulatedRobot):
    """Cannot be opened."""

    def __init__(self, context: DriverContext) -> None:
        raise DriverError("its simulator does not run: start it")


class Rash(SimulatedRobot):
    """Can be opened by the check alone, which is a process of its own."""

    def __init__(self, context: DriverContext) -> None:
        if parent_process() is None:
            raise DriverError("its simulator has ended")
        super().__init__(context)


class Frail(SimulatedRobot):
    """Fails as soon as it moves, and again when it is closed."""

    failed = False

    def write(self, wheels: WheelSpeeds) -> None:
        if self.failed or wheels.left > 0.0:
            self.failed = True
            raise DriverError("its simulator has ended")
        super().write(wheels)


def driven_by(kind: type) -> tuple[str, ...]:
    return *TRUTH, "--set", f"robots.1.driver={__name__}:{kind.__name__}"


def is_a_line(result: Any, *words: str) -> None:
    assert isinstance(result.exception, SystemExit), result.exception
    (line,) = result.stderr.splitlines()
    for word in words:
        assert word in line


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["motor_stuck", "slip"])
@pytest.mark.parametrize("lockstep", [(), ("--lockstep",)])
def test_a_bodys_fault_is_refused_where_it_would_do_nothing(
    kind: str, lockstep: tuple[str, ...], tmp_path: Path
) -> None:
    fault = "--set", f"faults=[{{kind: {kind}, robot: r2}}]"
    out = tmp_path / "run"
    result = robofleet("run", PLATOON, *driven_by(Deaf), *fault, *lockstep, "--out", out)
    assert result.exit_code == 2
    is_a_line(result, "faults.0.robot", "r2 would not obey it", "body_faults = True")
    assert not out.exists()
    assert robofleet("check", PLATOON, *TRUTH, *fault).exit_code == 0, "the shipped one obeys it"


@pytest.mark.parametrize("twin", ["gternal", "arduino_bridge"])
def test_a_touch_is_refused_where_a_twin_feels_nothing(twin: str) -> None:
    overrides = f"robots.0.driver={twin}", f"robots.0.twin={twin}", "faults=[{kind: bumper_hit, robot: r1}]"
    result = robofleet("check", PLATOON, *TRUTH, *(part for key in overrides for part in ("--set", key)))
    assert result.exit_code == 2
    assert "faults.0.kind" in result.stderr
    assert "has no such sensor" in result.stderr


@pytest.mark.parametrize("command", [("check",), ("run",), ("run", "--lockstep")])
def test_a_simulated_robot_that_cannot_be_opened_is_named_at_its_place(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    out = () if command == ("check",) else ("--out", tmp_path / "run")
    result = robofleet(command[0], PLATOON, *command[1:], *driven_by(Absent), *out)
    assert result.exit_code == 2
    is_a_line(result, "robots.1.driver", "its simulator does not run: start it")
    assert not (tmp_path / "run").exists()


def test_one_that_cannot_be_opened_again_ends_lockstep_in_a_line(tmp_path: Path) -> None:
    result = robofleet("run", PLATOON, "--lockstep", "--quiet", *driven_by(Rash), "--out", tmp_path / "run")
    assert result.exit_code == 2
    is_a_line(result, "robots.1.driver", "its simulator has ended")


def test_one_that_fails_in_lockstep_ends_the_run_by_a_fault_with_summary_and_report(tmp_path: Path) -> None:
    out = tmp_path / "run"
    result = robofleet("run", PLATOON, "--lockstep", "--quiet", *driven_by(Frail), "--duration", 2, "--out", out)
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit), result.exception
    assert "fault: its simulator has ended" in result.stderr.splitlines()
    assert {"summary.json", "report.html"} <= {file.name for file in out.iterdir()}
