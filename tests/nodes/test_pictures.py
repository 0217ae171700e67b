"""Pictures of what the tracker's camera sees: seldom, more while somebody looks, and never before the poses."""

from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, PICTURE, POSES, SAFE_REQUEST, key
from robofleet.core.clock import S
from robofleet.simulation.faults import Schedule
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraContext, Frame
from tests.nodes.tracker_stand import TICK_NS, TrackerStand

Make = Callable[..., Any]
SPEED = 0.2  # of every robot [m/s]
PX_PER_M = 340.0  # about, at the height of the tags: 2 px from one image to the next


class Stand(TrackerStand):
    """``order``: the keys of all messages, as they came."""

    def __init__(self, bench: Any) -> None:
        self.order: list[str] = []
        bench.bus.tap(lambda message: self.order.append(message[0]))
        faults = Schedule(bench.config, bench.clock) if bench.config.faults else None
        if faults is not None:
            faults.begin(bench.now_ns)
        super().__init__(bench, SPEED, faults=faults)

    def pictures(self, ns: int) -> list[Any]:
        """Let time pass and return every picture so far."""
        return self.run(ns, PICTURE)

    def ask(self, payload: bytes) -> str:
        answer = self.bench.bus.ask(SAFE_REQUEST, "tracker", payload)
        self.node.step(self.bench.now_ns)
        reply = answer.take()
        assert reply is not None
        return str(reply.decode())


@pytest.fixture
def stand_of(bench_of: Make, platoon_of: Make) -> Callable[..., Stand]:
    return lambda *overrides: Stand(bench_of(platoon_of(*overrides)))


def shown(picture: Any) -> np.ndarray:
    """Return a picture's pixels."""
    image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image)


def tags_in(picture: Any) -> dict[int, np.ndarray]:
    """Return where OpenCV's own detector finds tags in a picture: their middles [px of the camera's image]."""
    image = shown(picture)
    corners, ids, _ = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    ).detectMarkers(image)
    scale = picture.width / image.shape[1]
    return {int(tag): (four[0].mean(axis=0) + 0.5) * scale - 0.5 for four, (tag,) in zip(corners, ids, strict=True)}


@pytest.mark.parametrize("rate_hz", [4])
def test_pictures_come_at_their_rate(stand_of: Make, rate_hz: int) -> None:
    pictures = stand_of(f"camera.picture_rate_hz={rate_hz}").pictures(3 * S)
    assert len(pictures) in (3 * rate_hz, 3 * rate_hz + 1)
    assert [picture.seq for picture in pictures] == list(range(1, len(pictures) + 1))
    apart_ns = np.diff([picture.exposure_ns for picture in pictures][1:])
    assert np.abs(apart_ns - S / rate_hz).max() <= TICK_NS


def larger(zoom: float) -> list[str]:
    """Return what makes the overhead camera see the same in so many times the pixels a side."""
    width, height = round(1280 * zoom), round(720 * zoom)
    model = {
        "width": width,
        "height": height,
        "focal_px": [830.0 * zoom] * 2,
        "centre_px": [(pixel + 0.5) * zoom - 0.5 for pixel in (646.0, 359.0)],
    }
    sizes = [f"camera.width={width}", f"camera.height={height}"]
    return sizes + [f"camera.model.{name}={value}" for name, value in model.items()]


def matches(stand: Stand, picture: Any) -> bool:
    """Whether the tags of a picture are where the poses of its image say."""
    (fleet,) = [frame for frame in stand.bench.heard(POSES, CAMERA) if frame.exposure_ns == picture.exposure_ns]
    found, config = tags_in(picture), stand.bench.config
    geometry = CameraGeometry.from_model(config.camera.model)
    points = np.array([(pose.x_m, pose.y_m, config.tracker.tag_height_m) for pose in fleet.poses])
    off = geometry.project(points) - [found[pose.tag] for pose in fleet.poses]
    assert len(off) == len(config.robots)
    return bool(np.hypot(*off.T).max() < 0.5 * SPEED * TICK_NS / S * PX_PER_M)


@pytest.mark.parametrize(("zoom", "parts"), [(1.0, 1), pytest.param(1.5, 2, marks=pytest.mark.long)])
def test_a_picture_is_the_image_of_its_exposure(stand_of: Make, zoom: float, parts: int) -> None:
    stand = stand_of(*larger(zoom))
    picture = stand.pictures(3 * S // 2)[-1]
    assert (picture.width, picture.height) == (1280 * zoom, 720 * zoom)
    assert shown(picture).shape == (720 * zoom // parts, 1280 * zoom // parts)
    assert matches(stand, picture)


@pytest.mark.slow
def test_a_picture_is_of_its_exposure_also_when_the_poses_are_late(stand_of: Make) -> None:
    late = "faults=[{kind: pose_delay, at_s: 0, duration_s: 9, delay_s: 0.1}]"
    stand = stand_of(late)
    picture = stand.pictures(2 * S)[-1]
    assert matches(stand, picture)


@pytest.mark.slow
def test_the_poses_of_its_image_go_before_a_picture(stand_of: Make) -> None:
    stand = stand_of("camera.picture_rate_hz=30")
    pictures, arena = stand.pictures(S), stand.bench.config.arena.name
    order = [full for full in stand.order if full in (key(arena, POSES, CAMERA), key(arena, PICTURE, CAMERA))]
    poses = [frame.exposure_ns for frame in stand.bench.heard(POSES, CAMERA)]
    assert len(pictures) > 20
    for picture, at in zip(pictures, [k for k, full in enumerate(order) if full.endswith("picture")], strict=True):
        before = sum(not full.endswith("picture") for full in order[:at])
        assert poses[before - 1] == picture.exposure_ns


@pytest.mark.slow
def test_pictures_change_nothing_of_the_poses(stand_of: Make) -> None:
    without, with_pictures = (stand_of(f"camera.picture_rate_hz={rate}") for rate in (0, 30))
    assert without.pictures(S) == []
    assert len(with_pictures.pictures(S)) > 20

    def told(stand: Stand) -> list[Any]:
        return [frame._replace(build=0) for frame in stand.bench.heard(POSES, CAMERA)]

    assert told(without) == told(with_pictures)


@pytest.mark.slow
def test_five_a_second_are_shown_for_two_seconds_after_a_request(stand_of: Make) -> None:
    stand = stand_of()
    stand.pictures(S)
    asked_ns = stand.bench.now_ns
    assert stand.ask(b"pictures") == "ok"
    after = [picture.exposure_ns - asked_ns for picture in stand.pictures(5 * S)]
    assert sum(0 <= at < 2 * S for at in after) in (10, 11)
    assert sum(2 * S + TICK_NS <= at < 5 * S for at in after) in (2, 3, 4)


@pytest.mark.slow
def test_who_asks_again_and_again_goes_on_looking(stand_of: Make) -> None:
    stand = stand_of()
    for _ in range(4):
        stand.ask(b"pictures")
        pictures = stand.pictures(S)
    assert len(pictures) in (19, 20, 21)


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("change", "why"),
    [("tracker.source=truth", "tracker.source is not camera"), ("camera.picture_rate_hz=0", "picture_rate_hz")],
)
def test_where_there_are_no_pictures_a_request_is_refused(stand_of: Make, change: str, why: str) -> None:
    stand = stand_of(change)
    stand.pictures(S // 2)
    reply = stand.ask(b"pictures")
    assert reply.startswith("refused: ")
    assert why in reply
    assert stand.pictures(2 * S) == []


@pytest.mark.slow
def test_something_else_that_is_asked_is_refused(stand_of: Make) -> None:
    assert "pictures" in stand_of().ask(b"\xff nonsense")


@pytest.mark.slow
def test_a_camera_that_stalls_shows_nothing_new(stand_of: Make) -> None:
    stand = stand_of("camera.picture_rate_hz=10", "faults=[{kind: camera_stalled, at_s: 1, duration_s: 9}]")
    began_ns = stand.bench.now_ns
    assert max(picture.exposure_ns for picture in stand.pictures(2 * S)) <= began_ns + S


class Hurried:
    """A camera whose images are there at once: what the test gives it."""

    given: ClassVar[deque[Frame]]
    identity = "hurried"

    def __init__(self, _context: CameraContext) -> None:
        type(self).given = deque()

    def ready_ns(self) -> int | None:
        return 0 if self.given else None

    def read(self) -> Frame:
        return self.given.popleft()

    def close(self) -> None:
        """Nothing to let go of."""


def test_an_image_that_is_there_goes_before_a_picture(stand_of: Make) -> None:
    stand = stand_of(f"camera.source='{__name__}:Hurried'", "camera.trigger=free", "camera.noise_gray=0")
    image = np.arange(720 * 1280, dtype=np.uint32).reshape(720, 1280).astype(np.uint8)
    Hurried.given.extend(Frame(image + k, stand.bench.now_ns + k) for k in range(3))
    order = []
    for _ in range(4):
        before = len(stand.order)
        stand.node.step(stand.bench.now_ns)
        order += [full.rpartition("/")[2] for full in stand.order[before:]]
    assert order == ["overhead", "overhead", "overhead", "picture"]
    (picture,) = stand.bench.heard(PICTURE, CAMERA)
    newest = stand.bench.heard(POSES, CAMERA)[-1]
    assert picture.exposure_ns == newest.exposure_ns, "what was to be shown may be written over by then"
