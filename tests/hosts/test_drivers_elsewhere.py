"""``drivers.started_by: systemd``: a run finds its drivers there, and leaves them there."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.config.load import ConfigError, load_config, resolved_yaml
from tests.endpoints import own_endpoint
from tests.runs.realrun import ALONE, PLATOON, RealRun, own_folders

SYSTEMD = "drivers.started_by=systemd"


@pytest.mark.parametrize("changes", [[], ["bus.endpoint=tcp/127.0.0.1:0", "bus.insecure=loopback"]])
def test_an_endpoint_that_the_drivers_cannot_know_is_refused(changes: list[str]) -> None:
    with pytest.raises(ConfigError, match=r"bus\.endpoint: drivers that are there before the run.*/lab\.sock"):
        load_config(PLATOON, [SYSTEMD, *changes])


@pytest.mark.long
def test_a_driver_that_waits_for_the_bus_serves_one_run_after_the_other(
    tmp_path: Path, real_run: Callable[..., RealRun]
) -> None:
    changes = [SYSTEMD, f"bus.endpoint={own_endpoint()}", "run.duration_s=0.5"]
    config = tmp_path / "lab.yaml"
    config.write_text(resolved_yaml(load_config(PLATOON, [*ALONE[1::2], *changes])))
    command = [sys.executable, "-m", "robofleet", "node", "driver", str(config), "--robots", "r1"]
    driver = subprocess.Popen(command, env=own_folders(tmp_path), stderr=subprocess.PIPE, text=True)
    try:
        for name in ("first", "second"):
            run = real_run(*ALONE, *(word for change in changes for word in ("--set", change)), name=name)
            assert run.ended() == 0, run.said
            assert run.summary["outcome"] == "completed"
            assert not run.children("driver")
            assert driver.poll() is None, "the run has ended a driver that is not its own"
    finally:
        driver.terminate()
        assert driver.wait(5) == 0
        assert driver.stderr is not None
        driver.stderr.close()
