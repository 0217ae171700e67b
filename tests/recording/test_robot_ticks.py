"""Each robot's ticks in the file of a run: a channel a robot, every column with its unit, equal to metrics.csv."""

import csv
import math
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from robofleet.bus.keys import TICK, key
from robofleet.recording.columns import COLUMNS, write_csv
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import read
from robofleet.recording.run import Run
from tests.recording import recorded

ROBOTS = ["r1", "r2", "r3", "r4"]
UNITS = {
    "_m": "[m]", "_mm": "[mm]", "_rad": "[rad]", "_deg": "[deg]", "_m_s": "[m/s]", "_rad_s": "[rad/s]", "_ms": "[ms]",
}  # fmt: skip
MEASURES = ["timed_error_mm", "path_error_mm", "centre_error_mm", "spacing_mm"]
OWN = ["control_error_mm", "estimated_path_error_mm", "estimated_spacing_mm", "reference_parameter", *MEASURES]
NO_UNIT = {"tick", "run_tick", "saturated", "measured", "lost", "filtered", "blocked", "failed"}


def told_in(file: Path) -> tuple[dict[str, list[Any]], dict[str, list[int]], dict[str, bytes]]:
    """Return the messages of each robot's ticks, when each was logged, and the schemas' data by topic."""
    ticks, logged, schemas = defaultdict(list), defaultdict(list), {}
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = [f"/robots/{robot}/tick" for robot in ROBOTS]
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=topics, log_time_order=False):
            ticks[channel.topic].append(decoded)
            logged[channel.topic].append(message.log_time)
            schemas[channel.topic] = schema.data if schema else b""
    return ticks, logged, schemas


def test_each_robot_has_a_channel_with_every_column_of_every_tick(run_file: Path, tmp_path: Path) -> None:
    recording = read(run_file)
    reported, logged, _ = told_in(run_file)
    ticks = Run(recording, every_tick=True).ticks
    assert len(ticks) > 150, "more than a batch, or nothing is tried"
    write_csv([Run(recording)], tmp_path / "m.csv")
    with (tmp_path / "m.csv").open() as text:
        rows = {(row["robot"], int(row["tick"])): row for row in csv.DictReader(text)}
    compared = 0
    for robot in ROBOTS:
        messages, times = reported[f"/robots/{robot}/tick"], logged[f"/robots/{robot}/tick"]
        assert [message.tick for message in messages] == ticks["tick"].tolist()
        assert [message.run_tick for message in messages] == ticks["run_tick"].tolist()
        assert times == sorted(times)
        for message in messages:
            row = rows.get((robot, message.tick))
            assert row is not None or message.run_tick < 0
            columns = [*((column.name, column.csv or column.name) for column in COLUMNS), *((own, own) for own in OWN)]
            for name, of_csv in columns if row else ():
                value, cell = getattr(message, name), row[of_csv]
                if cell == "" and name in MEASURES:
                    continue  # it does not count yet
                where = f"{robot}, tick {message.tick}: {name}"
                assert math.isnan(value) if cell == "" else value == pytest.approx(float(cell), rel=1e-5), where
                compared += cell != ""
    assert compared > 6_000


def test_errors_are_told_only_while_the_fleet_is_running(run_file: Path) -> None:
    ticks, _, _ = told_in(run_file)
    for message in ticks["/robots/r2/tick"]:
        known = {name: not math.isnan(getattr(message, name)) for name in ("control_error_mm", "path_error_mm", "x_m")}
        running = message.run_tick >= 0
        assert known == {"control_error_mm": running, "path_error_mm": running, "x_m": not message.lost}


def test_every_field_is_named_with_its_unit_and_the_schema_says_what_it_is(run_file: Path) -> None:
    _, _, schemas = told_in(run_file)
    for data in schemas.values():
        (file,) = FileDescriptorSet.FromString(data).file
        (message,) = file.message_type
        comments = {number.path[3]: number.leading_comments for number in file.source_code_info.location}
        names = [field.name for field in message.field]
        assert names == ["tick", "run_tick", *(column.name for column in COLUMNS), *OWN]
        for number, name in enumerate(names):
            assert comments[number].strip()
            if name not in NO_UNIT | {"reference_parameter"}:
                unit = UNITS[max((end for end in UNITS if name.endswith(end)), key=len)]
                assert unit in comments[number], name


@pytest.mark.slow
def test_the_ticks_before_a_kill_are_in_the_file_but_for_the_newest_seconds(tmp_path: Path) -> None:
    log = RunLog(tmp_path / FILE, recorded.config())
    run_messages = recorded.said_in(recorded.config())
    for full, payload, at_ns in run_messages:
        log.add(full, payload, at_ns)
    log.flush(run_messages[-1][2] + 10**9)
    (tmp_path / "killed.mcap").write_bytes((tmp_path / FILE).read_bytes())
    log.close()
    from robofleet.recording.repair import repair

    repair(tmp_path / "killed.mcap")
    written, whole = (told_in(tmp_path / name)[0]["/robots/r3/tick"] for name in ("killed.mcap", FILE))
    assert 0 < len(whole) - len(written) <= 74
    assert [message.SerializeToString() for message in written] == [
        message.SerializeToString() for message in whole[: len(written)]
    ]


def test_ticks_of_another_size_are_left_out(run_file: Path, tmp_path: Path) -> None:
    config = recorded.config()
    full = key(config.arena.name, TICK)
    with RunLog(tmp_path / FILE, config) as log:
        for payload in (b"", b"\x04", read(run_file).messages[full][0]):
            log.add(full, payload, 5)
    assert [len(messages) for messages in told_in(tmp_path / FILE)[0].values()] == [1, 1, 1, 1]


Make = Callable[..., Any]


def test_without_truth_only_what_is_estimated_is_told(story: Make, tmp_path: Path) -> None:
    run = story(ticks=30)
    with RunLog(tmp_path / FILE, run.config) as log:
        for index, (full, payload) in enumerate(recorded.in_order(run.recording(truth=False))):
            log.add(full, payload, index)
    last = told_in(tmp_path / FILE)[0]["/robots/r2/tick"][-1]
    assert math.isnan(last.path_error_mm)
    assert math.isnan(last.left_measured_rad_s)
    assert last.spacing_mm == pytest.approx(1e3 * run.settings["spacing_m"], rel=1e-3)
    assert last.exposure_to_tick_ms == pytest.approx(18.0)
