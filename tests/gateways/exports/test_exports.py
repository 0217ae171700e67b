"""What other programs read of an exported run: the numbers that the run has. And what is refused, in a line."""

import json
import os
import subprocess
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas
import pytest
from PIL import Image
from pyarrow import parquet
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

import robofleet
from robofleet.bus.keys import PICTURE, POSES, STATUS, TICK, key
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD, UNIT_STATUS
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.cli import app
from robofleet.core.clock import S
from robofleet.gateways.exports import video
from robofleet.gateways.exports.artist import Artist
from robofleet.gateways.ros2.topics import load
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import about, messages
from robofleet.recording.run import Run
from robofleet.reports.canvas import RunView
from robofleet.reports.recorded_run import RecordedRun
from robofleet.safety.supervisor import Event, Phase
from tests.recording import recorded
from tests.recording_fixtures import Story

LEROBOT = "ROBOFLEET_LEROBOT"  # names a Python that has LeRobot


Topics = dict[str, list[tuple[int, Any]]]  # messages of each topic, with their times [ns]


def done(*words: str | Path) -> str:
    """Return what a command prints."""
    result = CliRunner().invoke(app, list(map(str, words)))
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="session")
def run(run_file: Path) -> RecordedRun:
    return robofleet.load(run_file)


@pytest.fixture(scope="session")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a short run with a camera's images."""
    config = recorded.config("tracker.source=camera", "camera.picture_rate_hz=10")
    file = tmp_path_factory.mktemp("seen") / FILE
    with RunLog(file, config) as log:
        recorded.write(log, recorded.said_in(config))
    return file


def decoded(file: Path, topic: Any, layout: Any) -> list[Any]:
    """Return every message of a topic of a run, with the instant of its arrival [ns]."""
    config = about(file).config
    names = {key(config.arena.name, topic, name) for name in ("", *config.units, *config.camera_names)}
    return [(message.log_ns, layout.decode(message.data)) for full, message in messages(file) if full in names]


@pytest.mark.slow_after_first
@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_are_those_of_the_run(form: str, run: RecordedRun, tmp_path: Path) -> None:
    done("export", run.file, "--to", form, "--out", tmp_path / "out")
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == sorted(f"{name}.{form}" for name in run.tables)
    for name in run.tables:
        file = tmp_path / "out" / f"{name}.{form}"
        read = pandas.read_csv(file) if form == "csv" else pandas.read_parquet(file)
        table = run.table(name, library="pandas")
        assert list(read.columns) == list(table.columns)
        for column in table.columns:
            if table[column].dtype.kind in "fib":
                np.testing.assert_array_equal(read[column].to_numpy(table[column].dtype), table[column].to_numpy())
            else:
                assert read[column].astype(object).tolist() == table[column].astype(object).tolist()


def test_a_parquet_file_says_units_and_run(run: RecordedRun, tmp_path: Path) -> None:
    done("export", run.file, "--to", "parquet", "--out", tmp_path / "out")
    schema = parquet.read_schema(tmp_path / "out" / "poses.parquet")
    assert schema.metadata[b"run"] == FILE.encode() and b"version of numpy" in schema.metadata
    assert schema.field("psi_rad").metadata[b"unit"] == b"rad"
    assert schema.field("pose_error_mm").metadata[b"unit"] == b"mm"


def bag(folder: Path) -> Topics:
    """Return the messages of each topic of a bag, with their times [ns]."""
    found: Topics = defaultdict(list)
    with AnyReader([folder]) as reader:
        for connection, at_ns, data in reader.messages():
            found[connection.topic].append((at_ns, reader.deserialize(data, connection.msgtype)))
    return found


@pytest.fixture(scope="session")
def topics(run: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Topics:
    folder = tmp_path_factory.mktemp("exported") / "bag"
    done("export", run.file, "--to", "rosbag2", "--out", folder)
    return bag(folder)


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec * S + message.header.stamp.nanosec)


@pytest.mark.slow
def test_a_bag_has_wheels_commands_and_poses_of_the_run(run: RecordedRun, topics: Topics) -> None:
    file = run.file
    statuses = [(at, status.robots[0]) for at, status in decoded(file, STATUS, UNIT_STATUS)][:: len(run.config.units)]
    wheels = topics["/r1/joint_states"]
    assert [(at, stamp_ns(message)) for at, message in wheels] == [(at, at) for at, _ in statuses]
    assert [tuple(message.velocity) for _, message in wheels] == [(s.left_rad_s, s.right_rad_s) for _, s in statuses]
    assert [tuple(message.position) for _, message in wheels] == [
        (status.left_angle_rad, status.right_angle_rad) for _, status in statuses
    ]
    vehicle = run.config.robot("r2").vehicle
    ticks = [(at, tick.robots[1]) for at, tick in decoded(file, TICK, TICK_RECORD)]
    commands = [message.twist for _, message in topics["/r2/cmd_vel"]]
    half, base = vehicle.wheel_radius_m / 2, vehicle.wheel_base_m
    np.testing.assert_allclose(
        [(twist.linear.x, twist.angular.z) for twist in commands],
        [((r.left_rad_s + r.right_rad_s) * half, (r.right_rad_s - r.left_rad_s) * 2 * half / base) for _, r in ticks],
        rtol=1e-12, atol=1e-15,
    )  # fmt: skip
    tag = run.config.robot("r1").tag
    poses = [pose for _, image in decoded(file, POSES, FLEET_POSES) for pose in image.poses if pose.tag == tag]
    measured = [(message.pose.pose.position.x, message.pose.pose.position.y) for _, message in topics["/r1/pose"]]
    assert measured == [(pose.x_m, pose.y_m) for pose in poses if pose.coasted_ns == 0][-len(measured) :]
    assert len(measured) > 50


@pytest.mark.slow
def test_frames_of_a_bag_are_one_tree_and_its_log_says_what_happened(topics: Topics) -> None:
    frames = {(f.header.frame_id, f.child_frame_id) for _, message in topics["/tf"] for f in message.transforms}
    assert {("map", "r1/odom"), ("r1/odom", "r1/base_link"), ("r1/base_link", "r1/left_wheel_link")} <= frames
    turns = [f.transform.rotation for _, message in topics["/tf"] for f in message.transforms]
    assert all(abs(t.x**2 + t.y**2 + t.z**2 + t.w**2 - 1) < 1e-9 for t in turns)
    lines = [(line.level, line.msg) for _, line in topics["/rosout"]]
    assert (20, "running: every check passed") in lines
    assert topics["/state"][-1][1].data in {"idle", "running"}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of ROS's own packages
def test_ros_itself_reads_the_messages_and_has_the_same_types(seen: Path, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="NO ROS 2: pip install -e '.[ros2]' on Python 3.11, or source your own")
    from rclpy.serialization import deserialize_message

    done("export", seen, "--to", "rosbag2", "--out", tmp_path / "bag")
    checked = set()
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, _, data in reader.messages():
            if connection.msgtype.startswith(("tf2_msgs", "visualization_msgs")):  # PyPI has no tf2_msgs
                continue
            theirs = deserialize_message(bytes(data), load(connection.msgtype))
            ours = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/r1/odom":
                assert theirs.pose.pose.position.x == ours.pose.pose.position.x
                assert theirs.child_frame_id == ours.child_frame_id == "r1/base_link"
            checked.add(connection.msgtype)
    assert "sensor_msgs/msg/CompressedImage" in checked


@pytest.mark.slow
def test_a_bag_has_the_cameras_images(seen: Path, tmp_path: Path) -> None:
    done("export", seen, "--to", "rosbag2", "--out", tmp_path / "bag")
    topics = bag(tmp_path / "bag")
    pictures = decoded(seen, PICTURE, PICTURE_LAYOUT)
    images = [message for _, message in topics["/overhead/image/compressed"]]
    assert [bytes(image.data) for image in images] == [picture.jpeg for _, picture in pictures]
    assert [stamp_ns(image) for image in images][5:] == [picture.exposure_ns for _, picture in pictures][5:]
    info = topics["/overhead/camera_info"][0][1]
    assert (info.width, info.height, info.k[0]) == (1280, 720, about(seen).config.camera.model.focal_px[0])


def read_dataset(folder: Path, episode: int = 0) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return what a dataset says of itself, and the columns of an episode."""
    info = json.loads((folder / "meta" / "info.json").read_text())
    rows = parquet.read_table(folder / info["data_path"].format(chunk_index=0, file_index=episode))
    return info, {name: np.array(rows[name].to_pylist()) for name in rows.column_names}


def test_a_dataset_has_each_ticks_state_and_commands(run: RecordedRun, tmp_path: Path) -> None:
    done("export", run.file, run.file, "--to", "lerobot", "--out", tmp_path / "set", "--task", "drive in a row")
    info, columns = read_dataset(tmp_path / "set", episode=1)
    commands = run.table("commands", library="pandas")
    poses = run.table("poses", library="pandas")
    driven = commands["run_tick"] >= 0 if "run_tick" in commands else commands["run_time_s"].notna()
    count = len(columns["index"])
    for feature, table, names in (
        ("action", commands, ["left_commanded_rad_s", "right_commanded_rad_s"]),
        ("observation.state", poses, ["x_m", "y_m", "psi_rad"]),
    ):
        for robot in run.robots:
            own = table[driven & (table["robot"] == robot)]
            at = [info["features"][feature]["names"].index(f"{robot}.{name}") for name in names]
            np.testing.assert_array_equal(columns[feature][:, at], own[names].to_numpy(np.float32)[:count])
    assert info["total_episodes"] == 2 and info["total_frames"] == 2 * count and info["splits"] == {"train": "0:2"}
    assert columns["index"].tolist() == list(range(count, 2 * count)) and set(columns["episode_index"]) == {1}
    np.testing.assert_allclose(columns["timestamp"], np.arange(count) * 0.033, rtol=1e-6)
    assert pandas.read_parquet(tmp_path / "set" / "meta" / "tasks.parquet").index.tolist() == ["drive in a row"]
    statistics = json.loads((tmp_path / "set" / "meta" / "stats.json").read_text())
    np.testing.assert_allclose(statistics["action"]["mean"], columns["action"].mean(axis=0), rtol=1e-5)


@pytest.mark.slow
def test_a_datasets_video_has_the_newest_image_of_each_tick(seen: Path, tmp_path: Path) -> None:
    done("export", seen, "--to", "lerobot", "--out", tmp_path / "set")
    info, columns = read_dataset(tmp_path / "set")
    video = tmp_path / "set" / info["video_path"].format(
        video_key="observation.images.overhead", chunk_index=0, file_index=0
    )  # fmt: skip
    with av.open(str(video)) as container:
        frames = [(float(frame.time), frame.to_ndarray(format="gray")) for frame in container.decode(video=0)]
    np.testing.assert_allclose([t for t, _ in frames], columns["timestamp"], atol=1e-4)
    images = list(robofleet.load(seen).images())
    moved = np.std([image.image for image in images[::4]], axis=0) > 20  # where robots drove
    for t, frame in frames[::7]:
        newest = max([k for k, image in enumerate(images) if image.t_s <= t + 1e-6], default=0)
        off = [np.abs(frame[moved].astype(int) - image.image[moved]).mean() for image in images]
        assert off[newest] <= min(off) + 0.5 and off[newest] < 6.0, "as it was, but for its compression"


@pytest.mark.long
def test_lerobot_loads_a_dataset(seen: Path, tmp_path: Path) -> None:
    """LeRobot's own loader, in an environment of its own: its packages exclude ours."""
    python = os.environ.get(LEROBOT)
    if python is None:
        pytest.skip(f"NO LEROBOT: pip install lerobot into another environment, and name its Python in {LEROBOT}")
    done("export", seen, "--to", "lerobot", "--out", tmp_path / "set")
    script = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
run = LeRobotDataset("local/run", root=sys.argv[1], video_backend="pyav", delta_timestamps={"action": [0.0, 0.033]})
items = [run[k] for k in range(0, len(run), 10)]
print(json.dumps([[i["observation.state"].tolist(), i["action"][0].tolist(), i["timestamp"].item(), i["task"],
                   list(i["observation.images.overhead"].shape)] for i in items]))
"""
    environment = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    loaded = json.loads(subprocess.run(
        [python, "-c", script, str(tmp_path / "set")], check=True, capture_output=True, text=True,
        env=environment | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hf")},
    ).stdout.splitlines()[-1])  # fmt: skip
    _, columns = read_dataset(tmp_path / "set")
    rows = range(0, len(columns["index"]), 10)
    assert [item[:2] for item in loaded] == [
        [columns["observation.state"][k].tolist(), columns["action"][k].tolist()] for k in rows
    ]
    assert [item[3:] for item in loaded] == [["platoon", [3, 720, 1280]]] * len(rows)


@pytest.mark.slow
def test_a_film_shows_the_robots_where_they_were(run: RecordedRun, tmp_path: Path) -> None:
    done("film", run.file, "--out", tmp_path / "film.gif", "--width", "320", "--speed", "2")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 20 and film.width == 320 and film.info["loop"] == 0
        film.seek(film.n_frames - 1)
        last = np.asarray(film.convert("RGB")).astype(int)
    blue = (np.abs(last - (0x1B, 0x6C, 0xA8)).sum(axis=2) < 30).nonzero()
    at = np.array([np.mean(axis) for axis in blue[::-1]])
    poses = run.table("poses", library="numpy")
    end = {name: poses[name][poses["robot"] == "r1"][60] for name in ("x_m", "y_m")}
    scale = 320 / (run.config.arena.size_m[0] + 0.2)
    assert abs(at[0] - (160 + scale * end["x_m"])) < 12


def test_a_film_says_when_the_robots_are_held(
    story: Callable[..., Story], add_status: Callable[..., None], add_state: Callable[..., None]
) -> None:
    made = story(ticks=120)
    recording = made.recording()
    for k in range(120):
        add_status(recording, "r1", made.stamp(k))
        if k in {0, 40}:
            add_state(recording, *((Phase.RUNNING, Event.PROVED) if k == 0 else (Phase.HOLD, Event.HOLD_REQUESTED)))
    artist = Artist(RunView(Run(recording), {"stops": []}), "Title", 1.0, 640)
    alarm = [
        np.abs(artist.frame(t)[: artist.header].astype(int) - (0xB3, 0x26, 0x1E)).sum(axis=2).min() for t in (1.0, 2.0)
    ]
    assert alarm[0] > 100 and alarm[1] < 30


def test_a_gif_shows_each_image_and_holds_only_what_changes(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    background = rng.choice(np.array([[255, 255, 255], [40, 60, 90], [200, 80, 20]], np.uint8), (60, 80))
    images = [background.copy() for _ in range(30)]
    for k, image in enumerate(images):
        image[2:12, 2 * k : 2 * k + 10] = image[50:58, 70 - 2 * k : 78 - 2 * k] = (27, 108, 168)
    video.gif(tmp_path / "moving.gif", iter(images), 50)
    video.gif(tmp_path / "still.gif", iter(images[:1]), 50)
    with Image.open(tmp_path / "moving.gif") as film:
        assert film.n_frames == len(images)
        for k, image in enumerate(images):
            film.seek(k)
            np.testing.assert_array_equal(np.asarray(film.convert("RGB")), image)
            assert film.info["duration"] == 50
    still, moving = ((tmp_path / f"{name}.gif").stat().st_size for name in ("still", "moving"))
    assert moving < still + 29 * 250


@pytest.mark.slow
@pytest.mark.parametrize("view", ["camera", "arena"])
def test_a_film_is_as_long_as_what_it_shows(view: str, seen: Path, tmp_path: Path) -> None:
    done("film", seen, "--out", tmp_path / "a.mp4", "--from", "0.5", "--to", "1.5", "--speed", "0.5", "--view", view)
    with av.open(str(tmp_path / "a.mp4")) as film:
        times = [float(frame.time) for frame in film.decode(video=0)]
    assert 1.8 < times[-1] < 2.0 and len(times) == (50 if view == "arena" else pytest.approx(11, abs=1))


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("export", "RUN", "--to", "xls"), "--to: 'xls' is not known: take one of csv, parquet, rosbag2, lerobot"),
        (("export", "nowhere", "--to", "csv"), "nowhere: there is no such recording: name a run's folder"),
        (("export", "RUN", "--to", "csv", "--out", "taken"), "--out: taken exists already: name another place"),
        (("export", "RUN", "RUN", "--to", "csv"), "--to csv: it is made of one run: name one run"),
        (("export", "RUN", "RUN", "--to", "lerobot"), "--out: name the folder of a dataset of several runs"),
        (("export", "RUN", "--to", "csv", "--task", "x"), "--task: csv has no tasks: leave it out"),
        (("film", "nowhere"), "nowhere: there is no such recording: name a run's folder"),
        (("film", "RUN", "--out", "a.avi"), "--out: a.avi: name a file that ends with .mp4 or .gif"),
        (("film", "RUN", "--out", "a.mp4", "--view", "camera"), "RUN: it has no images of a camera: take --view arena"),
        (("film", "RUN", "--out", "a.mp4", "--camera", "b"), "--camera: there is no 'b': take one of overhead"),
        (("film", "RUN", "--out", "a.mp4", "--view", "side"), "--view: 'side' is not known: take one of camera, arena"),
        (("film", "RUN", "--out", "a.mp4", "--speed", "0"), "--speed: 0 is not between 0.01 and 1000"),
        (
            ("film", "RUN", "--out", "a.mp4", "--from", "90"),
            "--from, --to: the run drove from 0 to 2.0 s: name a part of it",
        ),
        (
            ("film", "RUN", "--out", "a.gif", "--speed", "0.01"),
            "--out: a GIF of 4026 images is too long: take --from, --to or --speed, or an .mp4",
        ),
    ],
)
def test_bad_input_is_a_line_and_leaves_nothing(
    words: tuple[str, ...], line: str, run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").mkdir()
    result = CliRunner().invoke(app, [str(run_file) if word == "RUN" else word for word in words])
    assert (result.exit_code, result.stderr.strip()) == (2, line.replace("RUN:", f"{run_file}:").replace(
        "nowhere:", "nowhere:"
    ))  # fmt: skip
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


@pytest.mark.slow_after_first
@pytest.mark.parametrize("form", ["csv", "parquet", "rosbag2", "lerobot"])
def test_a_full_disk_is_a_line_and_leaves_nothing(form: str, run_file: Path, tmp_path: Path) -> None:
    with recorded.room_for(2000):
        result = CliRunner().invoke(app, ["export", str(run_file), "--to", form, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert result.stderr.startswith(f"{tmp_path / 'out'}: cannot be written: ") and result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_killed_run_is_exported_as_far_as_it_goes(
    run_file: Path, run: RecordedRun, topics: Topics, tmp_path: Path
) -> None:
    whole = run_file.read_bytes()
    (tmp_path / FILE).write_bytes(whole[: len(whole) * 2 // 3])
    for form in ("parquet", "rosbag2", "lerobot"):
        done("export", tmp_path / FILE, "--to", form)
    done("film", tmp_path, "--width", "320")
    killed = pandas.read_parquet(tmp_path / "parquet" / "poses.parquet")
    assert 0 < len(killed) < len(run.table("poses", library="pandas"))
    assert 10 < len(bag(tmp_path / "rosbag2")["/r1/odom"]) < len(topics["/r1/odom"])
    assert (tmp_path / "film.mp4").stat().st_size > 1000
