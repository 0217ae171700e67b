"""How well tags are placed and how sure that is, on ray-cast frames where the truth is known.

    python -m tools.measure.tracking.certainty [--poses N] [--scenes NAME] [--family NAME] [--angles]

Each image shows tags of 70 mm, or tags of another family with cells as large, 8 cm high, somewhere else, moving at up
to 0.2 m/s and 2 rad/s, through a lens of sigma 0.7 px, at 70 % light, with a noise of 3.5 grey levels; a tag's guess is
off by 0.3 px and 0.5 degrees. Columns: position's rms and largest error, and rms of what the covariances say [mm]; mean
of the squared errors by their covariances, which is 1 a degree of freedom if they are true (x and y; heading); the
largest error by its covariance [sigma]; how many tags looked like themselves. Without --angles the last table is left
out: the mean error of 400 poses at one angle to the pixel rows [px], with cells of 3 px, and the rms of the worst phase
[mm].
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.settings import FAMILIES
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.deep import DeepSearch
from robofleet.tracking.tags.photometric import Fit, PhotometricFit
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import CLEAR
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import SQUARES, Cable, Print, RayCaster, clutter
from tools.measure.program import program
from tools.measure.tracking.accuracy import HEIGHT, SIDE, cell_wide
from tools.measure.tracking.accuracy import Scene as Quality
from tools.measure.tracking.accuracy import camera as full_camera
from tools.measure.tracking.score import rms, squared


class Scene(NamedTuple):
    tags: int = 20
    small: bool = False  # 720p in place of 1080p
    light: float = 0.7
    lens: float = 0.7  # sigma [px]
    noise: float = 3.5  # [grey levels]
    covered: float = 0.0  # share of the print behind a straight edge
    cable_px: float = 0.0
    moving: bool = True
    family: str = "36h11"


SCENES = {
    "1080p, 4 tags": Scene(4),
    "1080p, 20 tags": Scene(20),
    "1080p, 50 tags": Scene(50),
    "720p, 4 tags": Scene(4, small=True),
    "720p, 20 tags": Scene(20, small=True),
    "720p, 50 tags": Scene(50, small=True),
    "lens 1.2 px": Scene(lens=1.2),
    "15 % light": Scene(light=0.15),
    "noise 1": Scene(noise=1.0),
    "a side or corner covered, 12 %": Scene(covered=0.12),
    "a side or corner covered, 25 %": Scene(covered=0.25),
    "cable of 2 px": Scene(cable_px=2.0),
}

_TEACHING = 10  # images


class Placed(NamedTuple):
    """Tags of one image: what is true, and what the fit says."""

    error: Array  # (M, 3): x, y [m], psi [rad]
    fit: Fit


def camera(scene: Scene) -> RayCamera:
    """Return accuracy.py's camera, or the same with fewer pixels."""
    eye = full_camera(Quality(scene.noise), scene.lens)
    if not scene.small:
        return eye
    K = eye.K * [[2 / 3, 1, 2 / 3], [1, 2 / 3, 2 / 3], [1, 1, 1]]
    return replace(eye, size=(1280, 720), K=K)


def placed(scene: Scene, poses: int, seed: int = 1) -> Iterator[Placed]:
    """Yield images until so many tags were placed; the first ones teach the fit blur, noise and tilt, and do not
    count."""
    rng = np.random.default_rng(seed)
    eye = camera(scene)
    caster = RayCaster(eye, clutter(eye.size, rng, scene.lens), rng)
    geometry = CameraGeometry(eye.K, eye.distortion, eye.T_world_camera)
    ids = rng.choice(FAMILIES[scene.family].ids, scene.tags, replace=False).tolist()
    targets = [Target(tag, cell_wide(scene.family), HEIGHT, 0.3, scene.family) for tag in ids]
    fit = PhotometricFit(geometry, targets)
    deep = DeepSearch(fit, targets)
    pixel = (2.5 - HEIGHT) / float(eye.K[0, 0])
    for k in range(-_TEACHING, math.ceil(poses / scene.tags)):
        true = _poses(scene.tags, rng)
        speed = rng.uniform(-1.0, 1.0, (scene.tags, 2)) * [0.2, 2.0] * scene.moving
        clear = scene if k >= 0 else scene._replace(covered=0.0, cable_px=0.0)
        prints = [
            Print(
                target.tag, target.side, HEIGHT, pose, (v, 0.0, omega), _cover(clear, pixel, rng), family=scene.family
            )
            for target, pose, (v, omega) in zip(targets, map(tuple, true.tolist()), speed.tolist(), strict=True)
        ]
        image = caster.image(prints, scene.light, scene.noise)
        off = rng.normal(0.0, 0.3 * pixel / math.sqrt(2.0), (scene.tags, 2)) @ [1.0, 1j]
        centre, psi = (
            (true[:, :2] @ [1.0, 1j] + off).astype(np.complex128),
            true[:, 2] + rng.normal(0.0, 0.009, scene.tags),
        )
        seen = fit.fit(image, np.arange(scene.tags), centre, psi)
        for row in range(scene.tags) if k < 0 else [k % scene.tags]:
            fit.fit(image, np.array([row]), seen.centre[[row]], seen.psi[[row]], studied=row)
        for row in np.flatnonzero(seen.alike < CLEAR).tolist():  # as the tracker does
            tag = deep.near(image, row, complex(seen.centre[row]), float(seen.psi[row]), followed=True)
            if tag is not None:
                seen.alike[row], seen.centre[row], seen.psi[row], seen.covariance[row] = 1.0, *tag[1:]
        error = np.column_stack([seen.centre.real, seen.centre.imag, seen.psi]) - true
        error[:, 2] = np.remainder(error[:, 2] + math.pi, math.tau) - math.pi
        if k >= 0:
            yield Placed(error, seen)


def certainty(scene: Scene, poses: int) -> dict[str, float]:
    images = list(placed(scene, poses))
    error = np.concatenate([image.error for image in images])
    spread = np.concatenate([image.fit.covariance for image in images])
    alike = np.concatenate([image.fit.alike for image in images])
    matches = alike > FAMILIES[scene.family].alike
    error, spread = error[matches], spread[matches]
    by_xy, by_psi = squared(error, spread)
    position = np.hypot(*error[:, :2].T) * 1e3
    return {
        "rms_mm": rms(position), "max_mm": float(position.max()),
        "said_mm": 1e3 * math.sqrt((spread[:, 0] + spread[:, 2]).mean()),
        "chi2_xy": float(by_xy.mean()) / 2.0, "chi2_psi": float(by_psi.mean()),
        "worst_sigma": math.sqrt(float(by_xy.max())), "poses": len(error), "alike": float(matches.mean()),
    }  # fmt: skip


def biases(angles: Array, poses: int, lens: float = 0.7) -> Iterator[tuple[float, float, float]]:
    """Yield angle [deg], mean error [px] and the worst phase's rms [mm] of tags with cells of 3 px."""
    scene = Scene(16, lens=lens, moving=False)
    eye = camera(scene)
    K = eye.K * [[24 / 36, 1, 1], [1, 24 / 36, 1], [1, 1, 1]]
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 2.5
    eye = replace(eye, K=K, distortion=np.zeros(5), T_world_camera=down)
    pixel = (2.5 - HEIGHT) / float(K[0, 0])
    geometry = CameraGeometry(eye.K, eye.distortion, eye.T_world_camera)
    grid = np.stack(np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5), axis=-1).reshape(16, 2)
    phases = (grid + 1.5) / 4.0  # of a pixel
    for angle in angles.tolist():
        rng = np.random.default_rng(5)
        caster = RayCaster(eye, clutter(eye.size, rng, scene.lens), rng)
        # Every tag at a phase of its own, with the same print: what differs is the phase alone.
        fit = PhotometricFit(geometry, [Target(7, SIDE, HEIGHT, 0.3)])
        true = (np.round(grid * 160.0) + phases) * pixel
        prints = [Print(7, SIDE, HEIGHT, (x, y, math.radians(angle))) for x, y in true.tolist()]
        light = caster.light(prints) * np.float32(scene.light)
        errors = []
        for _ in range(max(2, poses // 16)):
            image = caster.exposed(light, scene.noise)
            for x, y in true.tolist():
                centre = np.array([complex(x, y) + rng.normal(0.0, 0.2 * pixel)])
                seen = fit.fit(image, np.zeros(1, np.int64), centre, np.array([math.radians(angle)]))
                errors.append(seen.centre[0] - complex(x, y))
        each = np.array(errors).reshape(-1, 16)
        mean = each[1:].mean(0)
        worst = float(np.sqrt((np.abs(each[1:]) ** 2).mean(0)).max())
        yield angle, float(np.abs(mean).max()) / pixel, worst * 1e3


def _poses(count: int, rng: np.random.Generator) -> Array:
    """Return poses (N, 3) that do not overlap."""
    columns = 4 if count <= 8 else 10 if count > 20 else 5
    rows = -(-count // columns)
    x, y = np.meshgrid(np.linspace(-1.3, 1.3, columns), np.linspace(-0.6, 0.6, rows) if rows > 1 else [0.0])
    at = np.column_stack([x.ravel(), y.ravel()])[:count] + rng.uniform(-0.05, 0.05, (count, 2))
    return np.column_stack([at, rng.uniform(-math.pi, math.pi, count)])


def _cover(scene: Scene, pixel: float, rng: np.random.Generator) -> Cable | None:
    """Return what hides a part of a print: a strip across it, or all beyond a straight edge."""
    if not scene.covered and not scene.cable_px:
        return None
    run, grey = rng.uniform(0.0, math.tau), rng.choice([20.0, 110.0, 210.0]).item()
    if scene.cable_px:
        forward, left = rng.uniform(-0.25 * SIDE, 0.25 * SIDE, 2).tolist()
        return Cable(forward, left, run, scene.cable_px * pixel, 0.005, grey)
    grid = (np.arange(100) + 0.5) / 100 - 0.5
    normal = np.array([-math.sin(run), math.cos(run)])
    depth = normal[0] * grid[:, None] + normal[1] * grid
    whole = SIDE * FAMILIES[scene.family].cells / 8.0
    begins = float(np.quantile(depth, 1.0 - scene.covered)) * whole
    forward, left = (normal * (begins + whole)).tolist()
    return Cable(forward, left, run, 2.0 * whole, 0.001, grey)


def main() -> None:
    parser = program(
        __doc__,
        poses=(2000, "of each scene"),
        scenes=("", "scenes whose name has this in it"),
        angles=(False, "the table by angles, too"),
    )
    parser.add_argument("--family", default="36h11", choices=SQUARES, help="of the tags; not in the last table")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for number, (title, scene) in enumerate(SCENES.items()):
        if arguments.scenes in title:
            row = certainty(scene._replace(family=arguments.family), arguments.poses)
            if not number:
                print(f"{'':<32}" + "".join(f"{column:>12}" for column in row))
            print(f"{title:<32}" + "".join(f"{value:>12.4g}" for value in row.values()), flush=True)
    if arguments.angles:
        print(f"\n{'angle [deg]':>12}{'bias [px]':>12}{'worst [mm]':>12}")
        for row_of_angle in biases(np.linspace(0.0, 45.0, 10), 400):
            print("".join(f"{value:>12.4g}" for value in row_of_angle), flush=True)


if __name__ == "__main__":
    main()
