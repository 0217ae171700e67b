"""How well the camera's place is found from eight surveyed floor tags, over many surveys and camera poses.

    python -m tools.measure.calibration.camera_pose [--seeds N]     (from the project's root)

Errors are those of a robot's tag, 80 mm up, anywhere in the arena: points that took no part in the calibration. Tags
lie around the arena's rim; their survey is 0.5 mm wrong (standard deviation a coordinate), their pixels 0.02 px.
"""

import math
from pathlib import Path

import numpy as np
import yaml

from robofleet.calibration.extrinsics.consensus import agree
from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.placing import Lens, moved
from robofleet.config.calibrated import CameraModel
from robofleet.tracking.camera import CameraGeometry
from tools.measure.program import program

ROOT = Path(__file__).parents[3]
SURVEY_M, PIXELS, HEIGHT_M, ARM_M = 5e-4, 0.02, 0.08, 0.05
RIM = np.array([(-1.5, -0.9), (-1.5, 0.9), (1.5, -0.9), (1.5, 0.9), (0, 0.9), (0, -0.9), (-1.5, 0), (1.5, 0)])


def row(title: str, seeds: int, wrong_m: float = 0.0) -> str:
    """Return a line of the table; ``wrong_m``: how far one tag's survey is off besides."""
    model = CameraModel.model_validate(yaml.safe_load((ROOT / "configs/cameras/overhead.yaml").read_text()))
    nominal = CameraGeometry.from_model(model)
    x, y = np.meshgrid(np.linspace(-1.6, 1.6, 17), np.linspace(-1.0, 1.0, 11))
    grid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, HEIGHT_M)])
    n, squared, predicted, named, blamed = len(RIM), [], [], 0, 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        true = nominal.moved(moved(nominal.T_world_camera, rng.normal(0.0, [0.05] * 3 + [0.1] * 3)))
        lying, psi = np.column_stack([RIM, np.zeros(n)]), rng.uniform(-3.0, 3.0, n)
        ahead = lying + ARM_M * np.column_stack([np.cos(psi), np.sin(psi), np.zeros(n)])
        centres, ends = (true.project(points) + rng.normal(0.0, PIXELS, (n, 2)) for points in (lying, ahead))
        survey = lying + np.column_stack([rng.normal(0.0, SURVEY_M, (n, 2)), np.zeros(n)])
        culprit, way = int(rng.integers(n)), rng.uniform(-math.pi, math.pi)
        survey[culprit, :2] += wrong_m * np.array([math.cos(way), math.sin(way)])
        names = tuple(map(str, range(n)))
        headings, arms = psi + rng.normal(0.0, 0.01, n), np.full(n, 2.0 * ARM_M)
        marks = Marks(names, survey, headings, arms, centres, ends, np.full(n, PIXELS))
        found = agree(Lens(nominal, (model.width, model.height), np.zeros((0, 0))), marks, None)
        out = np.flatnonzero(~found.inside).tolist()
        named += wrong_m > 0.0 and culprit in out
        blamed += len([k for k in out if not (wrong_m and k == culprit)])
        error = found.placement.geometry.to_plane(true.project(grid), HEIGHT_M) - grid[:, :2]
        squared.append((error**2).sum(1).mean())
        predicted.append(np.trace(found.placement.spread(grid), axis1=1, axis2=2).mean())
    actual, expected = (1e3 * math.sqrt(float(np.mean(values))) for values in (squared, predicted))
    return f"{title:<34}{actual:>9.3f}{expected:>11.3f}{f'{named} of {seeds}' if wrong_m else '-':>14}{blamed:>9}"


def main() -> None:
    seeds = program(__doc__, seeds=300).parse_args().seeds
    print(f"{'eight tags, surveyed to 0.5 mm':<34}{'mm rms':>9}{'predicted':>11}{'culprit named':>14}{'blamed':>9}")
    print(row("all right", seeds))
    print(row("one 20 mm wrong", seeds, 0.02))


if __name__ == "__main__":
    main()
