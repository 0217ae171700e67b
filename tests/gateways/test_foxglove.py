"""Foxglove's protocol: a viewer gets every channel of the recording, and the operator's services ask for their key."""

import asyncio
import socket
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from typer.testing import CliRunner

from robofleet.cli import app
from robofleet.config.load import load_config
from robofleet.core import refusal
from robofleet.core.refusal import RefusedError
from robofleet.gateways.asking import SERVICES
from robofleet.gateways.place import Served
from robofleet.gateways.viewers.foxglove.server import Server, services, written
from robofleet.gateways.viewers.live import Viewers
from robofleet.gateways.viewers.retained import RetainedMessages
from robofleet.gateways.viewers.server import Opened
from robofleet.operator.asking import Outcome
from robofleet.operator.viewer_address import DEFAULTS, FOXGLOVE, Address, completed
from robofleet.recording.scenes.drawn import Channel
from tests.gateways.foxglove_client import Message, Viewer, viewer
from tests.gateways.overheard import EPOCH_NS, Overheard
from tests.shipped import PLATOON

DEFAULT = DEFAULTS[FOXGLOVE]
HERE = Address("127.0.0.1", 0)
KEY = "the operator's key"
TOLD_ONCE = {"/arena", "/fleet", "/tf_static", "/camera/calibration", "/log"}


class Seen(NamedTuple):
    """What was told of a run in lockstep."""

    recorded: list[Message]
    early: Viewer  # it was there before the run
    late: Viewer  # it came when the run was over


async def looked_at(folder: Path) -> Seen:
    overheard = Overheard(load_config(PLATOON, ["run.duration_s=1"]))
    servers: list[Server] = []

    def opened(channels: Sequence[Channel]) -> Opened:
        servers.append(Server(overheard.config.arena.name, HERE, None, channels, []))
        return Opened(servers[0], "")

    with closing(Viewers(overheard.config, overheard, Served(lambda: False, 0), opened, EPOCH_NS)) as viewers:
        (server,) = servers

        async def subscribed(viewer: Viewer, already: int) -> None:
            await viewer.until(lambda: viewer.channels)
            while server.subscriptions < already + len(viewer.channels):
                await asyncio.sleep(0.01)
            viewers.step(overheard.now_ns)

        url = f"ws://127.0.0.1:{server.port}"
        async with viewer(url) as first, viewer(url) as second:
            early, late = Viewer(first), Viewer(second)
            await subscribed(early, 0)
            assert overheard.run.run() == ("completed", None)
            viewers.step(overheard.now_ns)
            viewers.rest(overheard.now_ns)
            recorded = overheard.recorded(folder / "run.mcap")
            await early.until(lambda: len(early.messages) >= len(recorded))
            await subscribed(late, len(early.channels))
            await late.until(lambda: set(late.counts) >= TOLD_ONCE)
    return Seen(recorded, early, late)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    return asyncio.run(looked_at(tmp_path_factory.mktemp("foxglove")))


def test_a_viewer_gets_what_the_recording_gets_message_by_message(seen: Seen) -> None:
    assert seen.early.counts == Counter(message.topic for message in seen.recorded)
    assert sorted(seen.early.messages) == sorted(seen.recorded), "the same bytes at the same instants"
    drawn = [topic for topic in seen.early.counts if not topic.startswith("rf/")]
    assert {"/tf", "/camera/image", "/robots/r1/tick"} <= set(drawn)


def test_channels_are_described_as_in_the_recording(seen: Seen) -> None:
    channels = {channel["topic"]: channel for channel in seen.early.channels.values()}
    assert channels["/fleet"]["encoding"] == channels["/fleet"]["schemaEncoding"] == "protobuf"
    assert channels["/fleet"]["schemaName"] == "foxglove.SceneUpdate"
    assert channels["/robots/r1/tick"]["schemaName"] == "robofleet.RobotTick"
    assert channels["rf/platoon/tick"]["schemaEncoding"] == "numpy"
    assert set(channels) >= set(seen.early.counts)


def test_who_comes_late_sees_what_is_told_once_as_it_stands(seen: Seen) -> None:
    assert set(seen.late.counts) == TOLD_ONCE
    newest = {message.topic: SceneUpdate.FromString(message.data) for message in seen.late.messages
              if message.topic in ("/arena", "/fleet")}  # fmt: skip
    assert {entity.id for entity in newest["/fleet"].entities} == {"r1", "r2", "r3", "r4"}
    looks = [message.data for message in seen.recorded if message.topic == "/fleet"]
    last = {entity.id: entity for entity in SceneUpdate.FromString(looks[-1]).entities}
    assert {entity.id: entity for entity in newest["/fleet"].entities} == last


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

    with closing(Server("nobody", HERE, None, [], services(ask, KEY))) as server:
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


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (["run", "--foxglove"], DEFAULT),
        (["run", "--foxglove", "--quiet"], DEFAULT),
        (["run", "--foxglove", "lab.yaml"], DEFAULT),
        (["run", "--foxglove", "127.0.0.1:9000"], "127.0.0.1:9000"),
    ],
)
def test_the_address_may_be_left_out(given: list[str], read: str) -> None:
    words = completed(given)
    assert words[words.index("--foxglove") + 1] == read
    assert [word for word in given if word not in words] == []
    assert completed([]) == [], "as a shell asks that completes the command line"


@pytest.mark.parametrize("text", ["nonsense", "127.0.0.1", "127.0.0.1:x", "127.0.0.1:65536", ":8765", "a b:1"])
def test_what_is_no_address_is_refused_in_a_line(text: str) -> None:
    result = CliRunner().invoke(app, ["run", str(PLATOON), "--foxglove", text])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert DEFAULT in result.stderr


def test_a_port_in_use_is_refused_in_a_line_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        at = f"127.0.0.1:{taken.getsockname()[1]}"
        out = str(tmp_path / "run")
        result = CliRunner().invoke(app, ["run", str(PLATOON), "--foxglove", at, "--out", out])
    assert (result.exit_code, result.stderr) == (
        2, f"--foxglove {at}: Address already in use: name a port that is free, or 0 for any\n"
    )  # fmt: skip
    assert not (tmp_path / "run").exists()


def test_without_the_library_a_line_says_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    find_spec = refusal.find_spec
    monkeypatch.setattr(refusal, "find_spec", lambda name: None if name == "foxglove" else find_spec(name))
    result = CliRunner().invoke(app, ["run", str(PLATOON), "--foxglove"])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "this needs foxglove: " in result.stderr and "[foxglove]" in result.stderr


def test_an_address_that_others_reach_needs_a_certificate() -> None:
    with pytest.raises(RefusedError, match="robofleet keys"):
        Address("192.0.2.7", 8765).check("nowhere", "--foxglove")
    assert Address("192.0.2.7", 8765).url(8765) == "wss://192.0.2.7:8765"
