"""How high a camera must hang over an arena, and how large tags look from there: the table of the laboratory's guide.

    python -m tools.measure.calibration.heights     (from the project's root)

The lens looks down on the arena's middle and is up to 2 degrees off, about each axis: then too the tags of robots at
the arena's edge, 8 cm up, and 5 cm more all around, are in the image. Images are 16:9, lenses without distortion.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from robofleet.config.calibrated import CameraModel, PoseSettings
from robofleet.tracking.camera import CameraGeometry

ARENAS = (2.0, 1.2), (3.2, 2.0), (3.5, 2.3), (5.0, 3.0)
ANGLES = 50, 60, 70, 80, 90  # of view, along the image's longer side [deg]
SIZE = 1280, 720
TAG_M, TAG_HEIGHT_M, RIM_M, TILT_DEG = 0.07, 0.08, 0.05, 2.0


def lens(angle_deg: float, height_m: float, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> CameraGeometry:
    """Return a camera that looks down, its image's right along the world's x, but for a tilt about its own axes."""
    focal = SIZE[0] / 2 / math.tan(math.radians(angle_deg) / 2)
    model = CameraModel(
        width=SIZE[0], height=SIZE[1], focal_px=(focal, focal), distortion=(),
        centre_px=((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2),
        T_world_camera=PoseSettings(position_m=(0.0, 0.0, height_m), rotation_rad=(math.pi, 0.0, 0.0)),
    )  # fmt: skip
    geometry = CameraGeometry.from_model(model)
    T = geometry.T_world_camera.copy()
    a, b = np.radians(tilt_deg)
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    T[:3, :3] = T[:3, :3] @ about_x @ about_y
    return geometry.moved(T)


def sees(camera: CameraGeometry, arena_m: tuple[float, float]) -> bool:
    half = np.array(arena_m) / 2 + RIM_M
    corners = np.array([(x, y, TAG_HEIGHT_M) for x, y in itertools.product((-half[0], half[0]), (-half[1], half[1]))])
    pixels = camera.project(corners)
    return bool(((pixels > -0.5) & (pixels < np.array(SIZE) - 0.5)).all())


def lowest(angle_deg: float, arena_m: tuple[float, float]) -> float:
    """Return the least height of the lens above the floor [m]."""
    tilts = [(a, b) for a in (-TILT_DEG, TILT_DEG) for b in (-TILT_DEG, TILT_DEG)]
    too_low, enough = TAG_HEIGHT_M + 0.1, 100.0
    while enough - too_low > 1e-3:
        height = (too_low + enough) / 2
        if all(sees(lens(angle_deg, height, tilt), arena_m) for tilt in tilts):
            enough = height
        else:
            too_low = height
    return enough


def side_px(camera: CameraGeometry) -> float:
    """Return how long the side of a tag is in the image's middle [px]."""
    ends: NDArray[np.float64] = camera.project(np.array([(s * TAG_M / 2, 0.0, TAG_HEIGHT_M) for s in (-1, 1)]))
    return float(math.dist(*ends))


def main() -> None:
    """Print the table: lowest height, and pixels a tag's side at 1280 x 720 and at 1920 x 1080."""
    print("| angle of view |", " | ".join(f"{x:g} x {y:g} m" for x, y in ARENAS), "|")
    print("|---" * (len(ARENAS) + 1) + "|")
    for angle in ANGLES:
        heights = [lowest(angle, arena) for arena in ARENAS]
        sides = [side_px(lens(angle, height)) for height in heights]
        pairs = zip(heights, sides, strict=True)
        cells = (f"{height:.1f} m, {side:.0f} / {1.5 * side:.0f} px" for height, side in pairs)
        print(f"| {angle}° |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
