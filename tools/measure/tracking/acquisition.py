"""How surely tags are acquired, ours and the peers', on ray-cast frames where the truth is known.

    python -m tools.measure.tracking.acquisition [--json] [--trials N] [--only NAMES] [--scenes NAME] [--family NAME]

The camera and the tags are those of ``accuracy.py``, or tags of another family with cells as large; in each trial 8
tags stand somewhere else, and 10 images differ by their noise (3.5 grey levels). Contrast: white paper minus black, in
the image, around a grey of 120; the rest of the image keeps its light. Covers are straight: what lies beyond a line is
hidden behind something black, grey or white. Columns: how many tags were placed in one of the ten images, and in how
many of all images; what was said that is wrong: of no such tag, or of a tag over 5 mm away; the position's rms and
largest error [mm]; the median time of an image [ms].
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.clock import stopwatch_ns
from robofleet.core.settings import FAMILIES
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from tests.tracking.peers import CANDIDATES, UNTIMED, Setting
from tests.tracking.raycast import BLACK, SQUARES, WHITE, Cable, Print, RayCaster, clutter
from tools.measure.program import program
from tools.measure.tracking.accuracy import HEIGHT, PERIOD, SIDE, SIZE, camera, cell_wide
from tools.measure.tracking.accuracy import Scene as Quality
from tools.measure.tracking.score import WRONG, print_tables

IMAGES = 10  # a trial
TAGS = 8


class Scene(NamedTuple):
    contrast: float = 0.0  # [grey levels]; 0: that of a print in full light
    covered: float = 0.0  # share of the print
    along: float | None = 0.0  # which way the cover's edge runs to the print's [rad]; None: any
    darkness: float = 1.0
    lens: float = 0.7  # sigma [px]
    focal: float = 1.0  # times accuracy.py's: the tags are so much larger
    noise: float = 3.5
    family: str = "36h11"

    @property
    def side(self) -> float:
        return cell_wide(self.family)


SCENES = {
    **{f"contrast {c}": Scene(contrast=c) for c in (60, 50, 40, 30, 20)},
    "contrast 30, lens 1.2 px": Scene(contrast=30, lens=1.2),
    "10 % light": Scene(darkness=0.1),
    "tags of 22 px": Scene(focal=0.6),
    "tags of 22 px, contrast 40": Scene(focal=0.6, contrast=40),
    "tags of 24 px, contrast 20": Scene(focal=24 / 36, contrast=20),
    "tags of 24 px, contrast 20, lens of 0.9 px": Scene(focal=24 / 36, contrast=20, lens=0.9),
    "a side covered, 25 %": Scene(covered=0.25),
    "a corner covered, 12 %": Scene(covered=0.12, along=math.pi / 4),
    "a corner covered, 25 %": Scene(covered=0.25, along=math.pi / 4),
    "covered at any angle, 25 %": Scene(covered=0.25, along=None),
    "covered at any angle, 20 %, contrast 40": Scene(contrast=40, covered=0.2, along=None),
    "half covered": Scene(covered=0.5, along=None),
    "nothing there": Scene(covered=1.0),
}


class Trial(NamedTuple):
    """Tags that stand, and images of them."""

    setting: Setting
    prints: tuple[Print, ...]
    images: list[NDArray[np.uint8]]


def trials(scene: Scene, count: int, seed: int = 3) -> Iterator[Trial]:
    """Yield trials, each with another floor and other tags."""
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        eye = camera(Quality(scene.noise), scene.lens)
        eye = replace(eye, K=eye.K * [[scene.focal, 1, 1], [1, scene.focal, 1], [1, 1, 1]])
        caster = RayCaster(eye, clutter(SIZE, rng, scene.lens), rng)
        geometry = CameraGeometry(eye.K, eye.distortion, eye.T_world_camera)
        tags = rng.choice(FAMILIES[scene.family].ids, TAGS, replace=False).tolist()
        prints = tuple(_print(scene, caster, tag, *position) for tag, position in zip(tags, _places(rng), strict=True))
        setting = Setting(geometry, SIZE, [Target(tag, scene.side, HEIGHT, 0.3, scene.family) for tag in tags], 0.0)
        visible = () if scene.covered == 1.0 else prints
        light = caster.light(visible) * np.float32(scene.darkness)
        yield Trial(setting, visible, [caster.exposed(light, scene.noise) for _ in range(IMAGES)])


def evaluate(scene: Scene, names: Sequence[str], count: int) -> dict[str, dict[str, float]]:
    scores = {name: _Score() for name in names}
    for trial in trials(scene, count):
        for name, score in scores.items():
            score.add(trial, name)
    return {name: score.row() for name, score in scores.items()}


class _Score:
    def __init__(self) -> None:
        self.tags = self.acquired = self.seen = self.wrong = 0
        self.errors: list[float] = []  # [mm]
        self.times: list[float] = []  # [ms]

    def add(self, trial: Trial, name: str) -> None:
        see, found = CANDIDATES[name](trial.setting), set()
        position_of = {tag.tag: complex(*tag.pose[:2]) for tag in trial.prints}
        for k, image in enumerate(trial.images):
            started = stopwatch_ns()
            sightings = see(image, round((1.0 + k * PERIOD) * 1e9))
            self.times.append((stopwatch_ns() - started) / 1e6)
            for seen in sightings:
                error = abs(complex(seen.x, seen.y) - position_of.get(seen.tag, math.inf))
                if error < WRONG:
                    found.add(seen.tag)
                    self.seen += 1
                    self.errors.append(error * 1e3)
                else:
                    self.wrong += 1
        self.tags += len(position_of)
        self.acquired += len(found)

    def row(self) -> dict[str, float]:
        row = {"acquired": self.acquired / max(self.tags, 1), "seen": self.seen / max(IMAGES * self.tags, 1)}
        row |= {"wrong": self.wrong, "p50_ms": float(np.median(self.times)), "max_ms": max(self.times)}
        if self.errors:
            row |= {"rms_mm": math.sqrt(np.square(self.errors).mean()), "max_mm": max(self.errors)}
        return row


def _places(rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Return poses that do not overlap."""
    anchors = np.stack(np.meshgrid([-1.3, -0.45, 0.45, 1.3], [-0.45, 0.45]), axis=-1).reshape(TAGS, 2)
    anchors = anchors + rng.uniform(-0.15, 0.15, (TAGS, 2))
    return [(float(x), float(y), float(rng.uniform(-math.pi, math.pi))) for x, y in anchors]


def _print(scene: Scene, caster: RayCaster, tag: int, x: float, y: float, psi: float) -> Print:
    greys = (BLACK, WHITE)
    if scene.contrast:
        u, v = caster.camera.project(np.array([[x, y, HEIGHT]]))[0].astype(int)
        lamp = float(caster.lamps[v, u])
        greys = ((120.0 - scene.contrast / 2.0) / lamp, (120.0 + scene.contrast / 2.0) / lamp)
    rng = np.random.default_rng(tag)
    cover = _cover(scene, rng) if 0.0 < scene.covered < 1.0 else None
    return Print(tag, scene.side, HEIGHT, (x, y, psi), cable=cover, greys=greys, family=scene.family)


def _cover(scene: Scene, rng: np.random.Generator) -> Cable:
    """Return a strip so wide that it hides all on one side of a line."""
    along = rng.uniform(0.0, math.tau) if scene.along is None else scene.along + rng.integers(4) * math.pi / 2.0
    grid = (np.arange(200) + 0.5) / 200 - 0.5
    normal = np.array([-math.sin(along), math.cos(along)])
    depth = normal[0] * grid[:, None] + normal[1] * grid
    whole = SIDE * FAMILIES[scene.family].cells / 8.0
    begins = float(np.quantile(depth, 1.0 - scene.covered)) * whole
    forward, left = normal * (begins + whole)
    grey = rng.choice([20.0, 110.0, 210.0]).item()
    return Cable(float(forward), float(left), along, 2.0 * whole, 0.001, grey)


def main() -> None:
    parser = program(
        __doc__,
        json=(False, "one JSON object, and nothing else"),
        trials=(10, "of 8 tags and 10 images, a scene"),
        only=("", "candidates whose name has one of these, separated by |, in it"),
        scenes=("", "scenes whose name has this in it"),
    )
    parser.add_argument("--family", default="36h11", choices=SQUARES, help="of the tags")
    arguments = parser.parse_args()
    wanted = arguments.only.split("|")
    names = [name for name in CANDIDATES if name != UNTIMED and any(part in name for part in wanted)]
    names = [name for name in names if arguments.family == "36h11" or "OpenCV" not in name]  # it knows none but that
    chosen = {title: scene for title, scene in SCENES.items() if arguments.scenes in title}
    scenes = {title: scene._replace(family=arguments.family) for title, scene in chosen.items()}
    if not names:
        parser.error(f"--only {arguments.only}: of {', '.join(CANDIDATES)}")
    if not scenes:
        parser.error(f"--scenes {arguments.scenes}: of {', '.join(SCENES)}")
    if arguments.trials < 1:
        parser.error(f"--trials {arguments.trials}: at least 1")
    cv2.setNumThreads(1)
    widths = dict.fromkeys(("acquired", "seen", "wrong", "rms_mm", "max_mm", "p50_ms", "max_ms"), 9)
    tables = ((title, evaluate(scene, names, arguments.trials)) for title, scene in scenes.items())
    print_tables(tables, widths, 44, as_json=arguments.json)


if __name__ == "__main__":
    main()
