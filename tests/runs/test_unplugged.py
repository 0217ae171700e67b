"""A real run whose robot's cable is pulled out, and the one after it."""

import json
from collections.abc import Callable
from typing import Any

import pytest
import yaml

from robofleet.safety.latches import Latch
from tests.runs.realrun import PLATOON, RealRun


def of_a_create2(*more: str) -> list[str]:
    """Return the options of a run of one Create 2, answered by its twin."""
    robot: dict[str, Any] = yaml.safe_load(PLATOON.read_text())["robots"][0]
    robot |= {"driver": "create2", "twin": "create2", "vehicle": "create2"}
    keys = ["tracker.source=truth", "arena.size_m=[3.5, 2.3]", "groups.0.settings.spacing_m=0.48", "run.duration_s=3"]
    keys += [f"robots={json.dumps([robot])}", 'groups.0.robots=["r1"]', *more]
    return [word for key in keys for word in ("--set", key)]


@pytest.mark.long
def test_a_run_ends_by_the_cables_name_and_the_next_one_drives_after_a_reset(
    real_run: Callable[..., RealRun],
) -> None:
    pulled = real_run(*of_a_create2("faults=[{kind: unplugged, robot: r1, at_s: 1.0, duration_s: 0.5}]"))
    assert pulled.ended() == 1
    (stop,) = pulled.summary["stops"]
    for cause in (pulled.summary["cause"], stop["cause"], pulled.said):
        assert "its driver has lost the connection to it (unplugged?)" in cause
    assert pulled.summary["outcome"] == "fault"
    log = (pulled.folder / "log" / "driver-r1.log").read_text()
    assert "platoon-r1.tty: the line is gone: plug it in again" in log
    assert "Traceback" not in log
    assert pulled.latched() == {"r1": Latch.DRIVER_FAILED}
    latched = real_run(*of_a_create2(), name="latched")
    assert latched.ended() == 1
    assert "robofleet run --reset" in latched.summary["cause"]
    again = real_run(*of_a_create2(), "--reset", name="again")
    assert again.ended() == 0, again.said
    assert again.summary["outcome"] == "completed"
