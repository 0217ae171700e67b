"""Strangers' tools open the file of a run: the mcap package's own reader, and rerun."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import McapReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

from robofleet.config.load import load_config
from robofleet.recording.log import RunLog
from robofleet.runs.lockstep import Lockstep
from tests.recording.recorded import index
from tests.shipped import PLATOON

EPOCH_NS = 1_790_000_000 * 10**9
DECODED = {
    "/arena": "foxglove.SceneUpdate",
    "/camera/annotations": "foxglove.ImageAnnotations",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/camera/image": "foxglove.CompressedImage",
    "/fleet": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
    "/references": "foxglove.SceneUpdate",
    "/tf": "foxglove.FrameTransforms",
    "/tf_static": "foxglove.FrameTransforms",
    **{f"/robots/r{k}/pose": "foxglove.PoseInFrame" for k in (1, 2, 3, 4)},
    **{f"/robots/r{k}/tick": "robofleet.RobotTick" for k in (1, 2, 3, 4)},
}


class Written:
    """A run's file, and what was put into it."""

    def __init__(self, file: Path) -> None:
        config = load_config(PLATOON, ["run.duration_s=2"])
        run, messages = Lockstep(config), []
        run.bus.tap(lambda message: messages.append((*message, run.clock.now_ns())))
        self.file = file
        with RunLog(file, config, epoch_ns=EPOCH_NS) as log:
            assert run.run() == ("completed", None)
            for full, payload, at_ns in messages:
                log.add(full, payload, at_ns)
        self.own = Counter(full for full, _, _ in messages)
        _, self.counts = index(file)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return Written(tmp_path_factory.mktemp("viewers") / "run.mcap")


@pytest.mark.slow
def test_every_message_of_the_bus_is_in_the_file_and_beside_it_what_viewers_draw(written: Written) -> None:
    counts = {topic: count for topic, count in written.counts.items() if count}
    assert {topic for topic in counts if not topic.startswith("rf/")} == set(DECODED)
    assert {topic: count for topic, count in counts.items() if topic.startswith("rf/")} == dict(written.own)
    assert counts["/camera/image"] == counts["/camera/annotations"] > 5


def test_the_mcap_packages_reader_decodes_all_that_is_not_ours(written: Written) -> None:
    read: Counter[str] = Counter()
    with written.file.open("rb") as stream:
        reader: McapReader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=list(DECODED)):
            read[channel.topic] += 1
            assert schema is not None
            assert schema.name == decoded.DESCRIPTOR.full_name == DECODED[channel.topic]
            assert message.log_time > EPOCH_NS
    assert dict(read) == {topic: written.counts[topic] for topic in DECODED}


def test_frames_are_told_before_shapes_lie_in_them(written: Written) -> None:
    frames, used = {"world"}, set()
    with written.file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, decoded in reader.iter_decoded_messages(topics=list(DECODED), log_time_order=False):
            if channel.topic.startswith("/tf"):
                frames |= {frame.child_frame_id for frame in decoded.transforms}
            for entity in getattr(decoded, "entities", ()):
                used.add(entity.frame_id)
                assert entity.frame_id in frames, channel.topic
    assert used == {"world", "r1", "r2", "r3", "r4"}


def rows_of_rerun(file: Path) -> tuple[Any, dict[str, int], dict[str, set[str]]]:
    """Return rerun's summary of a file, and by entity: rows with a time, and what they hold."""
    from rerun.chunk import McapReader as Reader

    reader = Reader(file)
    rows: Counter[str] = Counter()
    holds: dict[str, set[str]] = {}
    for chunk in reader.stream():
        if not chunk.is_static:
            rows[chunk.entity_path] += chunk.num_rows
            names = chunk.to_record_batch().schema.names
            holds.setdefault(chunk.entity_path, set()).update(name.partition(":")[0] for name in names)
    return reader.info(), dict(rows), holds


def test_rerun_opens_it_with_as_many_messages(written: Written) -> None:
    info, rows, holds = rows_of_rerun(written.file)
    assert info.summary_source == "embedded"
    assert info.message_count == sum(written.counts.values())
    assert {channel.topic: channel.message_count for channel in info.channels if channel.message_count} == {
        topic: count for topic, count in written.counts.items() if count
    }
    single = {topic: count for topic, count in written.counts.items() if count and not topic.startswith("/tf")}
    assert {path: rows["/" + path.lstrip("/")] for path in single} == single
    transforms = _transforms(written.file)
    assert rows["/tf"] == len(transforms), "rerun counts every frame"
    drawn = {
        "/tf": "Transform3D", "/robots/r1/pose": "InstancePoses3D", "/camera/image": "EncodedImage",
        "/camera/calibration": "Pinhole", "/log": "TextLog",
    }  # fmt: skip
    for path, archetype in drawn.items():
        assert archetype in holds[path]


def _transforms(file: Path) -> list[Any]:
    with file.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=["/tf"])
        return [frame for *_, decoded in messages for frame in decoded.transforms]
