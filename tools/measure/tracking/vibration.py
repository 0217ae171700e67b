"""How well robots are placed by a camera that vibrates or whose focal length breathes, on ray-cast frames where the
truth is known.

    python -m tools.measure.tracking.vibration [--images N] [--motions WORDS] [--survey MM] [--full-hd] [--json]

The shipped platoon's camera hangs 2.5 m up, with 720 or, ``--full-hd``, 1080 rows. It turns about its own axes (x
right, y down, z forward) as a sine of 7 Hz, or its focal length is multiplied by 1 plus a sine of 0.25 or 0.5 % of
1.3 s, at 30 images a second, without a rolling shutter; during an exposure it stands still. Four floor tags of 100 mm
lie in the corners, surveyed to ``--survey``. Of four robots two drive, up to 0.2 m/s and 2 rad/s, and two stand.
Columns, from the tenth image on, once without floor tags and once with them: position rms and largest error [mm], mean
of the squared errors by their covariances (1 a degree of freedom if they are true), how many images measured no robot
at all, and how many of the robots' images were measured.
"""

import json
import math
from collections.abc import Iterator
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
from robofleet.tracking.tags.tracker import TagSighting
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import Print, RayCaster, along, clutter
from tools.measure.program import program

PERIOD = 1.0 / 30.0
CORNERS = ((-1.45, -0.85), (1.45, -0.85), (1.45, 0.85), (-1.45, 0.85))
FLOOR_SIDE = 0.1
NOISE = 3.5  # [grey levels], see RayCaster.image
COUNTS_FROM = 10  # images, in which tags are found

_ROOT = Path(__file__).parents[3]
_STARTS = np.array([(-0.6, 0.3, 0.4), (0.5, -0.3, 2.0), (0.9, 0.5, -1.0), (-1.0, -0.4, 0.1)])
_DRIVES = np.array([1.0, 1.0, 0.0, 0.0])
_BEAT, _PHASE = np.array([[1.7, 2.1, 0.0, 0.0], [2.3, 1.6, 0.0, 0.0]]), np.array([[0.3, 1.9, 0, 0], [2.0, 0.5, 0, 0]])


class Motion(NamedTuple):
    """A sine of a camera's own axes, or of its focal length."""

    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal: float = 0.0  # share of the focal length
    rate_hz: float = 7.0


MOTIONS = {
    "still": Motion(),
    **{
        f"{deg} deg about {name}": Motion((deg * x, deg * y, deg * z))
        for deg in (0.02, 0.05)
        for name, (x, y, z) in {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "all": (1, 1, 1)}.items()
    },
    **{f"{100 * focal:g} % of focal length": Motion(focal=focal, rate_hz=1.0 / 1.3) for focal in (0.0025, 0.005)},
}


class Frame(NamedTuple):
    """An image and the poses (N, 3) of the robots then."""

    image: NDArray[np.uint8]
    exposure_ns: int
    poses: Array


def configuration(*, floor_tags: bool, survey: Array | None = None, full_hd: bool = False) -> Config:
    """Return the shipped platoon, with floor tags where the survey's errors (4, 2) [m] say they lie, or without."""
    errors = np.zeros((len(CORNERS), 2)) if survey is None else survey
    tags = [
        {"tag": 100 + i, "side_m": FLOOR_SIDE, "x_m": x + dx, "y_m": y + dy}
        for i, ((x, y), (dx, dy)) in enumerate(zip(CORNERS, errors.tolist(), strict=True))
    ]
    config = load_config(_ROOT / "configs/platoon.yaml", [f"tracker.floor_tags={tags}"] if floor_tags else [])
    if not full_hd:
        return config
    camera, size = config.camera, {"width": 1920, "height": 1080}
    (f_x, f_y), (c_x, c_y) = camera.model.focal_px, camera.model.centre_px
    lens = {"focal_px": (1.5 * f_x, 1.5 * f_y), "centre_px": (1.5 * c_x + 0.25, 1.5 * c_y + 0.25)}
    model = camera.model.model_copy(update=size | lens)
    return config.model_copy(update={"camera": camera.model_copy(update=size | {"model": model})})


def frames(config: Config, motion: Motion, images: int, seed: int = 1) -> Iterator[Frame]:
    """Yield what a camera sees that moves so."""
    model, rng = config.camera.model, np.random.default_rng(seed)
    eye = _still(config)
    caster = RayCaster(eye, clutter((model.width, model.height), rng), rng)
    floor = [Print(100 + i, FLOOR_SIDE, 0.0, (x, y, 0.0)) for i, (x, y) in enumerate(CORNERS)]
    poses = _STARTS.copy()
    for k in range(images):
        t = k * PERIOD
        phase = math.sin(math.tau * motion.rate_hz * t + 0.4)
        T, K = eye.T_world_camera.copy(), eye.K.copy()
        T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(np.radians(motion.turn_deg) * phase)[0]
        K[[0, 1], [0, 1]] *= 1.0 + motion.focal * phase
        caster.camera = replace(eye, K=K, T_world_camera=T)
        twists = np.array([[0.2], [2.0]]) * np.sin(_BEAT * t + _PHASE) * _DRIVES
        robots = [
            Print(target.tag, target.side, target.height, (x, y, psi), (v, 0.0, omega))
            for target, (x, y, psi), (v, omega) in zip(
                robot_targets(config), poses.tolist(), twists.T.tolist(), strict=True
            )
        ]
        yield Frame(caster.image([*floor, *robots], 0.7, NOISE), round((1.0 + t) * 1e9), poses.copy())
        poses = np.array([list(map(float, along(tag.pose, tag.twist, PERIOD))) for tag in robots])


def evaluate(configs: dict[str, Config], motion: Motion, images: int) -> dict[str, dict[str, float]]:
    """Return the row of each configuration, all of them on the same frames."""
    sights = {name: FleetSight(config) for name, config in configs.items()}
    config = next(iter(configs.values()))
    tags = {target.tag: row for row, target in enumerate(robot_targets(config))}
    errors: dict[str, list[tuple[float, float]]] = {name: [] for name in configs}
    without = dict.fromkeys(configs, 0)
    for k, frame in enumerate(frames(config, motion, images)):
        for name, sight in sights.items():
            seen = [robot for robot in sight.see(frame.image, frame.exposure_ns).poses if robot.coasted_ns == 0]
            if k >= COUNTS_FROM:
                without[name] += not seen
                errors[name] += [_error(robot, frame.poses[tags[robot.tag]]) for robot in seen]
    counted = max(1, (images - COUNTS_FROM) * len(tags))
    return {
        name: {
            "rms_mm": math.sqrt(np.square(np.array(found)[:, 0]).mean()) if found else math.nan,
            "max_mm": max((distance for distance, _ in found), default=math.nan),
            "chi2": float(np.array(found)[:, 1].mean()) / 2.0 if found else math.nan,
            "without": without[name],
            "measured": len(found) / counted,
        }
        for name, found in errors.items()
    }


def _error(seen: TagSighting, pose: Array) -> tuple[float, float]:
    """Return how far off a robot was measured [mm], and the square of that by its covariance."""
    off = np.array([seen.x, seen.y]) - pose[:2]
    xx, xy, yy = seen.covariance[:3]
    return 1e3 * math.hypot(*off), float(off @ np.linalg.solve([[xx, xy], [xy, yy]], off))


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
        motions=("", "motions whose name has this in it"),
        survey=(0.0, "standard deviation of the floor tags' places [mm]"),
        full_hd=(False, "1080 rows"),
        json=(False, "one JSON object, and nothing else"),
    )
    arguments = parser.parse_args()
    if arguments.images <= COUNTS_FROM:
        parser.error(f"--images {arguments.images}: more than {COUNTS_FROM}")
    cv2.setNumThreads(1)
    survey = np.random.default_rng(7).normal(0.0, 1e-3 * arguments.survey, (len(CORNERS), 2))
    configs = {
        "without": configuration(floor_tags=False, full_hd=arguments.full_hd),
        "floor tags": configuration(floor_tags=True, survey=survey, full_hd=arguments.full_hd),
    }
    table = {}
    for title, motion in MOTIONS.items():
        if arguments.motions in title:
            table[title] = evaluate(configs, motion, arguments.images)
            if not arguments.json:
                _show(title, table[title])
    if arguments.json:
        print(json.dumps(table))


def _show(title: str, rows: dict[str, dict[str, float]]) -> None:
    for name, row in rows.items():
        print(
            f"{title:<26}{name:<12}rms {row['rms_mm']:6.3f}  max {row['max_mm']:6.3f} mm  chi2 {row['chi2']:7.3g}  "
            f"no robots in {row['without']:.0f} images  measured {100 * row['measured']:5.1f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
