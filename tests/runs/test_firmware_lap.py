"""A platoon of four binaries of an Uno in simavr, behind their real drivers, with a camera in the loop."""

import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from tests.simulation.uno import require_avr


@pytest.mark.long
def test_four_binaries_drive_a_lap() -> None:
    require_avr()
    driver = "tools.measure.robots.lockstep_uno:LockstepUno"
    changes = [change for i in range(4) for change in (f"robots.{i}.driver={driver}", f"robots.{i}.twin=null")]
    run = Lockstep(load_config(SHIPPED / "firmware.yaml", changes))
    outcome, cause = run.run()
    assert outcome == "completed", cause
    figures = summary(run.recording, name="firmware", mode="lockstep", outcome=outcome, cause=cause)
    assert figures["control_error_mm"]["mean"] <= 0.5
    assert figures["stops"] == []
