"""A driver that somebody stops on a loaded machine: no load explains its silence, and the run does not go on."""

import signal
from pathlib import Path

import pytest

from tests.runs.realrun import ALONE, RealRun
from tools.measure.runs.busy_machine import busy_loops

pytestmark = pytest.mark.long
LOOPS = 4


def test_a_driver_that_is_stopped_on_a_loaded_machine_ends_the_run(tmp_path: Path) -> None:
    run = RealRun(tmp_path, *ALONE)
    try:
        run.wait_until_running()
        (driver,) = run.children("driver")
        with busy_loops(LOOPS):
            driver.send_signal(signal.SIGSTOP)
            assert run.ended() == 1
        assert "the driver went silent" in run.summary["cause"]
        assert run.summary["outcome"] == "fault"
    finally:
        run.clean_up()
