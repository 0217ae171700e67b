"""How well robots are placed by a camera that vibrates or breathes, on ray-cast frames where the truth is known.

    python -m tools.measure.tracking.vibration [--images N] [--axes AXES] [--breaths PERCENT] [--survey MM] [--json]

The shipped platoon's camera hangs 2.5 m up and turns about its own axes (x right, y down, z forward) as a sine of 7 Hz,
at 30 images a second, without a rolling shutter; during an exposure it stands still. Or its focus breathes: the focal
length's logarithm is a sine of 1.3 s. The lens's sigma is 0.7 px. Four floor tags of 100 mm lie in the corners,
surveyed to ``--survey``. Of four robots two drive, up to 0.2 m/s and 2 rad/s, and two stand. Columns, from the tenth
image on, once without floor tags and once with them: position rms and largest error [mm], the mean of the squared
errors by their covariances (1: they are true), how many images measured no robot at all, and how many of the robots'
images were measured.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.tracking.sight import FleetSight
from robofleet.tracking.tags.targets import robot_targets
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import Print, RayCaster, along, clutter
from tools.measure.program import program
from tools.measure.tracking.score import rms, squared

RATE_HZ, PERIOD = 7.0, 1.0 / 30.0
BREATH_S = 1.3
AMPLITUDES_DEG = (0.0, 0.02, 0.05)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "all": (1.0, 1.0, 1.0)}
CORNERS = ((-1.45, -0.85), (1.45, -0.85), (1.45, 0.85), (-1.45, 0.85))
FLOOR_SIDE = 0.1
NOISE = 3.5  # [grey levels], see RayCaster.image
COUNTS_FROM = 10  # images, in which tags are found

_ROOT = Path(__file__).parents[3]
_STARTS = np.array([(-0.6, 0.3, 0.4), (0.5, -0.3, 2.0), (0.9, 0.5, -1.0), (-1.0, -0.4, 0.1)])
_DRIVES = np.array([1.0, 1.0, 0.0, 0.0])
_BEAT, _PHASE = np.array([[1.7, 2.1, 0.0, 0.0], [2.3, 1.6, 0.0, 0.0]]), np.array([[0.3, 1.9, 0, 0], [2.0, 0.5, 0, 0]])


class Frame(NamedTuple):
    """An image and the poses (N, 3) of the robots then."""

    image: NDArray[np.uint8]
    exposure_ns: int
    poses: Array


def configuration(*, floor_tags: bool, survey: Array | None = None) -> Config:
    """Return the shipped platoon, with floor tags where the survey's errors (4, 2) [m] say they lie, or without."""
    if not floor_tags:
        return load_config(_ROOT / "configs/platoon.yaml", [])
    errors = np.zeros((len(CORNERS), 2)) if survey is None else survey
    tags = [
        {"tag": 100 + i, "side_m": FLOOR_SIDE, "x_m": x + dx, "y_m": y + dy}
        for i, ((x, y), (dx, dy)) in enumerate(zip(CORNERS, errors.tolist(), strict=True))
    ]
    return load_config(_ROOT / "configs/platoon.yaml", [f"tracker.floor_tags={tags}"])


def frames(
    config: Config, turn_deg: Sequence[float], images: int, breath: float = 0.0, seed: int = 1
) -> Iterator[Frame]:
    """Yield what a camera sees that turns by so much about its axes, and whose focal length changes by a share."""
    model, rng = config.camera.model, np.random.default_rng(seed)
    eye = _still(config)
    caster = RayCaster(eye, clutter((model.width, model.height), rng), rng)
    floor = [Print(100 + i, FLOOR_SIDE, 0.0, (x, y, 0.0)) for i, (x, y) in enumerate(CORNERS)]
    poses = _STARTS.copy()
    for k in range(images):
        t = k * PERIOD
        turn = np.radians(turn_deg) * math.sin(math.tau * RATE_HZ * t + 0.4)
        T = eye.T_world_camera.copy()
        T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(turn)[0]
        K = eye.K.copy()
        K[[0, 1], [0, 1]] *= math.exp(breath * math.sin(math.tau * t / BREATH_S))
        caster.camera = replace(eye, T_world_camera=T, K=K)
        twists = np.array([[0.2], [2.0]]) * np.sin(_BEAT * t + _PHASE) * _DRIVES
        robots = [
            Print(target.tag, target.side, target.height, (x, y, psi), (v, 0.0, omega))
            for target, (x, y, psi), (v, omega) in zip(
                robot_targets(config), poses.tolist(), twists.T.tolist(), strict=True
            )
        ]
        yield Frame(caster.image([*floor, *robots], 0.7, NOISE), round((1.0 + t) * 1e9), poses.copy())
        poses = np.array([list(map(float, along(tag.pose, tag.twist, PERIOD))) for tag in robots])


def evaluate(
    configs: dict[str, Config], turn_deg: Sequence[float], images: int, breath: float = 0.0
) -> dict[str, dict[str, float]]:
    """Return the row of each configuration, all of them on the same frames."""
    sights = {name: FleetSight(config) for name, config in configs.items()}
    config = next(iter(configs.values()))
    tags = {target.tag: row for row, target in enumerate(robot_targets(config))}
    errors: dict[str, list[list[float]]] = {name: [] for name in configs}  # and covariances
    without = dict.fromkeys(configs, 0)
    for k, frame in enumerate(frames(config, turn_deg, images, breath)):
        for name, sight in sights.items():
            seen = [robot for robot in sight.see(frame.image, frame.exposure_ns).poses if robot.coasted_ns == 0]
            if k >= COUNTS_FROM:
                without[name] += not seen
                errors[name] += [
                    [*(np.array([r.x, r.y, r.psi]) - frame.poses[tags[r.tag]]), *r.covariance] for r in seen
                ]
    counted = max(1, (images - COUNTS_FROM) * len(tags))
    rows = {}
    for name, found in errors.items():
        table = np.array(found or [[math.nan] * 9])
        position = 1e3 * np.hypot(*table[:, :2].T)
        rows[name] = {
            "rms_mm": rms(position), "max_mm": float(position.max()),
            "chi2_xy": float(squared(table[:, :3], table[:, 3:])[0].mean()) / 2.0,
            "without": without[name], "measured": len(found) / counted,
        }  # fmt: skip
    return rows


def _still(config: Config) -> RayCamera:
    """Return the configured camera as it hangs when nothing shakes it."""
    model = config.camera.model
    assert model.T_world_camera is not None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array(model.T_world_camera.rotation_rad))[0]
    T[:3, 3] = model.T_world_camera.position_m
    K = np.diag([*model.focal_px, 1.0])
    K[:2, 2] = model.centre_px
    fisheye = model.lens == "fisheye"
    return RayCamera((model.width, model.height), K, np.array(model.distortion), T, fisheye, config.camera.exposure_s)


def main() -> None:
    parser = program(
        __doc__,
        images=90,
        axes=(",".join(AXES), "of x, y, z and all (default: each of these)"),
        breaths=("0.5", "amplitudes [%], by commas"),
        survey=(0.0, "standard deviation of the floor tags' places [mm]"),
        json=(False, "one JSON object, and nothing else"),
    )
    arguments = parser.parse_args()
    axes = arguments.axes.split(",")
    if not set(axes) <= AXES.keys():
        parser.error(f"--axes {arguments.axes}: of {', '.join(AXES)}")
    if arguments.images <= COUNTS_FROM:
        parser.error(f"--images {arguments.images}: more than {COUNTS_FROM}")
    cv2.setNumThreads(1)
    survey = np.random.default_rng(7).normal(0.0, 1e-3 * arguments.survey, (len(CORNERS), 2))
    configs = {"without": configuration(floor_tags=False), "floor tags": configuration(floor_tags=True, survey=survey)}
    motions = {}
    for amplitude in AMPLITUDES_DEG:
        for axis in axes if amplitude else axes[:1]:
            title = f"{amplitude} deg about {axis}" if amplitude else "still"
            motions[title] = [amplitude * part for part in AXES[axis]], 0.0
    for percent in filter(None, arguments.breaths.split(",")):
        motions[f"breath of {percent} %"] = [0.0, 0.0, 0.0], float(percent) / 100.0
    table = {}
    for title, (turn_deg, breath) in motions.items():
        table[title] = evaluate(configs, turn_deg, arguments.images, breath)
        if not arguments.json:
            _show(title, table[title])
    if arguments.json:
        print(json.dumps(table))


def _show(title: str, rows: dict[str, dict[str, float]]) -> None:
    for name, row in rows.items():
        print(
            f"{title:<20}{name:<12}rms {row['rms_mm']:6.3f}  max {row['max_mm']:6.3f} mm  chi2 {row['chi2_xy']:6.2f}  "
            f"no robots in {row['without']:.0f} images  measured {100 * row['measured']:5.1f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
