"""Viewers of a real run get what its recording gets; one that sleeps or dies, or a server, ends nothing."""

import asyncio
import json
import re
import signal
from collections import defaultdict
from contextlib import closing, suppress
from pathlib import Path

import pytest
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed

from tests.gateways.foxglove_client import Viewer, viewer
from tests.gateways.rerun_client import Saving, imported
from tests.runs.realrun import RealRun, of_robots

pytestmark = pytest.mark.long  # beside it the fast test of every message and row: test_foxglove.py, test_rerun.py
FOXGLOVE, RERUN = re.compile(r"ws://127\.0\.0\.1:\d+"), re.compile(r"rerun\+http://127\.0\.0\.1:\d+/proxy")
DRAWN = 0.97  # of what is drawn ten times a second: a process that was late misses one


@pytest.fixture
def run(tmp_path: Path, alone_for_a_module: None) -> RealRun:
    """Both kinds of viewers at once, each with a server of its own; rerun's takes some seconds to start."""
    options = "--rerun", "127.0.0.1:0", "--foxglove", "127.0.0.1:0"
    run = RealRun(tmp_path, *of_robots("r1", "r2"), "--duration", "20", *options)
    run.wait_for(lambda: FOXGLOVE.search(run.said) and RERUN.search(run.said))
    return run


def address(run: RealRun, pattern: re.Pattern[str]) -> str:
    found = pattern.search(run.said)
    assert found is not None
    return found[0]


async def looked_at(run: RealRun) -> Viewer:
    """Look at a run in Foxglove until its end, beside a viewer that never reads and one that dies."""
    url = address(run, FOXGLOVE)
    async with viewer(url) as sleeping, viewer(url) as dying, viewer(url) as awake:
        sleeping.transport.pause_reading()
        awake_viewer, other = Viewer(awake), Viewer(dying)
        await awake_viewer.until(lambda: {"/fleet", "/references"} <= set(awake_viewer.counts), 120.0)
        await other.until(lambda: len(other.messages) > 100)
        dying.transport.abort()
        layout = json.loads((run.folder / "foxglove.json").read_text())["configById"]
        request = json.loads(layout["CallService!hold"]["requestPayload"])
        assert not (await awake_viewer.call("hold", {"key": "guess"}))["success"]
        assert (await awake_viewer.call("hold", request))["success"]
        assert (await awake_viewer.call("resume", request))["success"]
        with suppress(ConnectionClosed):
            await awake_viewer.until(lambda: False, 120.0)
        return awake_viewer


def is_most_of(shown: int, recorded: int) -> bool:
    return DRAWN * recorded - 2 <= shown <= recorded / DRAWN + 2


def test_viewers_of_a_real_run_get_what_its_recording_gets(run: RealRun, tmp_path: Path) -> None:
    """Beside viewers that sleep, and some that die."""
    url = address(run, RERUN)
    try:
        with (
            closing(Saving(url, tmp_path / "awake.rrd")) as awake,
            closing(Saving(url, tmp_path / "sleeping.rrd")) as sleeping,
            closing(Saving(url, tmp_path / "dying.rrd")) as dying,
        ):
            dying.until(lambda rows: "/fleet/r1" in rows)
            dying.close()
            sleeping.process.send_signal(signal.SIGSTOP)
            seen = asyncio.run(looked_at(run))
            assert run.ended() == 0, run.said
            awake.process.wait(60.0)
            rows = awake.told()
        assert run.summary["outcome"] == "completed"
        assert run.nothing_is_left()
    finally:
        run.clean_up()

    in_file = imported(run.folder / "run.mcap")
    assert {"/fleet/r1", "/fleet/r2", "/arena/platoon/path"} <= set(rows)
    for path in ("/tf", "/robots/r1/pose", "/robots/r2/tick", "/log", "/references/references"):
        assert is_most_of(len(rows[path]), len(in_file[path.removesuffix("/references")])), path

    recorded, live = defaultdict(list), defaultdict(list)
    with (run.folder / "run.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            recorded[channel.topic].append((message.log_time, message.data))
    for message in seen.messages:
        live[message.topic].append((message.log_ns, message.data))
    assert set(live) <= set(recorded)
    for topic, messages in live.items():
        if topic.startswith("rf/"):
            shown, kept = [data for _, data in messages], [data for _, data in recorded[topic]]
            first, last = kept.index(shown[0]), len(kept) - kept[::-1].index(shown[-1])
            assert shown == kept[first:last], topic
        elif len(messages) > 30:
            count = sum(messages[0][0] <= at <= messages[-1][0] for at, _ in recorded[topic])
            assert is_most_of(len(messages), count), topic


def test_a_run_goes_on_whose_servers_of_viewers_are_killed(run: RealRun) -> None:
    try:
        run.wait_until_running()
        for server in ("foxglove", "rerun"):
            run.kill(server)
            run.wait_for(lambda server=server: f"{server} sees nothing more, the run goes on" in run.said)
        assert run.ended() == 0, run.said
    finally:
        run.clean_up()
    assert run.summary["outcome"] == "completed"
