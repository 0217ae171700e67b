"""rerun's protocol: a viewer gets what rerun's importer makes of the recording, and shapes beside it."""

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from random import Random
from typing import NamedTuple

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

from robofleet.config.load import load_config
from robofleet.core.refusal import RefusedError
from robofleet.gateways.viewers.rerun.server import Server
from robofleet.gateways.viewers.rerun.shapes import of_entity
from robofleet.operator.viewer_address import RERUN, Address
from robofleet.recording.channels import Channel
from robofleet.recording.run import Recording
from robofleet.reports.layouts.rerun_blueprint import TIMELINE, blueprint
from tests.gateways.overheard import EPOCH_NS, Overheard
from tests.gateways.rerun_client import Rows, Saving, imported
from tests.gateways.viewer_contract import HERE, Messages, Seen, ViewerContract

CONFIGS = Path(__file__).parents[2] / "configs"
OBSTACLES = CONFIGS / "obstacles.yaml"
TEXT = "/arena", "/fleet", "/references", "/camera/annotations"  # what rerun's importer takes as text
DRAWN = {
    "/arena/arena": {"LineStrips3D"}, "/arena/obstacles/box": {"Mesh3D", "LineStrips3D", "Points3D"},
    "/fleet/r1": {"Cylinders3D", "Arrows3D", "Points3D"}, "/references/references": {"Ellipsoids3D", "LineStrips3D"},
    "/camera/annotations": {"LineStrips2D", "Points2D"},
}  # fmt: skip


class TestRerun(ViewerContract):
    viewer = package = RERUN
    drawn = frozenset({"/tf", "/tf_static", "/log", "/camera/image", "/camera/calibration", "/robots/r1/pose"})

    def server(self, at: Address) -> Server:
        return Server("nobody", at, None, [])


class Look(NamedTuple):
    """What viewers were told of a run in lockstep, and what the importer makes of its recording."""

    recorded: Rows
    early: Rows
    late: Rows

    @property
    def drawn(self) -> Rows:
        """What rerun shows of the recording."""
        return {path: rows for path, rows in self.recorded.items() if not path.startswith("/rf") and path not in TEXT}


@pytest.fixture(scope="module")
def look(tmp_path_factory: pytest.TempPathFactory) -> Look:
    folder, overheard = tmp_path_factory.mktemp("rerun"), Overheard(load_config(OBSTACLES, ["run.duration_s=1"]))

    def whole(rows: Rows) -> bool:
        return all(len(rows.get(path, ())) >= len(drawn) for path, drawn in Look(recorded, {}, {}).drawn.items())

    with overheard.shown(partial(Server, "nobody", HERE, blueprint(Recording(overheard.config)))) as (viewers, server):
        with closing(Saving(server.url, folder / "early.rrd")) as viewer:
            viewer.connected()
            recorded = imported(overheard.played(viewers, folder / "run.mcap"))
            early = viewer.until(whole)
        with closing(Saving(server.url, folder / "late.rrd")) as viewer:
            return Look(recorded, early, viewer.until(whole))


@pytest.fixture(scope="module")
def seen(look: Look) -> Seen:
    return Seen(*map(in_order, (look.drawn, look.early, look.late)))


def test_shapes_and_outlines_are_drawn_below_the_names_of_their_topics(look: Look) -> None:
    for path, kinds in DRAWN.items():
        assert {name.partition(":")[0] for row in look.early[path] for name in row} >= kinds, path
    others = {path for path in look.early if path not in look.recorded and not path.startswith("/__")}
    assert all(path.startswith(tuple(f"{topic}/" for topic in TEXT)) for path in others)
    assert look.early["/fleet/r1"][-1]["CoordinateFrame:frame"] == ["r1"], "viewers move it by its frame"
    plane = look.early["/camera/image"][-1]["CoordinateFrame:frame"]
    assert look.early["/camera/annotations"][-1]["CoordinateFrame:frame"] == plane


def test_a_shape_with_figures_beyond_any_number_ends_no_viewer() -> None:
    huge = Pose(orientation=Quaternion(w=1e200, x=1e200))
    entity = SceneEntity(lines=[LinePrimitive(pose=huge, points=[Point3(x=1e200, y=1e200)])])
    assert list(of_entity(entity))


def test_who_comes_late_gets_the_same(seen: Seen) -> None:
    assert seen.late == seen.early


def in_order(table: Rows) -> Messages:
    """Return rows that can be compared, without what rerun tells of itself."""
    return {
        path: sorted(repr(sorted(row.items())) for row in rows)
        for path, rows in table.items()
        if not path.startswith("/__")
    }


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


def test_an_address_that_others_reach_is_refused() -> None:
    with pytest.raises(RefusedError, match=r"no encryption.*ssh -N -L"):
        Address.read(RERUN, "192.0.2.7:9877", "--rerun")
