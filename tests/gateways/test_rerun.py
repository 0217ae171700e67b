"""rerun's protocol: a viewer gets what rerun's importer makes of the recording, and shapes beside it."""

import math
import socket
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from random import Random
from typing import Any

import pytest
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from typer.testing import CliRunner

from robofleet.cli import app
from robofleet.config.load import load_config
from robofleet.core import refusal
from robofleet.core.clock import S
from robofleet.core.refusal import RefusedError
from robofleet.gateways.place import Served
from robofleet.gateways.viewers.live import Viewers
from robofleet.gateways.viewers.rerun.server import Server
from robofleet.gateways.viewers.rerun.shapes import of_entity
from robofleet.gateways.viewers.server import Opened
from robofleet.operator.viewer_address import DEFAULTS, RERUN, Address, completed
from robofleet.recording.channels import Channel
from robofleet.recording.run import Recording
from robofleet.reports.layouts.rerun_blueprint import TIMELINE, blueprint
from tests.gateways.overheard import EPOCH_NS, Overheard
from tests.gateways.rerun_client import Rows, Saving, imported

CONFIGS = Path(__file__).parents[2] / "configs"
OBSTACLES = CONFIGS / "obstacles.yaml"
HERE = Address("127.0.0.1", 0)
TEXT = "/arena", "/fleet", "/references", "/camera/annotations"  # what rerun's importer takes as text
DRAWN = {
    "/arena/arena": {"LineStrips3D"}, "/arena/obstacles/box": {"Mesh3D", "LineStrips3D", "Points3D"},
    "/fleet/r1": {"Cylinders3D", "Arrows3D", "Points3D"}, "/references/references": {"Ellipsoids3D", "LineStrips3D"},
    "/camera/annotations": {"LineStrips2D", "Points2D"},
}  # fmt: skip


class Seen:
    """What a viewer was told of a run in lockstep, and what the importer makes of its recording."""

    def __init__(self, folder: Path) -> None:
        overheard = Overheard(load_config(OBSTACLES, ["run.duration_s=1"]))
        shown = blueprint(Recording(overheard.config))
        servers: list[Server] = []

        def opened(channels: Sequence[Channel]) -> Opened:
            servers.append(Server(overheard.config.arena.name, HERE, shown, channels))
            return Opened(servers[0], "")

        with closing(Viewers(overheard.config, overheard, Served(lambda: False, 0), opened, EPOCH_NS)) as viewers:
            with closing(Saving(servers[0].url, folder / "early.rrd")) as early:
                early.connected()
                assert overheard.run.run() == ("completed", None)
                viewers.step(overheard.now_ns)
                viewers.rest(overheard.now_ns + S)  # when what waits for company is due
                overheard.recorded(folder / "run.mcap")
                self.recorded = imported(folder / "run.mcap")
                self.early = early.until(self.is_whole)
            with closing(Saving(servers[0].url, folder / "late.rrd")) as late:
                self.late = late.until(self.is_whole)

    def is_whole(self, table: Rows) -> bool:
        """Whether all is there that rerun reads in the recording."""
        drawn = {path: len(rows) for path, rows in self.recorded.items() if not path.startswith("/rf")}
        return all(len(table.get(path, ())) >= drawn[path] for path in drawn if path not in TEXT)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    return Seen(tmp_path_factory.mktemp("rerun"))


@pytest.mark.slow
def test_a_viewer_gets_what_rerun_reads_in_the_recording(seen: Seen) -> None:
    drawn = {path: rows for path, rows in seen.recorded.items() if not path.startswith("/rf") and path not in TEXT}
    assert {"/tf", "/tf_static", "/log", "/camera/image", "/camera/calibration", "/robots/r1/pose"} <= set(drawn)
    for path, rows in drawn.items():
        assert in_order(seen.early[path]) == in_order(rows), path


def test_shapes_and_outlines_are_drawn_below_the_names_of_their_topics(seen: Seen) -> None:
    for path, kinds in DRAWN.items():
        assert {name.partition(":")[0] for row in seen.early[path] for name in row} >= kinds, path
    others = {path for path in seen.early if path not in seen.recorded and not path.startswith("/__")}
    assert all(path.startswith(tuple(f"{topic}/" for topic in TEXT)) for path in others)
    assert seen.early["/fleet/r1"][-1]["CoordinateFrame:frame"] == ["r1"], "viewers move it by its frame"
    plane = seen.early["/camera/image"][-1]["CoordinateFrame:frame"]
    assert seen.early["/camera/annotations"][-1]["CoordinateFrame:frame"] == plane


def test_a_shape_with_figures_beyond_any_number_ends_no_viewer() -> None:
    huge = Pose(orientation=Quaternion(w=1e200, x=1e200))
    entity = SceneEntity(lines=[LinePrimitive(pose=huge, points=[Point3(x=1e200, y=1e200)])])
    assert list(of_entity(entity))


def test_who_comes_late_gets_the_same(seen: Seen) -> None:
    for path, rows in seen.early.items():
        if not path.startswith("/__"):
            assert in_order(seen.late[path]) == in_order(rows), path


def in_order(rows: list[dict[str, Any]]) -> list[str]:
    return sorted(repr(sorted((name, rounded(value)) for name, value in row.items())) for row in rows)


def rounded(value: Any) -> Any:
    """Return a value whose numbers lost their last digits, and the sign of zero."""
    if isinstance(value, float):
        return "NaN" if math.isnan(value) else round(value, 5) + 0.0
    if isinstance(value, list | tuple):
        return [rounded(part) for part in value]
    return {name: rounded(part) for name, part in value.items()} if isinstance(value, dict) else value


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    shown = blueprint(Recording(load_config(OBSTACLES)))
    channels = [Channel("/arena", "protobuf", "foxglove.SceneUpdate", "protobuf", b"")]
    server = Server("nobody", HERE, shown, channels, "1MB")
    with closing(server):
        yield server


def test_a_shape_that_is_taken_away_or_loses_a_part_is_not_shown_any_more(server: Server, tmp_path: Path) -> None:
    both = SceneEntity(id="group/mark", spheres=[SpherePrimitive()], texts=[TextPrimitive(text="here")])
    less = SceneEntity(id="group/mark", texts=[TextPrimitive(text="there")])
    gone = SceneUpdate(deletions=[SceneEntityDeletion(id="group/mark")])
    for at, update in enumerate([SceneUpdate(entities=[both]), SceneUpdate(entities=[less]), gone], 1):
        server.tell("/arena", at, update.SerializeToString())
    with closing(Saving(server.url, tmp_path / "told.rrd")) as late:
        rows = late.until(lambda seen: len(seen.get("/arena/group/mark", ())) >= 4)["/arena/group/mark"]
    cleared = [row for row in rows if "Clear:is_recursive" in row]
    assert [row[TIMELINE].value for row in cleared] == [2, 3]
    assert not any("Ellipsoids3D:centers" in row for row in rows if row[TIMELINE].value > 1)


@pytest.mark.slow
def test_who_comes_late_sees_what_the_limit_of_memory_has_cost(server: Server, tmp_path: Path) -> None:
    draw, again_ns = Random(1), EPOCH_NS + 60 * 10**9
    server.step(EPOCH_NS)
    server.tell("/arena", EPOCH_NS, SceneUpdate(entities=[SceneEntity(id="edge")]).SerializeToString())
    with closing(Saving(server.url, tmp_path / "early.rrd")) as early:
        early.until(lambda seen: "/arena/edge" in seen)
    for at in range(4000):
        large = SceneEntity(id="large", texts=[TextPrimitive(text=draw.randbytes(2048).hex())])
        server.tell("/arena", EPOCH_NS + at, SceneUpdate(entities=[large]).SerializeToString())
    server.step(again_ns)
    with closing(Saving(server.url, tmp_path / "late.rrd")) as late:
        rows = late.until(lambda seen: "/arena/edge" in seen)
    assert len(rows["/arena/large"]) < 3000, "the limit held"
    assert [row[TIMELINE].value for row in rows["/arena/edge"]] == [again_ns]


@pytest.mark.parametrize("given", [["run", "--rerun"], ["run", "--rerun", "--quiet"], ["run", "--rerun", "lab.yaml"]])
def test_the_address_may_be_left_out(given: list[str]) -> None:
    words = completed(given)
    assert words[words.index("--rerun") + 1] == DEFAULTS[RERUN]
    assert completed(["--foxglove", "--rerun"])[-1] == DEFAULTS[RERUN]


@pytest.mark.parametrize("text", ["nonsense", "127.0.0.1:65536"])
def test_what_is_no_address_is_refused_in_a_line(text: str) -> None:
    result = CliRunner().invoke(app, ["run", str(OBSTACLES), "--rerun", text])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert DEFAULTS[RERUN] in result.stderr


def test_an_address_that_others_reach_is_refused() -> None:
    with pytest.raises(RefusedError, match=r"no encryption.*ssh -N -L"):
        Address.read(RERUN, "192.0.2.7:9877", "--rerun")


def test_a_port_in_use_is_refused_in_a_line_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        at = f"127.0.0.1:{taken.getsockname()[1]}"
        result = CliRunner().invoke(app, ["run", str(OBSTACLES), "--rerun", at, "--out", str(tmp_path / "run")])
    assert (result.exit_code, result.stderr) == (
        2, f"--rerun {at}: Address already in use: name a port that is free, or 0 for any\n"
    )  # fmt: skip
    assert not (tmp_path / "run").exists()


def test_a_server_whose_port_is_in_use_says_so() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(OSError, match="in use"):
        Server("nobody", Address(*taken.getsockname()), None, [])


def test_without_the_package_a_line_says_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    find_spec = refusal.find_spec
    monkeypatch.setattr(refusal, "find_spec", lambda name: None if name == "rerun" else find_spec(name))
    result = CliRunner().invoke(app, ["run", str(OBSTACLES), "--rerun"])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "this needs rerun: " in result.stderr and "[rerun]" in result.stderr


def test_a_run_in_lockstep_has_no_viewers() -> None:
    result = CliRunner().invoke(app, ["run", str(OBSTACLES), "--lockstep", "--rerun"])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
