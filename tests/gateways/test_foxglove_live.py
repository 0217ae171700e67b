"""Viewers of a real run get what its recording gets; one that sleeps or dies, or the server, ends nothing."""

import asyncio
import json
import re
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed

from tests.gateways.foxglove_client import Viewer, viewer
from tests.runs.realrun import RealRun, of_robots

pytestmark = pytest.mark.long  # beside it the fast test of every channel, message by message: test_foxglove.py
AT = re.compile(r"ws://127\.0\.0\.1:\d+")
DRAWN = 0.97  # of what is drawn ten times a second: a process that was late misses one


@pytest.fixture
def run(tmp_path: Path, alone_for_a_module: None) -> RealRun:
    run = RealRun(tmp_path, *of_robots("r1", "r2"), "--duration", "8", "--foxglove", "127.0.0.1:0")
    run.wait_for(lambda: AT.search(run.said))
    return run


def address(run: RealRun) -> str:
    found = AT.search(run.said)
    assert found is not None
    return found[0]


async def looked_at(run: RealRun) -> Viewer:
    """Look at a run until its end, beside a viewer that never reads and one that dies."""
    url = address(run)
    async with viewer(url) as sleeping, viewer(url) as dying, viewer(url) as awake:
        sleeping.transport.pause_reading()
        awake_viewer, other = Viewer(awake), Viewer(dying)
        await awake_viewer.until(
            lambda: "/fleet" in awake_viewer.counts and "/references" in awake_viewer.counts, 120.0
        )
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


def test_a_viewer_of_a_real_run_gets_what_its_recording_gets(run: RealRun) -> None:
    try:
        seen = asyncio.run(looked_at(run))
        assert run.ended() == 0, run.said
        assert run.summary["outcome"] == "completed"
        assert run.nothing_is_left()
    finally:
        run.clean_up()
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
            begin, end = messages[0][0], messages[-1][0]
            count = sum(begin <= at <= end for at, _ in recorded[topic])
            assert DRAWN * count - 2 <= len(messages) <= count / DRAWN + 2, topic


def test_a_run_goes_on_whose_server_of_viewers_is_killed(run: RealRun) -> None:
    try:
        run.wait_until_running()
        run.kill("foxglove")
        run.wait_for(lambda: "foxglove sees nothing more, the run goes on" in run.said)
        assert run.ended() == 0, run.said
    finally:
        run.clean_up()
    assert run.summary["outcome"] == "completed"
