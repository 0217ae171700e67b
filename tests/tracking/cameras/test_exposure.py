"""The loop that holds white paper: for any sensor, within its limits, slowly, and at rest when it is done."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.config.load import ConfigError, load_config
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.cameras.exposure import (
    SATURATED,
    ExposureController,
    bounded,
    exposure_controller,
    longest_exposure,
)
from robofleet.tracking.cameras.light import Light, TagLight
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.sources import CameraError, Exposure, ExposureLimits
from robofleet.tracking.tags.targets import Target, robot_targets
from robofleet.tracking.tags.tracker import TagSighting
from tests.shipped import PLATOON

AIM = 200.0
LIMITS = ExposureLimits(Exposure(1e-4, 0.0), Exposure(0.014, 24.0), Exposure(0.0, 0.0), 1.0)
Sensor = Callable[[Exposure], float]  # grey of white paper


def seen(white: float, tags: int = 4) -> Light:
    """Return an image with so bright paper; print is black to a seventh of it."""
    return Light(white, 0.86 * white, 0.86 * white, tags)


class Lab:
    """A controller, and a camera that takes over what it is told a few images later."""

    def __init__(self, sensor: Sensor, limits: ExposureLimits = LIMITS, *, late: int = 2) -> None:
        self.controller, self.sensor, self.late = ExposureController(AIM, limits), sensor, late
        self.exposures = [Exposure(0.004, 0.0)]  # of all images
        self._pending: list[tuple[int, Exposure]] = []

    def image(self, tags: int = 4) -> float:
        """Let one image be looked at; return its white."""
        now = self.exposures[-1]
        if self._pending and self._pending[0][0] <= len(self.exposures):
            now = self._pending.pop(0)[1]
        self.exposures.append(now)
        white = min(255.0, round(self.sensor(now)))
        if (new := self.controller.look(seen(white, tags), now)) is not None:
            self._pending = [(len(self.exposures) + self.late, new)]
        return white

    def run(self, images: int) -> list[float]:
        return [self.image() for _ in range(images)]


def responding(full: float, gamma: float = 1.0, gain_db: float = 1.0) -> Sensor:
    """Return a sensor that shows white paper at ``full`` when it exposes for 4 ms without gain."""
    return lambda e: full * (e.time_s / 0.004 * 10.0 ** (e.gain * gain_db / 20.0)) ** gamma


@pytest.mark.slow
@given(
    full=st.floats(12.0, 5000.0),
    gamma=st.floats(0.4, 1.4),
    gain_db=st.floats(0.3, 4.0),
    late=st.integers(1, 6),
    step_s=st.sampled_from([0.0, 1e-5, 1e-4]),
)
@settings(deadline=None, derandomize=True, max_examples=60)
def test_it_reaches_the_band_for_any_sensor_and_then_rests(
    full: float, gamma: float, gain_db: float, late: int, step_s: float
) -> None:
    lab = Lab(responding(full, gamma, gain_db), LIMITS._replace(step=Exposure(step_s, 0.1)), late=late)
    lab.run(1500)
    before = len(lab.exposures)
    whites = lab.run(300)
    assert len(set(lab.exposures[before:])) == 1, "no limit cycle"
    end = lab.exposures[-1]
    if end not in (Exposure(1e-4, 0.0), Exposure(0.014, 24.0)):
        assert max(whites) <= 1.1 * AIM
        coarse = (end.time_s + step_s) / end.time_s if end.time_s < 0.014 else 1.0
        assert min(whites) >= 0.75 * AIM / coarse**gamma - 1.0
    else:
        assert (max(whites) < 0.75 * AIM) == (end.gain > 0.0)


@given(st.lists(st.floats(5.0, 2000.0), min_size=3, max_size=12), st.integers(1, 6), st.booleans())
@settings(deadline=None, derandomize=True, max_examples=40)
def test_whatever_the_light_does_it_stays_within_its_limits_and_is_slow(
    fulls: list[float], late: int, webcam: bool
) -> None:
    step = Exposure(1e-4, 1.0) if webcam else Exposure(0.0, 0.0)
    lab = Lab(lambda _: 0.0, LIMITS._replace(step=step), late=late)
    for full in fulls:
        lab.sensor = responding(full)
        lab.run(60)
    for old, new in pairwise(lab.exposures):
        assert 1e-4 <= new.time_s <= 0.014, "blur budget"
        assert 0.0 <= new.gain <= 24.0
        assert new.gain == 0.0 or old.gain == 0.0 or new.time_s == old.time_s, "gain only beyond the longest exposure"
        up, down = old.time_s * 1.0501, old.time_s * 0.799
        assert down - step.time_s - 1e-9 <= new.time_s <= max(up, old.time_s + step.time_s) + 1e-9
        assert -1.95 - step.gain <= new.gain - old.gain <= max(0.43, step.gain) + 1e-9
    changes = [k for k, (old, new) in enumerate(pairwise(lab.exposures)) if old != new]
    assert all(b - a > 6 for a, b in pairwise(changes)), "no change before the one before has taken effect"


def test_saturation_is_left_faster_than_darkness() -> None:
    bright, dark = Lab(responding(1000.0)), Lab(responding(40.0))
    assert max(bright.run(150)[-10:]) < SATURATED
    assert max(dark.run(150)[-10:]) < 0.75 * AIM
    assert dark.run(400)[-1] >= 0.9 * AIM


def test_lamps_that_flicker_do_not_move_it() -> None:
    lab = Lab(responding(210.0))
    phase = iter(range(10**6))

    def flickering(exposure: Exposure) -> float:
        return responding(170.0 + 40.0 * math.cos(2.0 * math.pi * 0.3 * next(phase)))(exposure)

    lab.sensor = flickering
    lab.run(400)
    assert len(set(lab.exposures)) == 1
    steady = Lab(responding(130.0))
    steady.run(400)
    assert len(set(steady.exposures)) > 1, "as dark as its darkest images"


def test_tags_that_are_hidden_for_a_moment_change_nothing_and_for_long_the_image_tells() -> None:
    lab = Lab(responding(200.0))
    lab.run(20)
    lab.sensor = responding(40.0)
    for _ in range(25):
        lab.image(tags=0)
    assert len(set(lab.exposures)) == 1
    for _ in range(60):
        lab.image(tags=0)
    assert lab.exposures[-1].time_s > 0.004


def test_faint_tags_are_not_given_up_for_a_bright_one() -> None:
    controller = ExposureController(AIM, LIMITS)
    looks = [controller.look(Light(255.0, 200.0, 38.0, 2), Exposure(0.004, 0.0)) for _ in range(30)]
    assert looks == [None] * 30
    ((event, _, white),) = controller.news()
    assert (event, white) == (TrackerEvent.CAMERA_TOO_BRIGHT, 255.0)


@pytest.mark.parametrize(
    ("full", "event"), [(50_000.0, TrackerEvent.CAMERA_TOO_BRIGHT), (0.4, TrackerEvent.CAMERA_TOO_DARK)]
)
def test_light_beyond_the_limits_is_an_event_and_so_is_its_end(full: float, event: TrackerEvent) -> None:
    lab = Lab(responding(full))
    lab.run(3000)
    ((begun, _, value),) = lab.controller.news()
    assert begun is event
    assert value == (255.0 if event is TrackerEvent.CAMERA_TOO_BRIGHT else pytest.approx(0.86 * 22.0, abs=1.0))
    lab.sensor = responding(200.0)
    lab.run(3000)
    (end,) = lab.controller.news()
    assert end.event is TrackerEvent.CAMERA_LIGHT_GOOD
    assert 0.75 * AIM <= lab.run(1)[0] <= 1.1 * AIM


def test_a_camera_that_was_opened_again_is_led_from_where_it_is() -> None:
    lab = Lab(responding(60.0))
    lab.run(400)
    assert lab.exposures[-1].time_s > 0.01
    lab.exposures.append(Exposure(0.004, 0.0))
    lab.run(400)
    assert lab.run(1)[0] >= 0.9 * AIM


def test_a_first_exposure_beyond_the_limits_is_brought_within_them() -> None:
    controller = ExposureController(AIM, LIMITS._replace(shortest=Exposure(1e-4, 3.0)))
    exposures = [controller.look(seen(200.0), Exposure(0.02, 1.0)) for _ in range(8)]
    assert [exposure for exposure in exposures if exposure is not None] == [Exposure(0.014, 3.0)]


# Its limits


def test_the_longest_exposure_keeps_the_fastest_robot_within_its_blur() -> None:
    config = load_config(PLATOON, ["camera.exposure.blur_px=0.5"])
    target = robot_targets(config)[0]
    eye = CameraGeometry.from_model(config.camera.model)
    fastest = max(robot.vehicle.max_speed_m_s for robot in config.robots)
    exposed_s = longest_exposure(config).time_s
    ends = np.array([[0.0, 0.0, target.height], [fastest * exposed_s, 0.0, target.height]])
    assert math.dist(*eye.project(ends)) == pytest.approx(0.5, rel=0.03)


def test_the_longest_exposure_leaves_time_for_the_readout() -> None:
    wide = "camera.exposure.blur_px=10"
    config = load_config(PLATOON, [wide])
    assert longest_exposure(config).time_s == pytest.approx(2 * (0.018 - 0.004))
    assert longest_exposure(load_config(PLATOON, [wide, "camera.trigger_lead_s=0.03"])).time_s == pytest.approx(0.029)


@pytest.mark.parametrize(
    ("overrides", "camera", "says"),
    [
        (["camera.exposure.gain=[30, 40]"], LIMITS, "camera.exposure.gain: the camera has 0 to 24"),
        ([], LIMITS._replace(shortest=Exposure(0.02, 0.0)), "camera.exposure_control: the camera exposes for 0.02 s"),
        ([], None, "cannot be adjusted: set it to fixed"),
    ],
)
def test_limits_that_leave_nothing_are_refused(overrides: list[str], camera: ExposureLimits | None, says: str) -> None:
    with pytest.raises(CameraError, match=says):
        exposure_controller(load_config(PLATOON, overrides), camera)


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("camera.exposure.gain=[6, 0]", "the least gain, 6, is above the greatest, 0"),
        ("camera.simulated.daylight=[{at_s: 5, light: 1}, {at_s: 5, light: 2}]", "5 s does not come after 5 s"),
    ],
)
def test_settings_that_exclude_each_other_are_refused_in_one_line(override: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as error:
        load_config(PLATOON, [override])
    assert len(str(error.value).splitlines()) == 1


def test_limits_are_the_cameras_and_the_configurations() -> None:
    config = load_config(PLATOON, ["camera.exposure.gain=[1, 6]"])
    limits = bounded(config, LIMITS._replace(longest=Exposure(1.0, 24.0), step=Exposure(1e-4, 0.0)))
    assert (limits.shortest, limits.longest.gain) == (Exposure(1e-4, 1.0), 6.0)
    assert longest_exposure(config).time_s - 1e-4 < limits.longest.time_s <= longest_exposure(config).time_s


# The light that it goes by


def grays(*patches: tuple[float, float]) -> tuple[np.ndarray, list[TagSighting], TagLight, CameraGeometry]:
    """Return an image with tags of these black and white greys."""
    config = load_config(PLATOON)
    eye = CameraGeometry.from_model(config.camera.model)
    targets = [Target(k, 0.07, 0.08, 0.0) for k in range(len(patches))]
    renderer = SceneRenderer(eye, (1280, 720), targets, 0.0, np.random.default_rng(1))
    places = [TagSighting(k, 0.3 * k - 0.3, 0.2 * k, 0.4 + k, 0, 0) for k in range(len(patches))]
    image = renderer.render(np.array([(tag.x, tag.y, tag.psi) for tag in places])).astype(float)
    for (black, white), tag in zip(patches, places, strict=True):
        u, v = np.rint(eye.project(np.array([[tag.x, tag.y, 0.08]]))[0]).astype(int)
        part = image[v - 25 : v + 26, u - 25 : u + 26]
        low, high = part.min(), np.percentile(part, 95)
        part[:] = np.clip(black + (part - low) / (high - low) * (white - black), 0, 255)
    return image.astype(np.uint8), places, TagLight(targets), eye


def test_white_is_that_of_the_brightest_tag_without_a_lamps_reflection() -> None:
    image, places, light, eye = grays((20, 120), (30, 180), (200, 250))
    found = light.of(image, eye, places)
    assert found.white == pytest.approx(180, rel=0.06)
    assert found.clearest == pytest.approx(150, rel=0.1)
    assert found.faintest == pytest.approx(100, rel=0.1)
    assert light.of(image, eye, places[2:]).white == pytest.approx(250, rel=0.06), "there is no other"


def test_without_tags_the_images_light_greys_count() -> None:
    image, _, light, eye = grays((20, 120))
    found = light.of(np.full_like(image, 90), eye, [])
    assert found == Light(90.0, 90.0, 90.0, 0)
