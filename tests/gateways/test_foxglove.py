"""Foxglove's protocol: a viewer gets every channel of the recording, and the operator's services ask for their key."""

import asyncio
from collections import defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader

from robofleet.config.load import load_config
from robofleet.core.refusal import RefusedError
from robofleet.gateways.asking import SERVICES
from robofleet.gateways.viewers.foxglove.server import Server, services, written
from robofleet.gateways.viewers.retained import RetainedMessages
from robofleet.operator.asking import Outcome
from robofleet.operator.viewer_address import FOXGLOVE, Address
from tests.gateways.foxglove_client import Message, Viewer, viewer
from tests.gateways.overheard import Overheard
from tests.gateways.viewer_contract import HERE, Messages, Seen, ViewerContract
from tests.shipped import PLATOON

KEY = "the operator's key"
TOLD_ONCE = {"/arena", "/fleet", "/tf_static", "/camera/calibration", "/log"}
SERVER = partial(Server, "nobody", HERE)


class TestFoxglove(ViewerContract):
    viewer = package = FOXGLOVE
    drawn = frozenset({"/tf", "/camera/image", "/robots/r1/tick", "rf/platoon/tick"})

    def server(self, at: Address) -> Server:
        return Server("nobody", at, [], [])


def by_topic(messages: Iterable[Message]) -> Messages:
    found: Messages = defaultdict(list)
    for message in sorted(messages):
        found[message.topic].append((message.log_ns, message.data))
    return dict(found)


async def looked_at(folder: Path) -> tuple[Seen, dict[str, dict[str, Any]]]:
    """Return what viewers are told of a run in lockstep, and its channels."""
    overheard = Overheard(load_config(PLATOON, ["run.duration_s=1"]))
    with overheard.shown(partial(SERVER, services=[])) as (viewers, server):

        async def subscribed(viewer: Viewer, already: int) -> None:
            await viewer.until(lambda: viewer.channels)
            while server.subscriptions < already + len(viewer.channels):
                await asyncio.sleep(0.01)
            viewers.step(overheard.now_ns)

        url = f"ws://127.0.0.1:{server.port}"
        async with viewer(url) as first, viewer(url) as second:
            early, late = Viewer(first), Viewer(second)
            await subscribed(early, 0)
            with overheard.played(viewers, folder / "run.mcap").open("rb") as file:
                messages = make_reader(file).iter_messages(log_time_order=False)
                recorded = [Message(channel.topic, message.log_time, message.data) for _, channel, message in messages]
            await early.until(lambda: len(early.messages) >= len(recorded))
            await subscribed(late, len(early.channels))
            await late.until(lambda: set(late.counts) >= TOLD_ONCE)
    seen = Seen(*(by_topic(messages) for messages in (recorded, early.messages, late.messages)))
    return seen, {channel["topic"]: channel for channel in early.channels.values()}


@pytest.fixture(scope="module")
def look(tmp_path_factory: pytest.TempPathFactory) -> tuple[Seen, dict[str, dict[str, Any]]]:
    return asyncio.run(looked_at(tmp_path_factory.mktemp("foxglove")))


@pytest.fixture(scope="module")
def seen(look: tuple[Seen, object]) -> Seen:
    return look[0]


def test_channels_are_described_as_in_the_recording(look: tuple[Seen, dict[str, dict[str, Any]]]) -> None:
    seen, channels = look
    assert set(seen.early) == set(seen.recorded) <= set(channels)
    assert channels["/fleet"]["encoding"] == channels["/fleet"]["schemaEncoding"] == "protobuf"
    assert channels["/fleet"]["schemaName"] == "foxglove.SceneUpdate"
    assert channels["/robots/r1/tick"]["schemaName"] == "robofleet.RobotTick"
    assert channels["rf/platoon/tick"]["schemaEncoding"] == "numpy"


def test_who_comes_late_sees_what_is_told_once_as_it_stands(seen: Seen) -> None:
    assert set(seen.late) == TOLD_ONCE
    (newest, last) = (
        {entity.id: entity for entity in SceneUpdate.FromString(messages["/fleet"][-1][1]).entities}
        for messages in (seen.late, seen.recorded)
    )
    assert newest == last and set(newest) == {"r1", "r2", "r3", "r4"}


def test_a_mark_that_was_taken_away_is_not_shown_to_who_comes_late() -> None:
    kept, mark = RetainedMessages(), SceneEntity(id="group/mark")
    kept.take("/arena", SceneUpdate(entities=[mark, SceneEntity(id="edge")]).SerializeToString())
    kept.take("/arena", SceneUpdate(deletions=[SceneEntityDeletion(id=mark.id)]).SerializeToString())
    left = kept.of("/arena")
    assert left is not None
    assert [entity.id for entity in SceneUpdate.FromString(left).entities] == ["edge"]


@pytest.mark.parametrize("request_", [{}, {"key": "guess"}, {"key": 7}, [], "key", {"key": "é"}])
def test_a_service_asks_nothing_of_the_run_without_the_operators_key(request_: object) -> None:
    requests: list[str] = []
    answers = answered(requests, [("hold", request_)])
    assert [answer["success"] for answer in answers] == [False]
    assert "operator's key" in answers[0]["message"]
    assert requests == []


def test_every_service_asks_the_run_what_it_is_called_and_returns_its_answer() -> None:
    calls: list[str] = []
    answers = answered(calls, [(what, {"key": KEY}) for what in SERVICES])
    assert calls == list(SERVICES)
    assert answers == [{"success": True, "message": f"ok {what}"} for what in SERVICES]


def answered(calls: list[str], requests: Sequence[tuple[str, object]]) -> list[dict[str, Any]]:
    """Call services of a server that has no run, and return their answers."""

    def ask(what: str) -> "Future[Outcome]":
        calls.append(what)
        future: Future[Outcome] = Future()
        future.set_result((True, f"ok {what}"))
        return future

    async def call(port: int) -> list[dict[str, Any]]:
        async with viewer(f"ws://127.0.0.1:{port}") as socket:
            client = Viewer(socket)
            await client.until(lambda: len(client.services) == len(SERVICES))
            return [await client.call(*request) for request in requests]

    with closing(SERVER([], services(ask, KEY))) as server:
        return asyncio.run(call(server.port))


def test_all_servers_of_a_run_have_one_key(tmp_path: Path) -> None:
    """The buttons of a layout that is open already go on being served."""
    config = load_config(PLATOON)
    file, key = written(config, tmp_path, asks=True)
    before = file.read_bytes()
    assert written(config, tmp_path, asks=True) == (file, key) and key.encode() in before
    assert file.read_bytes() == before and file.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("content", ["another arena's", "another's", "a link", "others read it"])
def test_a_layout_that_is_not_this_runs_is_not_replaced(content: str, tmp_path: Path) -> None:
    """Beside another computer's arena it stands in the folder that one happens to be in."""
    config, file = load_config(PLATOON), tmp_path / "foxglove.json"
    if content == "another arena's":
        written(load_config(PLATOON.with_name("ros2.yaml")), tmp_path, asks=True)
    elif content == "others read it":
        written(config, tmp_path, asks=True)[0].chmod(0o644)
    elif content == "a link":
        file.symlink_to(PLATOON)
    else:
        file.write_text("{}")
    before = file.read_bytes()
    with pytest.raises(RefusedError, match=r"foxglove\.json.*move it away"):
        written(config, tmp_path, asks=True)
    assert file.read_bytes() == before


def test_an_address_that_others_reach_needs_a_certificate() -> None:
    with pytest.raises(RefusedError, match="robofleet keys"):
        Address("192.0.2.7", 8765).check("nowhere", "--foxglove")
    assert Address("192.0.2.7", 8765).url(8765) == "wss://192.0.2.7:8765"
