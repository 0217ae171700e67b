"""Prints that are stretched, bowed, tilted, or of another size: each is learnt apart from the others, and named."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.prints import PrintMonitor
from robofleet.tracking.tags.shape import BOW, STRETCH, TILT, Shapes
from robofleet.tracking.tags.targets import Target
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import Print, RayCaster, clutter

SIDE, HEIGHT, CAMERA_HEIGHT = 0.07, 0.08, 2.5
IMAGES = 30


class Learnt(NamedTuple):
    """What 30 images of one tag, at many headings, teach."""

    shapes: Shapes
    late_deg: float  # rms of the last headings' errors

    def named(self, side_tolerance: float = 5e-5) -> dict[TrackerEvent, float]:
        """Return what is named."""
        target = Target(7, SIDE, HEIGHT, 0.3, side_tolerance=side_tolerance)
        return dict(PrintMonitor(self.shapes, [target], CAMERA_HEIGHT).news(0))


def learnt(higher: float = 0.0, **of_print: Any) -> Learnt:
    """See a tag of 24 pixels from aside, under slopes of 0.3 to 0.7."""
    rng = np.random.default_rng(1)
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = CAMERA_HEIGHT
    K = np.array([[830.0, 0.0, -250.0], [0.0, 830.0, 150.0], [0.0, 0.0, 1.0]])
    eye = RayCamera((400, 300), K, np.zeros(5), T, False, 0.004, 0.0, 0.7)
    caster = RayCaster(eye, clutter(eye.size, rng), rng)
    geometry = CameraGeometry(eye.K, eye.distortion, eye.T_world_camera)
    fit, off = PhotometricFit(geometry, [Target(7, SIDE, HEIGHT, 0.3)]), []
    for k in range(IMAGES):
        (x, y), psi = rng.uniform([0.95, -0.3], [1.65, 0.3]).tolist(), 2.4 * k
        image = caster.image([Print(7, SIDE, HEIGHT + higher, (x, y, psi), **of_print)], 0.7, 2.0)
        seen = np.array([complex(x, y) * (1.0 + higher / (CAMERA_HEIGHT - HEIGHT - higher))])
        found = fit.fit(image, np.zeros(1, np.int64), seen, np.array([psi]), studied=0)
        off.append(math.degrees(found.psi[0] - psi))
    return Learnt(fit.shapes, math.sqrt(np.square(off[-15:]).mean()))


@pytest.mark.slow
def test_a_flat_level_print_of_its_size_has_no_news() -> None:
    flat = learnt()
    assert not flat.named()
    assert np.abs(flat.shapes.values[0] / np.sqrt(np.diag(flat.shapes.spreads[0]))).max() < 4.0
    assert flat.late_deg < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [(0.003, 0.0), (0.0, 0.01)])
def test_a_stretched_print_is_not_taken_for_a_tilt(stretch: tuple[float, float]) -> None:
    found = learnt(stretch=stretch)
    assert np.abs(np.degrees(found.shapes.values[0, TILT : TILT + 2])).max() < 0.1
    assert found.late_deg < 0.03
    assert found.named() == {TrackerEvent.PRINT_STRETCHED: pytest.approx(stretch[0] - stretch[1], rel=0.1)}


def test_tilt_stretch_and_bow_are_told_apart() -> None:
    found = learnt(tilt=(0.05, -0.03), stretch=(0.005, 0.0), bow=-0.001)
    values = found.shapes.values[0]
    assert values[TILT : TILT + 2] == pytest.approx([0.05, -0.03], abs=0.003)
    assert values[STRETCH] == pytest.approx(0.0025, rel=0.1)
    assert SIDE * values[BOW : BOW + 2] / 4.0 == pytest.approx([0.001, 0.0], abs=1e-4)
    assert found.late_deg < 0.03
    assert found.named()[TrackerEvent.TAG_BOWED] == pytest.approx(0.001, rel=0.1)


def test_a_tag_that_is_higher_is_named_beyond_the_tolerance_of_its_side() -> None:
    found = learnt(higher=0.003)
    assert found.named()[TrackerEvent.TAG_SIZE] == pytest.approx(0.003, abs=6e-4)
    assert TrackerEvent.TAG_SIZE not in found.named(side_tolerance=2e-4)


def test_what_is_off_is_named_once_and_again_where_it_changes_or_is_learnt_anew() -> None:
    shapes = Shapes.unknown(1)
    monitor = PrintMonitor(shapes, [Target(7, SIDE, HEIGHT, 0.3)], CAMERA_HEIGHT)
    shapes.values[0, STRETCH] = 0.004
    assert not list(monitor.news(0)), "it is not certain yet"
    shapes.spreads[0] *= 1e-4
    assert dict(monitor.news(0)) == {TrackerEvent.PRINT_STRETCHED: pytest.approx(0.008)}
    assert not list(monitor.news(0))
    shapes.values[0, STRETCH] = -0.002
    assert dict(monitor.news(0)) == {TrackerEvent.PRINT_STRETCHED: pytest.approx(-0.004)}
    monitor.forget(0)
    assert len(list(monitor.news(0))) == 1
    shapes.forget(0)
    assert not list(monitor.news(0))
