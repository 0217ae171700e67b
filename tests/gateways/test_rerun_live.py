"""A viewer in rerun of a real run gets what is drawn; one that sleeps or dies, or the server, ends nothing."""

import re
import signal
from contextlib import closing
from pathlib import Path

import pytest

from tests.gateways.rerun_client import Saving, imported
from tests.runs.realrun import RealRun, of_robots

pytestmark = pytest.mark.long  # beside it the fast test of every row: test_rerun.py
AT = re.compile(r"rerun\+http://127\.0\.0\.1:\d+/proxy")
DRAWN = 0.97  # of what is drawn ten times a second: a process that was late misses one


@pytest.fixture
def run(tmp_path: Path, alone_for_a_module: None) -> RealRun:
    """Both kinds of viewers at once, each with a server of its own."""
    options = "--rerun", "127.0.0.1:0", "--foxglove", "127.0.0.1:0"
    run = RealRun(tmp_path, *of_robots("r1", "r2"), "--duration", "8", *options)
    run.wait_for(lambda: AT.search(run.said) and "ws://" in run.said)
    return run


def address(run: RealRun) -> str:
    found = AT.search(run.said)
    assert found is not None
    return found[0]


def test_a_viewer_of_a_real_run_gets_what_its_recording_gets(run: RealRun, tmp_path: Path) -> None:
    """Beside a viewer that sleeps, and one that dies."""
    try:
        url = address(run)
        with (
            closing(Saving(url, tmp_path / "awake.rrd")) as awake,
            closing(Saving(url, tmp_path / "sleeping.rrd")) as sleeping,
            closing(Saving(url, tmp_path / "dying.rrd")) as dying,
        ):
            dying.until(lambda rows: "/fleet/r1" in rows)
            dying.close()
            sleeping.process.send_signal(signal.SIGSTOP)
            assert run.ended() == 0, run.said
            awake.process.wait(60.0)
            rows = awake.told()
        assert run.summary["outcome"] == "completed"
        assert run.nothing_is_left()
    finally:
        run.clean_up()
    recorded = imported(run.folder / "run.mcap")
    assert {"/fleet/r1", "/fleet/r2", "/arena/platoon/path"} <= set(rows)
    for path in ("/tf", "/robots/r1/pose", "/robots/r2/tick", "/log", "/references/references"):
        count = len(recorded[path.removesuffix("/references")])
        assert DRAWN * count - 2 <= len(rows[path]) <= count / DRAWN + 2, path


def test_a_run_goes_on_whose_server_of_viewers_is_killed(run: RealRun) -> None:
    try:
        run.wait_until_running()
        run.kill("rerun")
        run.wait_for(lambda: "rerun sees nothing more, the run goes on" in run.said)
        assert run.ended() == 0, run.said
    finally:
        run.clean_up()
    assert run.summary["outcome"] == "completed"
