"""What the messages say, against the truth of a lockstep run: frames that compose, poses, wheels, lens."""

import copy
import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from matplotlib.path import Path as Outline

pytest.importorskip("rclpy", reason="NO ROS 2: pip install -e '.[ros2]' on Python 3.11, or source your own")

from robofleet.behaviours.interface import WishKind
from robofleet.bus import sensors
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import SENSORS, WISH
from robofleet.bus.messages import SCRIPT_WISH, UNIT_TRUTH
from robofleet.bus.observer import Observer
from robofleet.bus.ticks import TickFollower
from robofleet.config import groups
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import S, SimulatedClock
from robofleet.gateways.ros2 import camera, run, sensing, topics
from robofleet.gateways.ros2.graph import Messages
from robofleet.gateways.ros2.node_graph import stamped
from robofleet.gateways.ros2.publication import grid
from robofleet.gateways.ros2.robots import Robots
from robofleet.gateways.ros2.sensing import Sensing
from robofleet.gateways.urdf import urdf
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase
from robofleet.tracking.pictures import picture_size
from robofleet.vehicles.readings import SensorReading
from tests.gateways.ros2 import user

TRUTH = "tracker.source=truth", "tracker.truth.position_noise_m=0", "tracker.truth.heading_noise_rad=0"


class Frames:
    """tf2_msgs' message, which PyPI does not have."""

    def __init__(self, transforms: list[Any]) -> None:
        self.transforms = transforms


class Heard:
    """A publisher that somebody listens to; what it says is kept."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def get_subscription_count(self) -> int:
        return 1

    def publish(self, message: Any) -> None:
        self.messages.append(copy.deepcopy(message))  # the next one is the same object


class Paper:
    """A graph that keeps what is said."""

    def __init__(self, namespace: str = "", *, has_transforms: bool = False) -> None:
        self.frames, self.clock, self.has_transforms = topics.Frames(namespace), SimulatedClock(), has_transforms
        self.messages = Messages(lambda name: Frames if name == "tf2_msgs/msg/TFMessage" else topics.load(name))
        self.topics: dict[str, Heard] = defaultdict(Heard)

    def publisher(self, topic: topics.Topic, *names: object) -> Heard:
        return self.topics[topic.name.format(*names)]

    def stamp(self, instant_ns: int) -> Any:
        return stamped(instant_ns)


def driven(config: Config, graph: Paper, seconds: float) -> list[tuple[int, Any]]:
    """Drive r1 in an arc and tell it to a graph; returns r1's truth at its instants."""
    lockstep = Lockstep(config)
    bus, truths = lockstep.bus, list[tuple[int, Any]]()
    ticks = TickFollower(bus, round(config.controller.tick_s * S), lambda _: None)
    names, observer = topics.ros_names(robot.id for robot in config.robots), Observer(bus)
    parts = [
        Robots(graph, config, names, observer, ticks),  # type: ignore[arg-type]
        Sensing(graph, config, names, observer),  # type: ignore[arg-type]
    ]

    def keep(message: tuple[str, bytes]) -> None:
        if message[0].endswith("/truth") and (truth := UNIT_TRUTH.decode(message[1])) is not None:
            truths.extend((truth.stamp_ns, body) for body in truth.robots if body.place == 0)

    bus.tap(keep)
    wish, items = (
        bus.publisher(WISH, groups.taking_setpoints(config, groups.kind(config.groups[0]))[0]),
        np.zeros(4, SCRIPT_WISH.item_dtype),
    )
    items["told"][0], SCRIPT_WISH.floats(items)[0, :2] = 1, (0.1, 0.5)
    lockstep.request(b"start")
    lockstep.advance(60.0, lambda: lockstep.status.phase is Phase.RUNNING)
    begin_ns = lockstep.clock.now_ns()
    for seq in range(1, round(seconds / 0.005)):
        ticks.update()
        if ticks.newest:
            wish(SCRIPT_WISH.encode_array((7, seq, WishKind.BODY, 0, ticks.newest), items))
        lockstep.advance(0.005)
        updated = observer.update(lockstep.clock.now_ns())
        for part in parts:
            part.step(lockstep.clock.now_ns(), updated)
    lockstep.close()
    return [(at_ns, body) for at_ns, body in truths if at_ns >= begin_ns]


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec * S + message.header.stamp.nanosec)


def matrix(message: Any) -> np.ndarray:
    """Return a transform or a pose in the plane as a matrix."""
    position = getattr(message, "translation", None) or message.position
    turn = getattr(message, "rotation", None) or message.orientation
    psi = 2.0 * math.atan2(turn.z, turn.w)
    return np.array(
        [[math.cos(psi), -math.sin(psi), position.x], [math.sin(psi), math.cos(psi), position.y], [0, 0, 1]]
    )


class Drive(NamedTuple):
    """What is said of a run in which r1 drives in an arc, and its truth."""

    config: Config
    graph: Paper
    at_ns: np.ndarray
    known: np.ndarray  # x, y (N, 2) [m]

    def true(self, message: Any) -> list[float]:
        """Return where r1 was at a message's stamp."""
        return [np.interp(stamp_ns(message), self.at_ns, column) for column in self.known.T]

    def said(self, topic: str) -> list[Any]:
        """Return a topic's messages."""
        return self.graph.topics[topic].messages


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return a drive on a graph in a namespace, where there is tf2_msgs."""
    config = load_config(SHIPPED / "ros2.yaml", [*TRUTH, "robots.0.sensors=true"])
    graph = Paper("/lab", has_transforms=True)
    truths = driven(config, graph, 4.0)
    at_ns, known = np.array([at for at, _ in truths]), np.array([(body.x_m, body.y_m) for _, body in truths])
    return Drive(config, graph, at_ns, known)


@pytest.mark.slow
def test_frames_compose_to_where_the_robot_is(drive: Drive) -> None:
    """map -> odom -> base_link is the true pose, although the wheels slip: the tracker corrects odom's place."""
    checked = 0
    for message in drive.said("/tf"):
        frames = {(transform.header.frame_id, transform.child_frame_id): transform for transform in message.transforms}
        if (outer := frames.get(("lab/map", "lab/r1/odom"))) is None:
            continue
        inner = frames["lab/r1/odom", "lab/r1/base_link"]
        assert stamp_ns(outer) == stamp_ns(inner)
        if drive.at_ns[0] <= stamp_ns(inner) <= drive.at_ns[-1]:
            composed = (matrix(outer.transform) @ matrix(inner.transform))[:2, 2]
            assert composed == pytest.approx(drive.true(inner), abs=0.004)
            checked += 1
    assert checked > 100
    assert np.ptp(drive.known, axis=0).max() > 0.1, "it drove"


def test_a_robot_is_described_with_the_frames_and_joints_that_are_told(drive: Drive) -> None:
    """Its wheels' frames are where the URDF has them, turned as the joints are."""
    whole = ElementTree.fromstring(urdf(drive.config.robot("r1")))
    joints = {joint.attrib["name"]: joint for joint in whole.iter("joint")}
    turned = drive.said("r1/joint_states")[-1]
    assert list(turned.name) == list(joints)
    frames = {joint.child_frame_id: joint for joint in drive.said("/tf")[-1].transforms}
    assert {f"lab/r1/{joint.attrib['name']}" for joint in whole.iter("link")} <= frames.keys()
    for name, angle in zip(turned.name, turned.position, strict=True):
        joint = joints[name]
        frame = frames[f"lab/r1/{joint.find('child').attrib['link']}"]
        assert frame.header.frame_id == f"lab/r1/{joint.find('parent').attrib['link']}"
        at = frame.transform.translation
        assert f"{at.x:g} {at.y:g} {at.z:g}" == joint.find("origin").attrib["xyz"]
        turn = frame.transform.rotation
        assert math.remainder(2.0 * math.atan2(turn.y, turn.w) - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)


def test_the_map_is_occupied_where_obstacles_are_and_beside_the_floor() -> None:
    floor = "[[-1.6, -1.0], [1.6, -1.0], [1.6, 0.2], [0.4, 1.0], [-1.6, 1.0]]"
    config = load_config(SHIPPED / "obstacles.yaml", [f"arena.floor_m={floor}"])
    graph = Paper()
    graph.clock = SimulatedClock()  # type: ignore[attr-defined]
    message = grid(graph, config)  # type: ignore[arg-type]
    cells = np.array(message.data).reshape(message.info.height, message.info.width)
    corner, side = message.info.origin.position, message.info.resolution
    assert (cells.shape[1] * side, cells.shape[0] * side) == pytest.approx(config.arena.size_m, abs=side)
    columns, rows = np.meshgrid(np.arange(cells.shape[1]), np.arange(cells.shape[0]))
    middles = np.column_stack([(corner.x + (columns + 0.5) * side).ravel(), (corner.y + (rows + 0.5) * side).ravel()])

    solid, sure = np.zeros(cells.size, np.bool_), np.ones(cells.size, np.bool_)
    for corners, inside in [
        (config.arena.floor_m, False),
        *((marker.polygon_m, True) for marker in config.arena.obstacles),
    ]:
        if corners is not None:
            wider, narrower = (Outline(corners).contains_points(middles, radius=margin) for margin in (1e-6, -1e-6))
            solid |= wider == inside
            sure &= wider == narrower
    for circle in (marker.circle for marker in config.arena.obstacles if marker.circle is not None):
        away = np.hypot(*(middles - (circle.x_m, circle.y_m)).T) - circle.radius_m
        solid |= away < 0.0
        sure &= abs(away) > 1e-6
    assert (cells.ravel() == np.where(solid, 100, 0))[sure].all() and np.count_nonzero(~sure) < 0.01 * cells.size
    assert 0 < np.count_nonzero(cells) < cells.size / 2


def test_a_pose_is_said_at_the_instant_when_it_was_true(drive: Drive) -> None:
    first_ns, last_ns = drive.at_ns[0], drive.at_ns[-1]
    poses = [message for message in drive.said("r1/pose") if first_ns <= stamp_ns(message) <= last_ns]
    assert len(poses) > 50
    for message in poses:
        assert matrix(message.pose.pose)[:2, 2] == pytest.approx(drive.true(message), abs=0.001)
        whole = np.array(message.pose.covariance).reshape(6, 6)
        assert (whole == whole.T).all()
    odom, joints = drive.said("r1/odom"), drive.said("r1/joint_states")
    assert odom[-1].twist.twist.linear.x == pytest.approx(0.1, abs=0.02)
    assert odom[-1].twist.twist.angular.z == pytest.approx(0.5, abs=0.1)
    assert len(joints) == len(odom) and joints[-1].position[1] > joints[-1].position[0] > 0.0
    assert 0.5 < drive.said("r1/battery_state")[-1].percentage <= 1.0


def test_sensors_are_said_in_their_frames(drive: Drive) -> None:
    config, graph = drive.config, drive.graph
    kind = config.robot("r1").vehicle.sensors
    assert kind is not None and kind.distances is not None
    imu = drive.said("r1/imu/data_raw")[-1]
    assert imu.angular_velocity.z == pytest.approx(0.5, abs=0.15)
    assert imu.linear_acceleration.z == pytest.approx(9.8, abs=0.5)
    fixed = {message.child_frame_id for message in sensing.places(graph, config.robot("r1"), "r1", stamped(0))}
    assert len(fixed) == len(kind.distances.places)
    for frame in fixed:
        ranges = drive.said(frame.removeprefix("lab/"))
        assert {message.header.frame_id for message in ranges} == {frame}, (
            "a topic for each sensor, called as its frame"
        )
        assert len(ranges) > 10
        assert all(0.0 < message.range <= message.max_range or math.isinf(message.range) for message in ranges)
    assert not sensing.places(graph, config.robot("r2"), "r2", stamped(0))


def told(readings: Sequence[SensorReading]) -> Paper:
    """Return what is said of readings of r1."""
    config = load_config(SHIPPED / "ros2.yaml", ["robots.0.sensors=true"])
    graph, clock = Paper(), SimulatedClock()
    bus = MemoryBus(config.arena.name, clock, 0)
    observer = Observer(bus)
    part = Sensing(graph, config, topics.ros_names(config.ids), observer)  # type: ignore[arg-type]
    say = bus.publisher(SENSORS, config.sensing[0])
    for seq, reading in enumerate(readings, 1):
        say(sensors.encoded(seq, 0, sensors.said([(0, reading)])))
        part.step(0, observer.update(0))
    return graph


def test_an_imu_says_what_its_reading_has_and_nothing_of_an_older_one() -> None:
    """A GTernal's firmware tells heading and distances alone."""
    turning, gravity = (0.1, 0.2, 0.3), (0.0, 0.0, 9.8)
    silent = SensorReading(heading=0.5, distances=(0.2,) * 7)
    graph = told([SensorReading(gyro=turning, accelerometer=gravity), silent, SensorReading(gyro=turning),
                  SensorReading(accelerometer=gravity)])  # fmt: skip
    readings = graph.topics["r1/imu/data_raw"].messages
    gyros = [(gyro.x, gyro.y, gyro.z) for gyro in (reading.angular_velocity for reading in readings)]
    forces = [(force.x, force.y, force.z) for force in (reading.linear_acceleration for reading in readings)]
    nothing = (0.0, 0.0, 0.0)
    assert gyros == [turning, turning, nothing] and forces == [gravity, nothing, gravity]
    assert [reading.angular_velocity_covariance[0] == -1.0 for reading in readings] == [False, False, True]
    assert [reading.linear_acceleration_covariance[0] == -1.0 for reading in readings] == [False, True, False]
    assert all(reading.orientation_covariance[0] == -1.0 for reading in readings)
    assert not told([silent]).topics["r1/imu/data_raw"].messages


def test_what_no_message_can_have_is_said_as_the_end_of_its_field() -> None:
    """Older releases of ROS 2 raise at what is beyond; and a picture of no bytes is none."""
    for far_ns, end_s in ((2**62, 2**31 - 1), (-(2**62), -(2**31))):
        assert stamped(far_ns).sec == end_s
    far = told([SensorReading(distances=(1e300, -1e300, 0.2, math.nan, 0.2, 0.2, 0.2))])
    ranges = [far.topics[f"r1/range_{number}"].messages[0].range for number in range(4)]
    assert ranges == [math.inf, -math.inf, 0.2, math.inf]
    assert camera.decoded(b"") is None and camera.decoded(b"none") is None


@pytest.mark.parametrize(
    ("size", "small_size"),
    [
        ((1280, 720), (1280, 720)), ((2560, 1440), (1280, 720)), ((3840, 2160), (1280, 720)),
        ((3088, 2064), (1029, 688)),  # whose width no whole number of pixels divides
    ],
)  # fmt: skip
def test_a_lens_is_that_of_the_small_picture(size: tuple[int, int], small_size: tuple[int, int]) -> None:
    """A point that the camera sees at a pixel is at the same place of the small picture, pixels' edges counted."""
    model = load_config(SHIPPED / "ros2.yaml").camera.model
    model = model.model_copy(
        update={
            "width": small_size[0],
            "height": small_size[1],
            "centre_px": (0.4 * small_size[0], 0.6 * small_size[1]),
        }
    )
    parts = [whole / small for whole, small in zip(size, small_size, strict=True)]
    larger = model.model_copy(
        update={
            "width": size[0],
            "height": size[1],
            "focal_px": tuple(f * part for f, part in zip(model.focal_px, parts, strict=True)),
            "centre_px": tuple((c + 0.5) * part - 0.5 for c, part in zip(model.centre_px, parts, strict=True)),
        }
    )
    assert picture_size(*size) == small_size
    info = camera.camera_info(Paper(), larger, "overhead_optical_frame")
    assert (info.width, info.height) == small_size
    rays = np.array([[0.1, -0.2, 1.0], [-0.3, 0.25, 1.0], [0.0, 0.0, 1.0]])
    small, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.array(info.k).reshape(3, 3), np.array(info.d))
    plain = np.array(
        [[model.focal_px[0], 0, model.centre_px[0]], [0, model.focal_px[1], model.centre_px[1]], [0, 0, 1]]
    )
    known, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), plain, np.array(model.distortion))
    assert small == pytest.approx(known, abs=1e-6)
    assert np.array(info.p).reshape(3, 4)[:, :3] == pytest.approx(np.array(info.k).reshape(3, 3))


def test_a_camera_hangs_where_it_was_measured() -> None:
    settings = load_config(SHIPPED / "ros2.yaml").camera
    model, hung = settings.model, camera.place(Paper(), settings, stamped(0))
    assert hung is not None and model.T_world_camera is not None
    q, way = hung.transform.rotation, hung.transform.translation
    assert (way.x, way.y, way.z) == pytest.approx(model.T_world_camera.position_m)
    turned, _ = cv2.Rodrigues(np.array(model.T_world_camera.rotation_rad))
    ahead = np.array([2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)])
    assert ahead == pytest.approx(turned[:, 2]) and ahead[2] < -0.9, "it looks down"


def test_markers_are_in_frames_that_are_said() -> None:
    config = load_config(SHIPPED / "ros2.yaml")
    drawn = run.markers(Paper(), config, topics.ros_names(robot.id for robot in config.robots)).markers
    assert {marker.header.frame_id for marker in drawn} == {"map", *(f"r{k}/base_link" for k in (1, 2, 3, 4))}
    assert len({(marker.ns, marker.id) for marker in drawn}) == len(drawn)


def test_a_namespace_is_in_front_of_every_frame(drive: Drive) -> None:
    """So several arenas share one tree of frames."""
    config, graph = drive.config, drive.graph
    names = topics.ros_names(robot.id for robot in config.robots)
    every_message = [message for topic in graph.topics.values() for message in topic.messages]
    every_message += [
        *run.markers(graph, config, names).markers,
        camera.place(graph, config.camera, stamped(0)),
    ]
    every_message += sensing.places(graph, config.robot("r1"), "r1", stamped(0))
    found = {frame for message in every_message for frame in user.frames(message)}
    assert {"lab/map", "lab/r1/odom", "lab/r1/base_link", "lab/overhead_optical_frame", "lab/r1/range_0"} <= found
    assert all(frame.startswith("lab/") for frame in found)
