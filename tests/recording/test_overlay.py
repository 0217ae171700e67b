"""The camera's pictures in a viewer: what the tracker found is drawn where it is to be seen."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, PICTURE, POSES, key
from robofleet.bus.messages import FLEET_POSES, FleetPoses, Picture, TagPose
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.simulation.scene import scene_renderer
from robofleet.tracking.pictures import jpeg
from tests.recording.viewer import Viewer, instant_ns

Make = Callable[..., Any]
AT_NS = 5 * S
EXPOSED_NS = 77 * S  # on the tracker's clock, which is another one
LATE_NS = 20 * MS  # from there until the poses were sent


def larger(zoom: float) -> list[str]:
    """Return what makes the overhead camera see the same in so many times the pixels a side."""
    width, height = round(1280 * zoom), round(720 * zoom)
    centre = [(pixel + 0.5) * zoom - 0.5 for pixel in (646.0, 359.0)]
    model = {"width": width, "height": height, "focal_px": [830.0 * zoom] * 2, "centre_px": centre}
    sizes = [f"camera.width={width}", f"camera.height={height}"]
    return sizes + [f"camera.model.{name}={value}" for name, value in model.items()]


def starts_of(config: Config) -> list[tuple[float, float, float]]:
    return [(robot.start.x_m, robot.start.y_m, robot.start.psi) for robot in config.robots]


def look(
    config: Config, image: np.ndarray | None = None, coasted_ns: int = 0, exposed_ns: int = EXPOSED_NS
) -> tuple[Viewer, np.ndarray]:
    """Let a viewer see an image of the robots at their start; returns the picture that it is shown, too."""
    starts = starts_of(config)
    image = np.zeros((config.camera.height, config.camera.width), np.uint8) if image is None else image
    poses = tuple(TagPose(r.tag, 0, coasted_ns, *at) for r, at in zip(config.robots, starts, strict=True))
    fleet = FleetPoses(1, 1, 1, EXPOSED_NS, EXPOSED_NS + LATE_NS, 1, 0, 0, 0, poses)
    picture = Picture(1, 1, exposed_ns, config.camera.width, config.camera.height, jpeg(image))
    viewer, arena = Viewer(config), config.arena.name
    viewer.tell(key(arena, POSES, CAMERA), FLEET_POSES.encode(fleet), AT_NS)
    later = fleet._replace(seq=2, exposure_ns=EXPOSED_NS + 33 * MS, sent_ns=EXPOSED_NS + 53 * MS, poses=poses[:1])
    viewer.tell(key(arena, POSES, CAMERA), FLEET_POSES.encode(later), AT_NS + 33 * MS)
    viewer.tell(key(arena, PICTURE, CAMERA), PICTURE_LAYOUT.encode(picture), AT_NS + 34 * MS)
    (shown,) = viewer.messages["/camera/image"]
    assert (shown.format, shown.frame_id) == ("jpeg", CAMERA)
    pixels = cv2.imdecode(np.frombuffer(shown.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return viewer, np.asarray(pixels)


@pytest.mark.parametrize("zoom", [1.0, pytest.param(1.5, marks=pytest.mark.long)])
def test_outlines_are_around_the_tags_that_are_to_be_seen(story: Make, zoom: float) -> None:
    config = story(*larger(zoom)).config
    image = scene_renderer(config, np.random.default_rng(1)).render(np.array(starts_of(config)))
    viewer, pixels = look(config, image)
    family, refined = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), cv2.aruco.DetectorParameters()
    refined.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    found, ids, _ = cv2.aruco.ArucoDetector(family, refined).detectMarkers(pixels)
    corners = {int(tag): four[0] + 0.5 for four, (tag,) in zip(found, ids, strict=True)}  # from the image's corner
    (drawn,) = viewer.messages["/camera/annotations"]
    assert [text.text for text in drawn.texts] == [robot.id for robot in config.robots]
    middles_off = []
    for robot, outline, text in zip(config.robots, drawn.points, drawn.texts, strict=True):
        at = np.array([(point.x, point.y) for point in outline.points])
        assert (
            np.linalg.norm(at[:, None] - corners[robot.tag][None], axis=-1).min(axis=1).max() < 1.5
        )  # OpenCV stays inside
        middles_off.append(at.mean(axis=0) - corners[robot.tag].mean(axis=0))
        assert np.hypot(*(at.mean(axis=0) - (text.position.x, text.position.y))) < 30
    assert np.hypot(*np.mean(middles_off, axis=0)) < 0.15, "and not half a pixel aside"


def test_a_picture_is_of_the_moment_of_its_exposure(story: Make) -> None:
    """The tracker's clock is another one: what counts is how long before its poses came the image was taken."""
    viewer, _ = look(story().config)
    for topic in ("/camera/image", "/camera/annotations"):
        assert instant_ns(viewer.messages[topic][0].timestamp) == AT_NS - LATE_NS


def test_a_tag_that_was_predicted_has_another_colour(story: Make) -> None:
    inks = []
    for coasted_ns in (0, 50 * MS):
        (drawn,) = look(story().config, coasted_ns=coasted_ns)[0].messages["/camera/annotations"]
        inks.append({(p.outline_color.r, p.outline_color.g, p.outline_color.b) for p in drawn.points})
    assert len(inks[0]) == len(inks[1]) == 1
    assert inks[0] != inks[1]


def test_a_picture_whose_poses_never_came_is_shown_without_outlines(story: Make) -> None:
    viewer, _ = look(story().config, exposed_ns=EXPOSED_NS - S)
    assert len(viewer.messages["/camera/image"]) == 1
    assert viewer.messages["/camera/annotations"] == []


LENSES = {
    "pinhole without distortion": ("pinhole", []),
    "plumb bob": ("pinhole", [-0.1, 0.015, 0.0004, -0.0003, 0.0]),
    "four terms": ("pinhole", [-0.1, 0.015, 0.0004, -0.0003]),
    "rational": ("pinhole", [-0.1, 0.015, 0.0004, -0.0003, 0.0, 0.01, 0.002, 0.0]),
    "fisheye": ("fisheye", [-0.02, 0.003, 0.0, 0.0]),
}


@pytest.mark.parametrize("zoom", [1.0, 1.5])
@pytest.mark.parametrize("lens", LENSES)
def test_a_viewer_that_projects_by_the_calibration_finds_the_tags(story: Make, lens: str, zoom: float) -> None:
    kind, terms = LENSES[lens]
    config = story(*larger(zoom), f"camera.model.lens={kind}", f"camera.model.distortion={terms}").config
    viewer, pixels = look(config)
    (calibration,), (static,) = viewer.messages["/camera/calibration"], viewer.messages["/tf_static"]
    assert (calibration.height, calibration.width) == pixels.shape
    (transform,) = static.transforms
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", calibration.frame_id)
    q, at = transform.rotation, transform.translation
    rotation = _matrix(q.x, q.y, q.z, q.w)
    K, D = np.reshape(calibration.K, (3, 3)), np.array(calibration.D)
    assert np.reshape(calibration.P, (3, 4))[:, :3] == pytest.approx(K)
    (drawn,) = viewer.messages["/camera/annotations"]
    project = cv2.fisheye.projectPoints if calibration.distortion_model == "kannala_brandt" else cv2.projectPoints
    for robot, outline in zip(config.robots, drawn.points, strict=True):
        tag = np.array([robot.start.x_m, robot.start.y_m, config.tracker.tag_height_m]) - (at.x, at.y, at.z)
        seen, _ = project((tag @ rotation).reshape(1, 1, 3), np.zeros(3), np.zeros(3), K, D)
        middle = np.mean([(point.x, point.y) for point in outline.points], axis=0) - 0.5
        assert np.hypot(*(seen.ravel() - middle)) < 0.2


def _matrix(x: float, y: float, z: float, w: float) -> np.ndarray:
    """Return the rotation of a quaternion, by its definition."""
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def test_a_lens_that_viewers_have_no_name_for_is_not_called_another_one(story: Make) -> None:
    config = story(f"camera.model.distortion={[0.01] * 12}").config
    viewer, _ = look(config)
    assert viewer.messages["/camera/calibration"] == []
    assert len(viewer.messages["/camera/annotations"]) == 1


def test_where_there_is_no_camera_nothing_of_one_is_told(story: Make) -> None:
    viewer = Viewer(story("tracker.source=truth").config).play(story("tracker.source=truth", ticks=5).recording())
    assert not [topic for topic in viewer.messages if "camera" in topic]
    assert "/tf_static" not in viewer.messages
