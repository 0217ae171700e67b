"""Does the tracker ever say something wrong? Hours of a fleet under everything that a laboratory does to a camera.

    python -m tools.measure.tracking.endurance [--images N] [--seed N]

Twenty robots drive under a camera of 1280 x 720 pixels: tags of 24 px, a noise of 2 to 5 grey levels. Every 200 images
they start anew under another lens, a Gaussian of sigma 0.5 to 1.2 px, and soon another trouble begins: the light goes,
a cable hangs in front, a projector plays, shadows fall, JPEG, glare, a veil, what webcams do to images, long exposures,
a rolling shutter, tags that are covered, carried, exchanged, printed twice, posters of other fleets. A sighting is
wrong when no such robot is within 5 mm of where its tag is at that instant. Measured counts the tag-images in which the
tag is there to be seen, and nobody else has its id: not in the second after it was carried, uncovered or exchanged.
"""

import math
from collections import defaultdict
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.camera import Cable, Glare, Shadow, SimulatedCameraSettings
from robofleet.core.arrays import Array
from robofleet.simulation.camera import Print, SceneRenderer
from robofleet.simulation.effects import effects, shade
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagTracker
from tools.measure.program import program

ROBOTS, SIZE, PERIOD = 20, (1280, 720), 1.0 / 30.0
SIDE, HEIGHT, MAX_SPEED = 0.07, 0.08, 0.2
EPISODE = 200  # images
LEAD_IN = 20  # images, of an episode, before light, cables, lamps and JPEG begin
PATIENCE = 40  # images after a robot was carried, exchanged or uncovered in which it need not be measured
WRONG = 0.005  # [m]
LINE_TIME = 0.02 / SIZE[1]
ANYWHERE = [(x, y) for x in (0, 320, 640, 960, 1279) for y in (0, 360, 719)]


class Trouble(NamedTuple):
    settings: SimulatedCameraSettings = SimulatedCameraSettings()
    light: float = 1.0
    exposure: float = 0.004
    line_time: float = 0.0
    posters: tuple[int, ...] = ()  # tags
    event: str = ""  # every 50 images: covered, carried, exchanged


def cables(rng: np.random.Generator) -> tuple[Cable, ...]:
    ends = [rng.choice(len(ANYWHERE), 2, replace=False) for _ in range(3)]
    return tuple(Cable(points_px=(ANYWHERE[a], ANYWHERE[b]), width_px=2, gray=30) for a, b in ends)


def shadows(rng: np.random.Generator, softness: float) -> tuple[Shadow, ...]:
    return tuple(
        Shadow(at_px=tuple(rng.uniform((0, 0), SIZE).tolist()), angle_deg=angle, softness_px=softness, light=0.6)
        for angle in (20.0, 140.0, 260.0)
    )


def troubles(rng: np.random.Generator) -> dict[str, Trouble]:
    lamps = tuple(
        Glare(at_px=tuple(rng.uniform((0, 0), SIZE).tolist()), radius_px=rng.uniform(5, 40), gray=300.0)
        for _ in range(3)
    )
    veil = tuple(Glare(at_px=at, radius_px=40.0, gray=60.0) for at in rng.uniform((0, 0), SIZE, (20, 2)).tolist())
    return {
        "nothing": Trouble(),
        "15 % light": Trouble(light=0.15),
        "cables, 2 px": Trouble(SimulatedCameraSettings(cables=cables(rng))),
        "projector": Trouble(SimulatedCameraSettings(projector_gray=40)),
        "JPEG, quality 40": Trouble(SimulatedCameraSettings(jpeg_quality=40)),
        "shadows, edges of 1 px": Trouble(SimulatedCameraSettings(shadows=shadows(rng, 1.0))),
        "shadows, edges of 6 px": Trouble(SimulatedCameraSettings(shadows=shadows(rng, 6.0))),
        "veil": Trouble(SimulatedCameraSettings(glare=veil)),
        "sRGB, sharpened": Trouble(SimulatedCameraSettings(tone_curve="srgb", sharpening=1.0)),
        "Bayer, denoised": Trouble(SimulatedCameraSettings(bayer=True, denoising_gray=12.0)),
        "temporal denoising": Trouble(SimulatedCameraSettings(temporal_denoising=0.3)),
        "glare": Trouble(SimulatedCameraSettings(glare=lamps)),
        "exposure 33 ms": Trouble(exposure=0.033),
        "rolling shutter, 20 ms": Trouble(line_time=LINE_TIME),
        "tags covered": Trouble(event="covered"),
        "robots carried": Trouble(event="carried"),
        "tags exchanged": Trouble(event="exchanged"),
        "posters of other fleets": Trouble(posters=(100, 101, 102, 103)),
        "a second print of a tag": Trouble(posters=(1,)),
    }


class Fleet:
    """Robots that drive about their places, with motors that lag."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        x, y = np.meshgrid(np.linspace(-1.3, 1.3, 5), np.linspace(-0.75, 0.75, 4))
        self.places = np.column_stack([x.ravel(), y.ravel()])
        self.poses = np.column_stack([self.places, rng.uniform(-math.pi, math.pi, ROBOTS)])
        self._twist, self._wanted = np.zeros((ROBOTS, 2)), np.zeros((ROBOTS, 2))

    def drive(self) -> Array:
        """Go on by one image; returns the velocities (N, 3) [world]."""
        new = self._rng.random(ROBOTS) < 0.03
        wanted = self._rng.uniform((-MAX_SPEED, -3.0), (MAX_SPEED, 3.0), (ROBOTS, 2))
        self._wanted[new] = wanted[new]
        away = self.poses[:, :2] - self.places
        heading = np.column_stack([np.cos(self.poses[:, 2]), np.sin(self.poses[:, 2])])
        outward = (away * heading).sum(1) * self._wanted[:, 0] > 0.0
        self._wanted[(np.hypot(*away.T) > 0.08) & outward, 0] *= -1.0
        self._twist += (self._wanted - self._twist) * (1.0 - math.exp(-PERIOD / 0.1))
        v, omega = self._twist.T
        half = 0.5 * omega * PERIOD
        step = v * PERIOD * np.sinc(half / math.pi)
        angle = self.poses[:, 2] + half
        self.poses += np.column_stack([step * np.cos(angle), step * np.sin(angle), 2.0 * half])
        psi = self.poses[:, 2]
        return np.column_stack([v * np.cos(psi), v * np.sin(psi), omega])


def geometry() -> CameraGeometry:
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([3.1411141738120056, 0.0, 0.0548283518508331]))[0]
    T[2, 3] = 2.5
    K = [[830.0, 0.0, 646.0], [0.0, 830.0, 359.0], [0.0, 0.0, 1.0]]
    return CameraGeometry(K, [-0.1, 0.015, 0.0004, -0.0003, 0.0], T)


def episode(trouble: Trouble, images: int, rng: np.random.Generator) -> tuple[int, int, int, int]:
    """Return tag-images, those that could be measured, those that were, and wrong sightings."""
    fleet, eye = Fleet(rng), geometry()
    targets = [Target(tag + 1, SIDE, HEIGHT, MAX_SPEED) for tag in range(ROBOTS)]
    prints = [
        Print(Target(tag, SIDE, 0.0, 0.0), x, y, rng.uniform(-3.0, 3.0))
        for tag, (x, y) in zip(trouble.posters, (fleet.places[::4] + 0.17).tolist(), strict=False)
    ]
    made = partial(
        SceneRenderer, eye, SIZE, targets, rng.uniform(2.0, 5.0), rng,
        exposure_s=trouble.exposure, line_time_s=trouble.line_time, prints=prints, lens_sigma_px=rng.uniform(0.5, 1.2),
    )  # fmt: skip
    bright = renderer = made()
    if trouble.light < 1.0 or trouble.settings.shadows:
        renderer = made(light=trouble.light, shade=shade(trouble.settings, SIZE))
    chain = effects(trouble.settings, SIZE, rng)
    tracker = TagTracker(eye, SIZE, targets, trouble.line_time)
    excused = np.full(ROBOTS, 5)  # images for which a tag need not be measured
    excused[[tag - 1 for tag in trouble.posters if tag <= ROBOTS]] = images
    covered = np.zeros(ROBOTS, np.bool_)
    could = measured = wrong = 0
    for k in range(images):
        velocities = fleet.drive()
        if trouble.event and k % 50 == 25:
            a, b = rng.choice(ROBOTS, 2, replace=False)
            if trouble.event == "covered":
                covered[a] = not covered[a]
                excused[a] = PATIENCE if not covered[a] else images
            elif trouble.event == "carried":
                fleet.poses[a, :2] = fleet.places[a] + rng.uniform(-0.12, 0.12, 2)
                fleet.poses[a, 2] = rng.uniform(-math.pi, math.pi)
                excused[a] = PATIENCE
            else:
                renderer.looks[[a, b]] = renderer.looks[[b, a]]
                excused[[a, b]] = PATIENCE
        poses = fleet.poses.copy()
        carrier = np.argsort(renderer.looks)  # which robot carries tag i + 1
        after = (renderer.rows(poses) - (SIZE[1] - 1) / 2.0) * trouble.line_time
        poses += velocities * after[:, None]
        shown = np.where(covered[:, None], np.nan, poses)
        image = (renderer if k >= LEAD_IN else bright).render(shown, velocities).copy()
        for effect in chain if k >= LEAD_IN else []:
            effect(image, k * PERIOD)
        sightings = tracker.track(image, round((1.0 + k * PERIOD) * 1e9))
        seen = {}
        for pose in sightings.poses:
            if pose.coasted_ns == 0:
                robot = carrier[pose.tag - 1]
                truth = fleet.poses[robot] + velocities[robot] * pose.after_ns * 1e-9
                wrong += math.hypot(pose.x - truth[0], pose.y - truth[1]) > WRONG or bool(covered[robot])
                seen[pose.tag] = pose
        present = np.flatnonzero(excused <= 0)
        could += len(present)
        measured += sum(int(renderer.looks[robot]) + 1 in seen for robot in present)
        excused -= 1
    return images * ROBOTS, could, measured, wrong


def main() -> None:
    arguments = program(__doc__, images=(11_400, "of twenty tags; default: 228,000 tag-images"), seed=1).parse_args()
    cv2.setNumThreads(1)
    totals: dict[str, NDArray[np.int64]] = defaultdict(lambda: np.zeros(4, np.int64))
    done = 0
    while done < arguments.images:
        rng = np.random.default_rng((arguments.seed, done))
        for name, trouble in troubles(rng).items():
            totals[name] += np.array(episode(trouble, EPISODE, rng))
            done += EPISODE
    print(f"{'trouble':<26}{'tag-images':>11}{'to be seen':>11}{'measured':>10}{'wrong':>7}")
    totals["all"] = np.sum(list(totals.values()), axis=0)
    for name, (tags, could, measured, wrong) in totals.items():
        print(f"{name:<26}{tags:>11}{could:>11}{100 * measured / max(could, 1):>9.2f}%{wrong:>7}")


if __name__ == "__main__":
    main()
