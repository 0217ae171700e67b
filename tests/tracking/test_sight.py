"""What is published of the robots while a camera is knocked: rendered images, true poses known."""

import math

import numpy as np
import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import S
from robofleet.simulation.scene import ScenePlay, scene_renderer
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.sight import FleetSight
from robofleet.tracking.tags.tracker import Sightings
from tests.shipped import PLATOON
from tools.measure.tracking.vibration import Motion, configuration, evaluate

PERIOD_S = 0.033
KNOCKED = 15  # the first image after it
CORNERS = [(-1.45, -0.85), (1.45, -0.85), (1.45, 0.85), (-1.45, 0.85)]
STANDING = np.array([(-0.6, 0.3, 0.4), (0.5, -0.3, 2.0), (0.7, 0.4, -1.0), (-0.4, -0.4, 0.1)])


def looked_at(tilt_deg: float, knocked_s: float, images: int, hidden: range, begin_s: float) -> list[Sightings]:
    """Return what is seen of robots that stand, of which no image places one wrongly, as the camera is knocked."""
    floor_tags = [{"tag": 100 + i, "side_m": 0.1, "x_m": x, "y_m": y} for i, (x, y) in enumerate(CORNERS)]
    knocks = [{"at_s": knocked_s, "rotation_deg": [tilt_deg, 0.0, 0.0]}]
    changes = [f"tracker.floor_tags={floor_tags}", f"camera.simulated.knocks={knocks}"]
    config = load_config(PLATOON, changes)
    renderer, play, sight = scene_renderer(config, np.random.default_rng(3)), ScenePlay(config), FleetSight(config)
    truth, looks = {robot.tag: row for robot, row in zip(config.robots, STANDING, strict=True)}, []
    for k in range(images):
        geometry = play.camera(k * PERIOD_S)
        if geometry is not None:
            renderer.moved(geometry)
        image = renderer.render(STANDING)
        looks.append(sight.see(np.full_like(image, 120) if k in hidden else image, round((begin_s + k * PERIOD_S) * S)))
        for robot in looks[-1].poses:
            assert robot.coasted_ns or math.dist((robot.x, robot.y), truth[robot.tag][:2]) < 1e-3, k
    return looks


def measured(looks: list[Sightings]) -> int:
    return sum(robot.coasted_ns == 0 for look in looks for robot in look.poses)


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [pytest.param(0.2, marks=pytest.mark.long), 0.8])
def test_no_robot_is_measured_in_the_wrong_place_while_a_knock_is_corrected(tilt_deg: float) -> None:
    looks = looked_at(tilt_deg, (KNOCKED - 0.5) * PERIOD_S, 2 * KNOCKED, range(0), 0.0)
    assert TrackerEvent.CAMERA_CORRECTED in {event for look in looks for event, _, _ in look.happenings}
    assert measured(looks[KNOCKED + 1 :]) > 0.7 * KNOCKED * len(STANDING)


@pytest.mark.slow
def test_robots_that_are_found_with_floor_tags_are_not_placed_by_a_camera_that_was_knocked_meanwhile() -> None:
    looks = looked_at(0.08, 1.0, 60, range(25, 45), 1.0)  # nothing is seen for longer than tags are predicted
    assert measured(looks[45:]) > 10 * len(STANDING)


@pytest.mark.slow
def test_a_camera_that_sees_no_floor_tag_goes_on_where_another_one_sees_some() -> None:
    floor_tags = [{"tag": 100 + i, "side_m": 0.1, "x_m": -2.0 + i, "y_m": 0.8} for i in range(2)]
    right = load_config(SHIPPED / "two-cameras.yaml", [f"tracker.floor_tags={floor_tags}"]).views[1]
    poses = np.array([(0.9 + 0.2 * i, 0.3 * (-1) ** i, 0.5 * i) for i in range(len(right.robots))])
    sight, image = FleetSight(right), scene_renderer(right, np.random.default_rng(3)).render(poses)
    for k in range(15):
        robots = sight.see(image, round((1.0 + k * PERIOD_S) * 1e9)).poses
    assert sum(robot.coasted_ns == 0 for robot in robots) == len(poses)


@pytest.mark.slow
def test_a_camera_that_vibrates_measures_all_robots_in_every_image() -> None:
    rows = evaluate({"floor tags": configuration(floor_tags=True)}, Motion((0.05, 0.0, 0.0)), 30)
    assert rows["floor tags"]["without"] == 0
    assert rows["floor tags"]["measured"] == 1.0
    assert rows["floor tags"]["rms_mm"] < 0.25  # without a correction: 1.5
