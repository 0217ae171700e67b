"""How well tags are placed, ours and the peers', on ray-cast frames where the truth is known.

    python -m tools.measure.tracking.accuracy [--json] [--frames N] [--only NAME] [--scenes NAME]

A 1080p camera 2.5 m up sees 8 tags of 70 mm, 8 cm high, about 36 px, that drive as robots do: up to 0.2 m/s and 2
rad/s, at 30 images a second of 4 ms. Each scene is three drives with other floors, tags, lenses (a Gaussian of sigma
0.7, 0.5 and 0.9 px) and light; a drive begins cold. Columns: position rms and largest error [mm], heading rms and
largest [deg]; the mean error, which no filter takes away [mm]; how many of the tags were measured in their image
(predicting is not measuring); and what was said that is wrong: of no such tag, or of a tag over 5 mm away, or of one
twice. The rms are of the rest. The bound is Cramer and Rao's: the least rms that any unbiased estimator of the same
greys can have, with gain, offset and a slope of the light unknown (and no cable).
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from tests.tracking.peers import CANDIDATES, UNTIMED, Setting
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import SQUARES, Cable, Print, RayCaster, along, clutter
from tools.measure.program import program
from tools.measure.tracking.score import Score, print_tables, rms

SIDE, HEIGHT = 0.07, 0.08
SIZE = (1920, 1080)
FOCAL = 1245.0  # 36 px for a tag in the middle [px]
PERIOD = 1.0 / 30.0
BOUND = "Cramer-Rao bound"
LEAD_IN = 10  # images before the cable falls or the light goes out

_K = np.array([[FOCAL, 0.0, 966.0], [0.0, FOCAL, 538.0], [0.0, 0.0, 1.0]])
_BARREL = np.array([-0.1, 0.015, 0.0004, -0.0003, 0.0])
_FISHEYE = np.array([-0.02, 0.003, -0.001, 0.0004])
_DRIVES = ((0.7, 1.0), (0.5, 0.8), (0.9, 0.6))  # the lens's sigma [px], light


class Scene(NamedTuple):
    noise: float  # [grey levels], see RayCaster.image
    darkness: float = 0.0  # the light, once it went out; 0: it stays on
    cable_px: float = 0.0  # a cable so wide falls across every tag
    line_time: float = 0.0  # [s]
    fisheye: bool = False
    steady: bool = False  # all drive at 0.2 m/s

    @property
    def troubled(self) -> bool:
        """Whether something happens after LEAD_IN images, before which none count."""
        return self.darkness > 0.0 or self.cable_px > 0.0


SCENES = {
    "noise 0": Scene(0.0),
    "noise 2": Scene(2.0),
    "noise 3.5": Scene(3.5),
    "noise 5": Scene(5.0),
    "cable of 2 px": Scene(3.5, cable_px=2.0),
    "15 % light": Scene(3.5, darkness=0.15),
    "rolling shutter, 20 ms": Scene(3.5, line_time=0.02 / SIZE[1], steady=True),
    "fisheye": Scene(3.5, fisheye=True),
}


def cell_wide(family: str) -> float:
    """Return the side of a family's tags whose cells are as large as those of 36h11 [m]."""
    return SIDE / SQUARES["36h11"][1] * SQUARES[family][1]


class Frame(NamedTuple):
    image: NDArray[np.uint8]
    exposure_ns: int
    prints: tuple[Print, ...]
    level: float  # of the light
    counts: bool


def camera(scene: Scene, lens_sigma_px: float) -> RayCamera:
    """Return the camera: 2.5 m up, tilted by 2 degrees, an exposure of 4 ms."""
    T = np.eye(4)
    down, tilt = (cv2.Rodrigues(np.array(turn))[0] for turn in ([math.pi, 0.0, 0.0], [0.0, math.radians(2.0), 0.0]))
    T[:3, :3] = down @ tilt
    T[2, 3] = 2.5
    distortion = _FISHEYE if scene.fisheye else _BARREL
    return RayCamera(SIZE, _K, distortion, T, scene.fisheye, 0.004, scene.line_time, lens_sigma_px)


def drives(scene: Scene, frames: Sequence[int]) -> Iterator[tuple[Setting, RayCaster, Iterator[Frame]]]:
    """Yield up to three drives; so many images of each count."""
    for number, (wanted, (lens, light)) in enumerate(zip(frames, _DRIVES, strict=False)):
        rng = np.random.default_rng((1, number))
        eye = camera(scene, lens)
        caster = RayCaster(eye, clutter(SIZE, rng, lens), rng)
        geometry = CameraGeometry(eye.K, eye.distortion, eye.T_world_camera, "fisheye" if eye.fisheye else "pinhole")
        tags = rng.choice(587, 8, replace=False).tolist()
        setting = Setting(geometry, SIZE, [Target(tag, SIDE, HEIGHT, 0.3) for tag in tags], scene.line_time)
        yield setting, caster, _drive(scene, caster, tags, wanted, light, rng)


def evaluate(scene: Scene, names: Sequence[str], frames: Sequence[int]) -> dict[str, dict[str, float]]:
    scores, bounds = {name: Score() for name in names if name != BOUND}, []
    for setting, caster, pictures in drives(scene, frames):
        candidates = {name: CANDIDATES[name](setting) for name in scores}
        begun = False
        for frame in pictures:
            for name, see in candidates.items():
                seen = see(frame.image, frame.exposure_ns)
                if frame.counts:
                    scores[name].add(frame.prints, seen)
            if BOUND in names and frame.counts and not begun:
                bounds += [_least(caster, tag._replace(cable=None), frame.level, scene.noise) for tag in frame.prints]
                begun = True
    rows = {name: score.row() for name, score in scores.items()}
    if bounds:
        position, heading = np.array(bounds).T
        rows[BOUND] = {"rms_mm": rms(position), "rms_deg": rms(heading)}
    return rows


def _drive(
    scene: Scene, caster: RayCaster, tags: Sequence[int], frames: int, light: float, rng: np.random.Generator
) -> Iterator[Frame]:
    anchors = np.stack(np.meshgrid([-1.3, -0.45, 0.45, 1.3], [-0.45, 0.45]), axis=-1).reshape(8, 2)
    starts = np.column_stack([anchors + rng.uniform(-0.15, 0.15, (8, 2)), rng.uniform(-math.pi, math.pi, 8)])
    poses = list(map(tuple, starts.tolist()))
    beat, phase = rng.uniform(1.5, 3.0, (2, 8)), rng.uniform(0.0, math.tau, (2, 8))  # [rad/s], [rad]
    cables = [_cable(scene.cable_px, rng) for _ in tags]
    lead_in = LEAD_IN if scene.troubled else 0
    for k in range(lead_in + frames):
        v, omega = np.array([[0.2], [2.0]]) * np.sin(beat * k * PERIOD + phase)
        v = np.copysign(0.2, v) if scene.steady else v
        twists = [(ahead, 0.0, turn) for ahead, turn in zip(v.tolist(), omega.tolist(), strict=True)]
        trouble = scene.troubled and k >= lead_in
        prints = tuple(
            Print(tag, SIDE, HEIGHT, pose, twist, cable if trouble else None)
            for tag, pose, twist, cable in zip(tags, poses, twists, cables, strict=True)
        )
        level = scene.darkness if trouble and scene.darkness else light
        image = caster.image(prints, level, scene.noise)
        yield Frame(image, round((1.0 + k * PERIOD) * 1e9), prints, level, k >= lead_in)
        poses = [tuple(map(float, along(pose, twist, PERIOD))) for pose, twist in zip(poses, twists, strict=True)]


def _cable(width_px: float, rng: np.random.Generator) -> Cable | None:
    """Return a cable across the pattern, black, grey or white."""
    forward, left = rng.uniform(-0.25 * SIDE, 0.25 * SIDE, 2).tolist()
    width = width_px * (2.5 - HEIGHT) / FOCAL
    cable = Cable(forward, left, rng.uniform(0.0, math.pi), width, 0.005, rng.choice([20.0, 110.0, 210.0]).item())
    return cable if width_px else None


def _least(caster: RayCaster, tag: Print, level: float, noise: float) -> tuple[float, float]:
    """Return the bound's rms of position [mm] and heading [deg]: the inverse of the greys' Fisher information."""
    patch = caster.patch(tag)
    inside = patch.cover > 0.999
    steps = np.array([1e-5, 1e-5, 2e-4])

    def look(offset: Array) -> Array:
        x, y, psi = np.array(tag.pose) + offset
        return caster.light([tag._replace(pose=(x, y, psi))])[patch.where][inside].astype(np.float64) * level

    slopes = [(look(step) - look(-step)) / (2.0 * step.sum()) for step in np.diag(steps)]
    grey, (v, u) = look(np.zeros(3)), np.nonzero(inside)
    J = np.stack([*slopes, np.ones_like(grey), grey, grey * (u - u.mean()), grey * (v - v.mean())], axis=1)
    variance = noise**2 * (0.5 + 0.5 * grey / 128.0) + 1.0 / 12.0  # the last by rounding
    J /= np.sqrt(variance)[:, None]
    scale = np.linalg.norm(J, axis=0)  # of metres and greys, to keep the inverse sound
    covariance = np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale)
    return math.sqrt(covariance[0, 0] + covariance[1, 1]) * 1e3, math.degrees(math.sqrt(covariance[2, 2]))


def main() -> None:
    parser = program(
        __doc__,
        json=(False, "one JSON object, and nothing else"),
        frames=(90, "images a scene"),
        only=("", "candidates whose name has this in it"),
        scenes=("", "scenes whose name has this in it"),
    )
    arguments = parser.parse_args()
    names = [name for name in CANDIDATES if arguments.only in name]
    scenes = {title: scene for title, scene in SCENES.items() if arguments.scenes in title}
    if not names:
        parser.error(f"--only {arguments.only}: of {', '.join(CANDIDATES)}")
    if not scenes:
        parser.error(f"--scenes {arguments.scenes}: of {', '.join(SCENES)}")
    if arguments.frames < 1:
        parser.error(f"--frames {arguments.frames}: at least 1")
    cv2.setNumThreads(1)
    frames = [math.ceil(arguments.frames / len(_DRIVES))] * len(_DRIVES)

    def rows(scene: Scene) -> dict[str, dict[str, float]]:
        shown = [name for name in names if name != UNTIMED or scene.line_time]
        return evaluate(scene, [*shown, BOUND], frames)

    widths = {"rms_mm": 9, "max_mm": 9, "mean_mm": 9, "rms_deg": 9, "max_deg": 9, "measured": 10, "wrong": 7}
    print_tables(((title, rows(scene)) for title, scene in scenes.items()), widths, 30, as_json=arguments.json)


if __name__ == "__main__":
    main()
