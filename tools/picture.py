"""Draws the README's picture: a camera image of a lockstep run, with its shapes, the trails and the references.

.venv/bin/python tools/picture.py [OUT.jpg] [SECONDS]
"""

import itertools
import sys
from pathlib import Path

from packages import needing

with needing("lab"):
    import cv2
    import numpy as np
    from numpy.typing import NDArray

    from robofleet.behaviours.interface import Line
    from robofleet.config.load import load_config
    from robofleet.config.tree import Config
    from robofleet.recording.run import Run
    from robofleet.runs.lockstep import Lockstep
    from robofleet.simulation.camera import SceneRenderer
    from robofleet.tracking.camera import CameraGeometry
    from robofleet.tracking.tags.targets import robot_targets

ROOT = Path(__file__).resolve().parents[1]
COLOURS = ((60, 200, 255), (120, 220, 90), (255, 160, 60), (230, 110, 230))  # BGR
PALE = (235, 235, 235)
TRAIL_S = 2.0
SHIFT = 4  # sub-pixel bits of OpenCV's drawing
Image = NDArray[np.uint8]


def line(image: Image, pixels: NDArray[np.float64], colour: tuple[int, int, int], width: int, *, closed: bool) -> None:
    """Draw a polyline through pixels (n, 2)."""
    points = np.round(pixels * (1 << SHIFT)).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(image, [points], closed, colour, width, cv2.LINE_AA, SHIFT)


def dot(image: Image, pixel: NDArray[np.float64], colour: tuple[int, int, int], radius: int, width: int = -1) -> None:
    """Draw a disc, or a ring of ``width``."""
    x, y = np.round(pixel * (1 << SHIFT)).astype(int).tolist()
    cv2.circle(image, (x, y), radius << SHIFT, colour, width, cv2.LINE_AA, SHIFT)


def floor(geometry: CameraGeometry, points: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
    """Pixels of points (n, 2) at a height."""
    return geometry.project(np.column_stack([points, np.full(len(points), height_m)]))


def draw(config: Config, run: Run, k: int) -> Image:
    """Render the camera's image at tick ``k`` and draw on it."""
    geometry, tracker = CameraGeometry.from_model(config.camera.model), config.tracker
    size = (config.camera.width, config.camera.height)
    members = [robot_targets(config)[config.robots.index(robot)] for robot in config.members]
    renderer = SceneRenderer(geometry, size, members, config.camera.noise_gray, np.random.default_rng(1))
    assert run.truth is not None
    image = np.dstack([renderer.render(run.truth[k])] * 3)
    for shape in (shape for group in run.groups for shape in group.shapes):
        pixels = floor(geometry, shape.points, tracker.tag_height_m)
        if isinstance(shape, Line):
            line(image, pixels, PALE, 1, closed=shape.closed)
        else:
            for pixel in pixels:
                dot(image, pixel, PALE, 4)
    references = np.concatenate([record.references[k] for record in run.group_figures])
    points = run.points()
    assert points is not None
    first = max(0, k - round(TRAIL_S / config.controller.tick_s))
    for row, (robot, colour) in enumerate(zip(config.members, itertools.cycle(COLOURS), strict=False)):
        trail = floor(geometry, points[first : k + 1, row], tracker.tag_height_m)
        line(image, trail, colour, 3, closed=False)
        dot(image, trail[-1], colour, 4)
        if np.isfinite(references[row]).all():
            dot(image, floor(geometry, references[row : row + 1], tracker.tag_height_m)[0], colour, 7, 2)
        centre = floor(geometry, run.truth[k][row : row + 1, :2], tracker.tag_height_m)[0]
        where = tuple(np.round(centre + np.array((-8, 40))).astype(int).tolist())
        cv2.putText(image, robot.id, where, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return image


def main() -> None:
    """Run, draw, write."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / ".github" / "run.jpg"
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
    config = load_config(ROOT / "configs" / "platoon.yaml", [f"run.duration_s={seconds}"])
    lockstep = Lockstep(config)
    lockstep.run()
    run = Run(lockstep.recording)
    cv2.imwrite(str(out), draw(config, run, len(run.t) - 1), [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main()
