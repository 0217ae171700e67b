"""How well tags are placed under what lenses, cameras, light and prints do, on ray-cast frames, ours and a peer's.

    python -m tools.measure.tracking.effects [--poses N] [--effects NAMES] [--sides PX ...] [--alone]

accuracy.py's camera, with a smooth lens of sigma 0.7 px if nothing else is named, sees tags of 70 mm, 8 cm high, which
drive at up to 0.2 m/s and 2 rad/s at any angle, at 70 % light and with a noise of 3.5 grey levels at grey 128. The
tracker begins cold, and 20 images do not count. Where the print is not what the tracker is told, six tags drive circles
of 0.3 m at 0.2 m/s, and 20 s do not count. Columns: position rms [mm] and heading rms [deg]; mean of the squared errors
by the covariances, a degree of freedom (x and y; heading): 1 if these are true; how many of the tags were measured in
their image, and how many said that are wrong; the position rms and the measured share of pyapriltags, decimate 1, on
the same images; its rms by ours; the time that an effect took, its share of the images' casting included [s].

Effects of the same light and prints share their images before the camera. --effects takes parts of names, by commas;
--alone leaves the peer out, which takes half of the time.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import cv2
import numpy as np

from robofleet.core.clock import stopwatch_ns
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from tests.tracking.peers import CANDIDATES, OURS, Setting
from tests.tracking.raycast import Floats, Print, RayCaster, Shadow, along, clutter
from tests.tracking.sensor import Camera, Sensor
from tools.measure.program import program
from tools.measure.tracking.accuracy import HEIGHT, PERIOD, SIDE, SIZE
from tools.measure.tracking.accuracy import Scene as Quality
from tools.measure.tracking.accuracy import camera as full_camera
from tools.measure.tracking.score import Score, squared

PEER = "pyapriltags, decimate 1"
LIGHT = 0.7
TAGS = 20  # in each image
WARM_UP, LEARNING = 20, 600  # images that do not count; where a print has to be learnt
_LEARNT = 6  # tags of which that is asked, at most
_RADIUS = 0.3  # of their circles [m]
_ANCHORS = np.stack(np.meshgrid(np.linspace(-1.3, 1.3, 5), np.linspace(-0.75, 0.75, 4)), axis=-1).reshape(20, 2)
_CENTRES = np.stack(np.meshgrid(np.linspace(-1.1, 1.1, 4), (-0.45, 0.45)), axis=-1).reshape(8, 2)


class Scene(NamedTuple):
    """What is before the camera, and its lens."""

    lens: float = 0.7  # sigma [px]
    along_rows: bool = False  # all tags, by a camera that looks straight down through a lens without distortion
    exposure: float = 0.004  # [s]
    shadow: float = 0.0  # softness of shadows' edges [px]; 0: none
    stretch: tuple[float, float] = (0.0, 0.0)  # see Print
    bow: float = 0.0  # [m]
    higher: float = 0.0  # than the tracker is told [m]

    @property
    def learnt(self) -> bool:
        """Whether the prints are not what the tracker is told."""
        return any(self.stretch) or self.bow != 0.0 or self.higher != 0.0


class Effect(NamedTuple):
    scene: Scene
    sensor: Sensor


_NOISE = 3.5 * math.sqrt(0.5)
NORMAL = Sensor(shot_noise=_NOISE, read_noise=_NOISE)
WEBCAM = replace(NORMAL, vignetting=0.3, bayer=True, bilateral=12.0, tone="srgb", sharpening=0.5, jpeg=85)


def _effects() -> dict[str, Effect]:
    scenes = {f"lens {sigma}": Scene(sigma) for sigma in (0.5, 0.7, 0.9, 1.2)}
    scenes |= {f"lens {sigma}, along the rows": Scene(sigma, along_rows=True) for sigma in (0.5, 0.7, 0.9, 1.2)}
    sensors = {
        "noise 1": Sensor(shot_noise=_NOISE / 3.5, read_noise=_NOISE / 3.5),
        "gamma 2.2": replace(NORMAL, tone="gamma"),
        "sRGB": replace(NORMAL, tone="srgb"),
        **{f"JPEG {quality}": replace(NORMAL, jpeg=quality) for quality in (95, 85, 70)},
        "Bayer": replace(NORMAL, bayer=True),
        "sharpening": replace(NORMAL, sharpening=1.0),
        "spatial denoising": replace(NORMAL, bilateral=12.0),
        "temporal denoising": replace(NORMAL, memory=0.3),
        "glare veil": replace(NORMAL, veil=60.0),
        "vignetting": replace(NORMAL, vignetting=0.5),
        "webcam": WEBCAM,
        "webcam, temporal denoising": replace(WEBCAM, memory=0.3),
    }
    others = {
        "motion in 15 ms": Scene(exposure=0.015),
        "shadow edges of 1 px": Scene(shadow=1.0),
        "shadow edges of 6 px": Scene(shadow=6.0),
        **{f"stretched by {100 * share:g} % along": Scene(stretch=(share, 0.0)) for share in (0.003, 0.005, 0.01)},
        "stretched by 0.5 % across": Scene(stretch=(0.0, 0.005)),
        "bowed by 1 mm": Scene(bow=0.001),
        **{f"{1e3 * rise:g} mm higher than told": Scene(higher=rise) for rise in (0.001, 0.002, 0.005)},
    }
    return (
        {name: Effect(scene, NORMAL) for name, scene in scenes.items()}
        | {name: Effect(Scene(), sensor) for name, sensor in sensors.items()}
        | {name: Effect(scene, NORMAL) for name, scene in others.items()}
    )


EFFECTS = _effects()


class Frame(NamedTuple):
    light: Floats  # (H, W) of what comes through the lens, see ``Camera.image``
    prints: tuple[Print, ...]
    exposure_ns: int
    counts: bool


class Take(NamedTuple):
    """A drive of some tags: what candidates may know, and what the lens shows."""

    setting: Setting
    frames: Iterator[Frame]


def take(scene: Scene, side_px: float, tags: int, poses: int, seed: int = 1) -> Take:
    """Return a drive of so many tags, at most 20, with so many poses that count."""
    tags, warm_up = (min(tags, _LEARNT), LEARNING) if scene.learnt else (tags, WARM_UP)
    rng = np.random.default_rng(seed)
    eye = full_camera(Quality(0.0), 0.0)
    K = eye.K * [[side_px / 36.0, 1, 1], [1, side_px / 36.0, 1], [1, 1, 1]]
    eye = replace(eye, K=K, exposure=scene.exposure, lens_sigma_px=scene.lens)
    if scene.along_rows:
        down = np.diag([1.0, -1.0, -1.0, 1.0])
        down[2, 3] = eye.T_world_camera[2, 3]
        eye = replace(eye, T_world_camera=down, distortion=np.zeros(5))
    geometry = CameraGeometry(eye.K, eye.distortion, eye.T_world_camera)
    ids = rng.choice(587, tags, replace=False).tolist()
    setting = Setting(geometry, SIZE, [Target(tag, SIDE, HEIGHT, 0.3) for tag in ids], 0.0)
    shadow = Shadow(scene.shadow) if scene.shadow else None
    caster = RayCaster(eye, clutter(SIZE, rng, scene.lens), rng, shadow)
    return Take(setting, _frames(scene, caster, ids, warm_up, math.ceil(poses / tags), rng))


def _frames(
    scene: Scene, caster: RayCaster, ids: Sequence[int], warm_up: int, images: int, rng: np.random.Generator
) -> Iterator[Frame]:
    """Yield what the lens shows of tags that swing, or go round in circles, each in a place of its own."""
    n = len(ids)
    anchors = rng.choice(_ANCHORS, n, replace=False) + rng.uniform(-0.05, 0.05, (n, 2))
    heading = rng.uniform(-math.pi, math.pi, n)
    if scene.learnt:
        right = np.column_stack([np.sin(heading), -np.cos(heading)])
        anchors = rng.choice(_CENTRES, n, replace=False) + _RADIUS * right
    if scene.along_rows:
        heading = np.round(heading / (math.pi / 2.0)) * (math.pi / 2.0)
    poses = list(map(tuple, np.column_stack([anchors, heading]).tolist()))
    beat, phase = rng.uniform(3.0, 6.0, (2, n)), rng.uniform(0.0, math.tau, (2, n))  # [rad/s], [rad]
    for k in range(-warm_up, images):
        swing = np.sin(beat * k * PERIOD + phase)
        speeds = [0.2 * swing[0], np.zeros(n), 2.0 * swing[1]]
        if scene.along_rows:
            speeds = [0.14 * swing[0], 0.14 * swing[1], np.zeros(n)]
        elif scene.learnt:
            speeds = [np.full(n, 0.2), np.zeros(n), np.full(n, 0.2 / _RADIUS)]
        twists = list(map(tuple, np.column_stack(speeds).tolist()))
        prints = tuple(
            Print(tag, SIDE, HEIGHT + scene.higher, pose, twist, stretch=scene.stretch, bow=scene.bow)
            for tag, pose, twist in zip(ids, poses, twists, strict=True)
        )
        light = caster.light(prints) * np.float32(LIGHT)
        yield Frame(light, prints, round((100.0 + k * PERIOD) * 1e9), k >= 0)
        poses = [tuple(map(float, along(pose, twist, PERIOD))) for pose, twist in zip(poses, twists, strict=True)]


class Trial:
    """One effect: its camera, who looks at it, and what they score."""

    def __init__(self, sensor: Sensor, setting: Setting, candidates: Sequence[str]) -> None:
        self._camera = Camera(sensor, setting.size, np.random.default_rng(2))
        self._see = {name: CANDIDATES[name](setting) for name in candidates}
        self._scores = {name: Score() for name in self._see}

    def add(self, frame: Frame) -> None:
        image = self._camera.image(frame.light)
        for name, see in self._see.items():
            if frame.counts or name == OURS:
                seen = see(image, frame.exposure_ns)
                if frame.counts:
                    self._scores[name].add(frame.prints, seen)

    def row(self) -> dict[str, float]:
        ours, peer = (self._scores.get(name, Score()).row() for name in (OURS, PEER))
        row = {"rms_mm": math.nan, "rms_deg": math.nan, "chi2_xy": math.nan, "chi2_psi": math.nan} | ours
        if self._scores[OURS].errors:
            xy, psi = squared(*(np.array(each) for each in (self._scores[OURS].errors, self._scores[OURS].covariances)))
            row |= {"chi2_xy": float(xy.mean()) / 2.0, "chi2_psi": float(psi.mean())}
        row |= {"peer_mm": peer.get("rms_mm", math.nan), "peer_measured": peer["measured"]}
        row["ratio"] = row["peer_mm"] / row["rms_mm"]
        return row


def evaluate(
    effects: dict[str, Effect], side_px: float, tags: int, poses: int, candidates: Sequence[str] = (OURS, PEER)
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the row of each effect; those of one scene, which is cast once, together."""
    for scene, names in groupby(
        sorted(effects, key=lambda name: effects[name].scene), lambda name: effects[name].scene
    ):
        begun, drive = stopwatch_ns(), take(scene, side_px, tags, poses)
        trials = {name: Trial(effects[name].sensor, drive.setting, candidates) for name in names}
        for frame in drive.frames:
            for trial in trials.values():
                trial.add(frame)
        seconds = 1e-9 * (stopwatch_ns() - begun) / len(trials)
        for name, trial in trials.items():
            yield name, trial.row() | {"seconds": seconds}


_COLUMNS = (
    "rms_mm", "rms_deg", "chi2_xy", "chi2_psi", "measured", "wrong", "peer_mm", "peer_measured", "ratio", "seconds",
)  # fmt: skip


def main() -> None:
    parser = program(
        __doc__,
        poses=(1500, "of each effect"),
        effects=("", "parts of effects' names, by commas"),
        alone=(False, "without the peer"),
    )
    parser.add_argument("--sides", type=float, nargs="+", default=[36.0, 24.0], help="of tags [px]")
    arguments = parser.parse_args()
    parts = arguments.effects.split(",")
    effects = {name: effect for name, effect in EFFECTS.items() if any(part.strip() in name for part in parts)}
    if not effects:
        parser.error(f"--effects {arguments.effects}: of {', '.join(EFFECTS)}")
    cv2.setNumThreads(1)
    candidates = (OURS,) if arguments.alone else (OURS, PEER)
    print(f"{'':<38}" + "".join(f"{column:>14}" for column in _COLUMNS))
    for side in arguments.sides:
        for name, row in evaluate(effects, side, TAGS, arguments.poses, candidates):
            cells = "".join(f"{row[column]:>14.4g}" for column in _COLUMNS)
            print(f"{f'{side:g} px, {name}':<38}" + cells, flush=True)


if __name__ == "__main__":
    main()
