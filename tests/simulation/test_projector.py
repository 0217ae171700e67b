"""The light of simulated projectors in a simulated camera's images."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from robofleet.behaviours import described
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TICK
from robofleet.bus.messages import TICK_RECORD, RobotTick, TickRecord
from robofleet.config.calibrated import FloorTag
from robofleet.config.groups import descriptions
from robofleet.config.load import load_config, spelled
from robofleet.config.tree import Config
from robofleet.core.clock import MS, SimulatedClock
from robofleet.projection.model import Projector
from robofleet.simulation.projector import Projection
from robofleet.simulation.scene import scene_renderer
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraContext
from tests.projection.projectors import SIZE, on_floor, tilted
from tests.shipped import OVERHEAD, PLATOON

DELAY_S = 0.05
TRUTH = tilted()
MIDDLE = np.array([480.0, 270.0])


def config(
    truth: Projector = TRUTH, tag_height_m: float = 0.08, changes: Sequence[str] = (), **simulated: Any
) -> Config:
    """The shipped arena under a projector, seen by a camera of half the shipped one's pixels."""
    half = {name: tuple(value / 2.0 for value in getattr(OVERHEAD, name)) for name in ("focal_px", "centre_px")}
    camera = OVERHEAD.model_copy(update=half | {"width": 640, "height": 360}).model_dump(mode="json")
    model = truth.model.model_copy(update={"delay_s": DELAY_S}).model_dump(mode="json")
    own = {"name": "main", "width": SIZE[0], "height": SIZE[1], "simulated": {"model": model, **simulated}}
    usual = [
        "tracker.source=truth", "camera.trigger=free", "camera.noise_gray=0", "camera.width=640", "camera.height=360",
        f"camera.model={spelled(camera)}", f"projectors={spelled([own])}", f"tracker.tag_height_m={tag_height_m}",
    ]  # fmt: skip
    return load_config(PLATOON, [*usual, *changes])


def disc(at: np.ndarray, gray: int = 255) -> np.ndarray:
    picture = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(picture, tuple(np.rint(at).astype(int).tolist()), 12, gray, -1)
    return picture


def images(whole: Config, *pictures: np.ndarray, poses: np.ndarray | None = None) -> list[np.ndarray]:
    """What the camera sees without light, and of each picture."""
    renderer, projection = (
        scene_renderer(whole, np.random.default_rng(1)),
        Projection(whole, MemoryBus("", SimulatedClock(), 0)),
    )
    robots = np.full((len(whole.seen), 3), np.nan) if poses is None else poses
    seen = [renderer.render(robots).astype(float)]
    for k, picture in enumerate(pictures):
        projection.projectors["main"].show(picture, k * 1000 * MS)
        projection.fall_on(renderer, (k * 1000 + 500) * MS, 1.0, moved=False)
        seen.append(renderer.render(robots).astype(float))
    return seen


@pytest.mark.slow_after_first
@pytest.mark.parametrize("pixel", [(120.0, 80.0), (480.0, 270.0), (850.0, 430.0)])
def test_light_falls_where_the_projector_sends_it(pixel: tuple[float, float]) -> None:
    whole = config()
    dark, lit = images(whole, disc(np.array(pixel)))
    added = np.maximum(lit - dark - 3.0, 0.0)  # without what black adds
    v, u = np.mgrid[: added.shape[0], : added.shape[1]]
    centre = np.array([[(u * added).sum(), (v * added).sum()]]) / added.sum()
    seen = CameraGeometry.from_model(whole.camera.model).to_plane(centre, 0.0)
    assert seen == pytest.approx(TRUTH.floor(np.array([pixel])), abs=4e-3)  # of a pixel's 6 mm on a floor of spots


@pytest.mark.slow
def test_a_tag_is_lit_by_the_light_at_its_height() -> None:
    """Not by that which falls on the floor that it hides from the camera."""
    truth = tilted(-1.0)
    whole = config(truth, tag_height_m=0.3)
    tag = np.array([[0.5, 0.3, 0.3]])
    poses = np.full((len(whole.seen), 3), np.nan)
    poses[0] = 0.5, 0.3, 0.0
    camera = CameraGeometry.from_model(whole.camera.model)
    at = camera.project(tag)
    hidden = truth.pixels(on_floor(camera.to_plane(at, 0.0)))[0]
    assert np.linalg.norm(hidden - truth.pixels(tag)[0]) > 15.0
    u, v = np.rint(at[0]).astype(int)
    around = slice(v - 1, v + 2), slice(u - 1, u + 2)
    dark, lit, beside = images(whole, disc(truth.pixels(tag)[0]), disc(hidden), poses=poses)
    assert (lit - dark)[around].mean() > 5.0 * max((beside - dark)[around].mean(), 1.0)


def test_light_adds_up_and_grows_with_the_greys_power() -> None:
    """Half of the greys is 0.22 of the light, for gamma 2.2; black is not dark."""
    whole = config(gamma=2.2, black=0.05, brightness=0.2)
    flat = np.full(SIZE[::-1], 255, np.uint8)
    dark, white, half, black = (image[120:240, 200:440].mean() for image in images(whole, flat, flat // 2, flat * 0))
    assert (half - dark) / (white - dark) == pytest.approx(0.05 + 0.95 * (127 / 255) ** 2.2, abs=0.01)
    assert (black - dark) / (white - dark) == pytest.approx(0.05, abs=0.01)


@pytest.mark.slow
def test_what_changes_in_a_picture_is_all_that_changes_in_the_image() -> None:
    """An image of the last of several pictures is one of that picture alone; also on a floor tag that was lit."""
    floor_tags = (FloorTag(tag=40, side_m=0.2, x_m=0.0, y_m=-0.1, heading_deg=20.0),)
    whole = config()
    whole = whole.model_copy(update={"tracker": whole.tracker.model_copy(update={"floor_tags": floor_tags})})
    steps = np.array([[12.0 * k - 100.0, 3.0 * k] for k in range(18)])  # more than the renderer has images
    pictures = [disc(MIDDLE + step, 255 if k % 2 else 90) for k, step in enumerate(steps)]
    *_, last = images(whole, *pictures)
    _, alone = images(whole, pictures[-1])
    assert np.array_equal(last, alone)


@pytest.mark.slow
def test_where_two_projectors_light_the_floor_it_is_as_bright_as_where_one_does(tmp_path: Path) -> None:
    """Within 5 %, in the pixels of a camera, while both show a white image of a run."""
    cv2.imwrite(str(tmp_path / "white.png"), np.full((2, 3), 255, np.uint8))
    pair = []
    for name, truth in (("left", tilted(-1.4)), ("right", tilted(1.4, -3.0))):
        model = truth.model.model_dump(mode="json")
        own = {"name": name, "width": SIZE[0], "height": SIZE[1], "calibration": model, "simulated": {"model": model}}
        pair.append(own)
    shown = {"show": ["background"], "background": str(tmp_path / "white.png")}
    whole = config(changes=[f"projectors={spelled(pair)}", f"projection={spelled(shown)}"])
    clock = SimulatedClock()
    bus = MemoryBus(whole.arena.name, clock, 0)
    renderer, projection = scene_renderer(whole, np.random.default_rng(1)), Projection(whole, bus)
    robots = tuple(RobotTick(x, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0) for x in (-1.5, -1.3, 1.3, 1.5))
    figures = (np.nan,) * described.size(descriptions(whole))
    head = 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
    bus.publisher(TICK)(TICK_RECORD.encode(TickRecord(*head, robots, figures)))
    projection.fall_on(renderer, 100 * MS, 1.0, moved=False)
    light = projection.light[0]
    floor_x, floor_y, _ = renderer.planes()[0]
    points = on_floor(np.column_stack([floor_x.ravel(), floor_y.ravel()]).astype(float))
    lit = np.array([each.projector.lights(points).reshape(light.shape) for each in projection.projectors.values()])
    inside = (np.abs(floor_x) < 1.1) & (
        np.abs(floor_y) < 0.75
    )  # discs, and the outer edges of both pictures, lie outside
    assert (both := inside & lit.all(axis=0)).mean() > 0.1
    usual = np.median(light[inside & (lit.sum(axis=0) == 1)])
    assert np.abs(light[both] / usual - 1.0).max() < 0.05


class Skipping(SimulatedClock):
    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        self.advance_to(max(instant_ns, self.now_ns()))


@pytest.mark.slow
def test_light_comes_after_the_projectors_own_delay() -> None:
    clock = Skipping()
    camera = SimulatedCamera(CameraContext.without_run(config(), clock))
    camera.read()
    before = camera.read().image.mean()
    shown_ns = clock.now_ns()
    camera.project("main", np.full(SIZE[::-1], 255, np.uint8))
    while (frame := camera.read()).image.mean() < before + 5.0:
        assert frame.exposure_ns < shown_ns + DELAY_S * 1e9
    assert frame.exposure_ns >= shown_ns + DELAY_S * 1e9


@pytest.mark.slow
def test_a_projector_that_shows_nothing_changes_no_image() -> None:
    pair = config(), config().model_copy(update={"projectors": ()})
    cameras = [SimulatedCamera(CameraContext.without_run(each, Skipping())) for each in pair]
    assert np.array_equal(*(camera.read().image for camera in cameras))


def test_the_truth_is_a_projector() -> None:
    (own,) = config().projectors
    assert own.simulated is not None
    again = Projector.from_model(own.simulated.model)
    assert again.floor(MIDDLE[None]) == pytest.approx(TRUTH.floor(MIDDLE[None]), abs=1e-9)
